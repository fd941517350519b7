// A Pico in the emulator: the RP2040 of rp2040js with what it lacks (flash writes, resets, a USB host), its pins,
// and a run loop in emulated time.
import { ConsoleLogger, GPIOPinState, LogLevel, RP2040 } from 'rp2040js';
import { attachAs5600 } from './as5600.mjs';
import { adopt, run } from './execute.mjs';
import { attachFlash, SpiFlash } from './flash.mjs';
import { attachPio } from './pio.mjs';
import { CdcHost } from './usb.mjs';

const PINS = 30;
const ENTRY = 0x10000000; // the image's own second-stage boot loader
const RESET = { power: 0x100, run: 0x10000, watchdog: 0x100 };

export class Board {
  // bootrom: Uint32Array. cached: with the flash's cache. onPin(pin, level), onByte(byte, port), onUsb(up), onFlash(),
  // onLanded() (a packet for the firmware) tell what happens, at time `us`.
  constructor(bootrom, cached, onPin, onByte, onUsb, onFlash, onLanded) {
    this.bootrom = bootrom;
    this.cached = cached;
    this.onPin = onPin;
    this.onByte = onByte;
    this.onUsb = onUsb;
    this.onLanded = onLanded;
    this.flash = new SpiFlash(onFlash);
    this.driven = new Array(PINS).fill(null); // by the simulation: null, 0 or 1
    this.angles = new Map(); // by the SDA of a bus: what an AS5600 there tells
    this.coming = []; // changes of inputs to come, { us, wire, level } in their order
    this.ends = new Set(); // pins of which a change ends a run
    this.ended = false;
    this.baseNs = 0; // before the last reset
    this.mcu = null;
    this.pending = null; // a reset that was asked for
    this.collects = true;
    this.open = true;
  }
  get ns() { return this.baseNs + (this.mcu ? this.mcu.clock.nanos : 0); }
  get us() { return Math.floor(this.ns / 1000); }

