// The Pico's SPI flash (a W25Q16JV of 2 MiB) and the peripherals through which the RP2040 writes and reads it.
// rp2040js maps flash for reading only; MicroPython's file system needs erase and program with their times.
import { BasePeripheral } from 'rp2040js';
import { missCycles } from './cache.mjs';

export const FLASH_SIZE = 2 * 1024 * 1024;
const UNIQUE_ID = [0xe6, 0x61, 0x64, 0x08, 0x43, 0x2f, 0x5a, 0x21];
// typical times of the data sheet, microseconds
const ERASE = { 0x20: [4096, 45_000], 0x52: [32_768, 120_000], 0xd8: [65_536, 150_000] };
const PROGRAM_US = 400;

export class SpiFlash {
  constructor(onOperation = () => {}) {
    this.onOperation = onOperation;
    this.memory = new Uint8Array(FLASH_SIZE).fill(0xff);
    this.operations = 0; // erases and programs so far
    this.cut = null; // see cutAfter
    this.onChange = () => {};
    this.powerOn(null);
  }
  powerOn(clock) {
    this.clock = clock;
    this.writable = false;
    this.busyUntil = -1;
    this.selected = false;
    this.bytes = [];
    this.off = false;
    this.polled = false; // while busy: whoever asked does nothing but ask again
  }
  // The power goes, and then() is called, with the n-th erase or program from now; that one is left half done if `half`.
  cutAfter(n, half, then) { this.cut = { at: this.operations + n, half, then }; }
  get isLast() { return this.cut !== null && this.cut.at === this.operations + 1; }
  get busy() { return this.clock.nanos < this.busyUntil; }
  get address() { return ((this.bytes[1] << 16) | (this.bytes[2] << 8) | this.bytes[3]) & (FLASH_SIZE - 1); }
  select() {
    if (!this.selected) { this.selected = true; this.bytes = []; }
  }
  transfer(byte) {
    const i = this.bytes.push(byte) - 1;
    if (i === 0) return 0xff;
    switch (this.bytes[0]) {
      case 0x05:
        if (this.busy) this.polled = true;
        return (this.busy ? 1 : 0) | (this.writable ? 2 : 0);
      case 0x35: return 2; // quad enabled
      case 0x15: return 0x60;
      case 0x9f: return [0xef, 0x40, 0x15][(i - 1) % 3];
      case 0x4b: return i >= 5 ? UNIQUE_ID[(i - 5) & 7] : 0xff;
      case 0x03: return i >= 4 ? this.memory[(this.address + i - 4) & (FLASH_SIZE - 1)] : 0xff;
      case 0x0b: return i >= 5 ? this.memory[(this.address + i - 5) & (FLASH_SIZE - 1)] : 0xff;
      default: return 0xff;
    }
  }
  deselect() { // what a command does, it does when the chip is deselected
    if (!this.selected) return;
    this.selected = false;
    const command = this.bytes[0];
    if (this.off || command === undefined || (this.busy && command !== 0x05 && command !== 0x35)) return;
    if (command === 0x06) this.writable = true;
    else if (command === 0x04) this.writable = false;
    else if (this.writable && command in ERASE) {
      const [size, us] = ERASE[command];
      const start = this.address & ~(size - 1);
      this.memory.fill(0xff, start, start + this.done(size));
      this.changed(start, size, us);
    } else if (this.writable && command === 0x02) {
      const page = this.address & ~255;
      const count = this.done(this.bytes.length - 4);
      for (let i = 0; i < count; i++) this.memory[page | ((this.address + i) & 255)] &= this.bytes[i + 4];
      this.changed(page, 256, PROGRAM_US);
    }
  }
  done(count) { return this.isLast && this.cut.half ? count >> 1 : count; } // how many bytes of it are done
  changed(start, size, us) {
    this.operations++;
    this.writable = false;
    this.busyUntil = this.clock.nanos + us * 1000;
    this.onChange(start, size);
    this.onOperation();
    if (this.cut?.at !== this.operations) return;
    const { then } = this.cut;
    this.cut = null;
    this.off = true;
    then();
  }
}

class Registers extends BasePeripheral { // a block that the firmware only sets up
  constructor(rp2040, name, initial = {}) {
    super(rp2040, name);
    this.values = new Map(Object.entries(initial).map(([offset, value]) => [Number(offset), value]));
  }
  readUint32(offset) { return this.values.get(offset) ?? 0; }
  writeUint32(offset, value) { this.values.set(offset, value >>> 0); }
}

class Ssi extends Registers { // byte-wise transfers drive the flash; chip select is forced through IO_QSPI
  constructor(rp2040, flash, onMapped) { // onMapped(register): the flash can be read as memory from here on
    super(rp2040, 'SSI', { 0x58: 0x51535049, 0x5c: 0x3430312a });
    this.flash = flash;
    this.onMapped = onMapped;
    this.received = [];
    this.override = 0;
    this.readSince = false;
  }
  get byteWise() { return ((this.readUint32(0) >> 16) & 0x1f) === 7; }
  chipSelect(override) { // 0 automatic, 2 low, 3 high
    if (override === this.override) return;
    this.override = override;
    this.flash.deselect();
    if (override === 2) this.flash.select();
  }
  readUint32(offset) {
    switch (offset) {
      case 0x24: return this.received.length;
      case 0x28: return 0x06 | (this.received.length ? 8 : 0);
      case 0x20: case 0x2c: case 0x30: case 0x34: case 0x38: case 0x3c: case 0x40: case 0x44: case 0x48: return 0;
      case 0x60: this.readSince = true; return this.received.shift() ?? 0;
      default: return super.readUint32(offset);
    }
  }
  writeUint32(offset, value) {
    if (offset === 0x60) {
      if (!this.byteWise) { this.received.push(0); return; }
      if (this.override === 3) { this.received.push(0xff); return; }
      if (this.override === 0) {
        if (this.readSince) this.flash.deselect();
        this.flash.select();
      }
      this.readSince = false;
      this.received.push(this.flash.transfer(value & 0xff));
      return;
    }
    if (offset === 0x08 && !(value & 1)) {
      if (this.override === 0) this.flash.deselect();
      this.received.length = 0;
      this.readSince = false;
    }
    super.writeUint32(offset, value);
    if (offset === 0x08 && value & 1 && !this.byteWise) this.onMapped(register => this.readUint32(register));
  }
}

class IoQspi extends Registers {
  constructor(rp2040, ssi) { super(rp2040, 'IO_QSPI'); this.ssi = ssi; }
  readUint32(offset) { return this.values.get(offset) ?? (offset < 0x30 && offset & 4 ? 0x1f : 0); }
  writeUint32(offset, value) {
    super.writeUint32(offset, value);
    if (offset === 0x0c) this.ssi.chipSelect((value >> 8) & 3);
    if (offset < 0x30 && offset & 4) {
      const pin = this.rp2040.qspi[offset >> 3];
      if (pin) pin.ctrl = value;
    }
  }
}

class XipControl extends Registers {
  constructor(rp2040, cache) { super(rp2040, 'XIP_CTRL'); this.cache = cache; }
  writeUint32(offset, value) {
    if (offset === 4) this.cache.flush();
    super.writeUint32(offset, value);
  }
  readUint32(offset) { return offset === 8 ? 2 : super.readUint32(offset); } // never busy
}

let random = 0x2545f491; // repeatable from run to run, but not from boot to boot

class RingOscillator extends Registers {
  constructor(rp2040) { super(rp2040, 'ROSC'); }
  readUint32(offset) {
    if (offset === 0x18) return 0x80001000; // stable
    if (offset !== 0x1c) return super.readUint32(offset);
    random = (Math.imul(random, 1664525) + 1013904223) >>> 0;
    return random >>> 31;
  }
}

// Put the flash and the blocks round it into a new RP2040. resetCause is the CHIP_RESET register's value.
// cached: a miss of the flash's cache stalls the processor; else all of the flash is as fast as RAM.
export function attachFlash(rp2040, flash, resetCause, cached) {
  rp2040.flash.set(flash.memory, 0);
  flash.powerOn(rp2040.clock);
  flash.onChange = (start, size) => rp2040.flash.set(flash.memory.subarray(start, start + size), start);
  const { cache } = rp2040.core;
  const ssi = new Ssi(rp2040, flash, register => { if (cached) cache.cost = missCycles(register); });
  rp2040.peripherals[0x18000] = ssi;
  rp2040.peripherals[0x40018] = new IoQspi(rp2040, ssi);
  rp2040.peripherals[0x14000] = new XipControl(rp2040, cache);
  rp2040.peripherals[0x40060] = new RingOscillator(rp2040);
  rp2040.peripherals[0x40064] = new Registers(rp2040, 'VREG', { 0: 0xb1, 4: 9, 8: resetCause });
}