  // Start anew: cause is `power`, `run` (the reset pin) or `watchdog`, which keeps the scratch registers.
  boot(cause, watchdog = null) {
    if (this.mcu) {
      this.baseNs += this.mcu.clock.nanos;
      this.mcu = null; // its time is in baseNs now
      this.onUsb(false);
      for (let pin = 0; pin < PINS; pin++) this.onPin(pin, 0); // pins float while it resets: pulled down
    }
    const mcu = (this.mcu = new RP2040());
    mcu.logger = new ConsoleLogger(LogLevel.Error, false);
    mcu.loadBootrom(this.bootrom);
    adopt(mcu);
    attachFlash(mcu, this.flash, RESET[cause], this.cached);
    this.catchResets(mcu, watchdog);
    mcu.qspi.forEach((pin, i) => { pin.padValue = 0x5a; if (i > 0) pin.setInputValue(true); }); // BOOTSEL not pressed
    mcu.gpio.forEach(pin => { pin.padValue = 0x56; pin.lastValue = pin.value; });
    [this.pioUpToNow, this.pioLook] = attachPio(mcu);
    this.watchPins(mcu);
    mcu.i2c.forEach((i2c, i) => attachAs5600(i2c, mcu, () => this.angle(i)));
    this.host = new CdcHost(mcu.usbCtrl, mcu.clock);
    this.host.collects = this.collects;
    this.host.open = this.open;
    this.host.onData = (data, port) => { for (const byte of data) this.onByte(byte, port); };
    this.host.onConfigured = () => this.onUsb(true);
    this.host.onLanded = () => this.onLanded();
    mcu.core.PC = ENTRY;
  }
  catchResets(mcu, watchdog) {
    const dog = mcu.peripherals[0x40058];
    if (watchdog) { dog.scratchData.set(watchdog.scratch); dog.reason = watchdog.reason; }
    dog.onWatchdogTrigger = () => {
      dog.alarm.enabled = false; // or it fires again at the same instant, for ever
      this.pending = { cause: 'watchdog', watchdog: { reason: dog.reason, scratch: Uint32Array.from(dog.scratchData) } };
    };
    const write = mcu.ppb.writeUint32.bind(mcu.ppb);
    mcu.ppb.writeUint32 = (offset, value) => { // AIRCR with its key and SYSRESETREQ
      if (offset === 0xd0c && value >>> 16 === 0x05fa && value & 4) this.pending = { cause: 'run', watchdog: null };
      else write(offset, value);
    };
    mcu.onBreak = code => { throw new Error(`the image hit a breakpoint (${code}) at ${mcu.core.PC.toString(16)}`); };
  }
  watchPins(mcu) {
    const shown = new Array(PINS).fill(0);
    mcu.gpio.forEach((gpio, i) => {
      this.level(i);
      gpio.addListener(state => {
        const high = state === GPIOPinState.High ? 1 : 0;
        if (high !== shown[i]) { shown[i] = high; this.ended ||= this.ends.has(i); this.onPin(i, high); }
        this.level(i);
      });
    });
  }
  level(i) { // what an input reads: the simulation's drive, else the pin's own output, else its pull
    const gpio = this.mcu.gpio[i];
    const own = gpio.outputEnable && !gpio.outputDisable ? gpio.outputValue : null;
    const value = this.driven[i] ?? own ?? (gpio.pullupEnabled ? 1 : 0);
    if (Boolean(value) === gpio.rawInputValue) return;
    this.pioUpToNow();
    gpio.setInputValue(Boolean(value));
    this.pioLook();
  }
  cutPower(operations, half) {
    this.flash.cutAfter(operations, half, () => { this.pending = { cause: 'power', watchdog: null }; });
  }
  drivePin(i, value) { this.pioUpToNow(); this.driven[i] = value; this.level(i); }
  angle(block) { // of the AS5600 on one of its buses (RP2040 datasheet, 1.4.3: SDA n belongs to block n / 2 mod 2)
    for (const [sda, angle] of this.angles) if ((sda >> 1) % 2 === block) return angle;
    return 0xffff;
  }
  change({ wire, level }) { // 64 + n: the angle on the bus whose SDA is n
    if (wire >= 64) this.angles.set(wire - 64, level);
    else this.drivePin(wire, level);
  }
  setCollects(yes) { this.collects = yes; this.host.setCollects(yes); }
  setOpen(yes) { this.open = yes; this.host.setOpen(yes); }

  // Run until emulated time `ns`, or until a pin of `ends` has changed. Sleeping (WFI) costs nothing: it jumps to the next alarm. Nor does polling the flash
  // while it is busy: after each poll time jumps to the next alarm or to the end of the operation.
  runUntil(ns) {
    this.ended = false;
    while (this.ns < ns && !this.ended) {
      while (this.coming.length && this.coming[0].us * 1000 <= this.ns) this.change(this.coming.shift());
      if (this.pending) {
        const { cause, watchdog } = this.pending;
        this.pending = null;
        this.boot(cause, watchdog);
      }
      this.host.pump();
      const next = this.coming.length ? Math.min(ns, this.coming[0].us * 1000) : ns;
      this.slice(next - this.baseNs);
    }
    while (this.coming.length && this.coming[0].us <= this.us) this.change(this.coming.shift());
    this.coming.length = 0; // the rest will be told anew
  }
  slice(end) {
    const { core, clock } = this.mcu;
    while (clock.nanos < end && !this.pending && !this.ended) {
      // an interrupt that is pending but masked ends a WFI, too
      if (core.waiting && (core.pendingInterrupts & core.enabledInterrupts || core.pendingSystick || core.pendingPendSV)) {
        core.waiting = false;
        core.interruptsUpdated = true;
      }
      if (core.waiting) this.pass(end);
      else if (this.flash.polled) {
        this.flash.polled = false;
        this.pass(Math.min(end, this.flash.busyUntil));
      } else run(clock, 1e9 / this.mcu.clkSys, end);
    }
  }
  pass(end) { // without an instruction, to the next alarm or to `end`
    const { clock } = this.mcu;
    const alarm = clock.nextAlarm;
    clock.tick(Math.max(0, Math.min(alarm ? alarm.nanos : Infinity, end) - clock.nanos));
  }
}
