// The rp2040 machine: a real MicroPython image in an emulated RP2040, behind the seam of the virtual board.
//
// usage: node main.mjs BOOTROM IMAGE FLASH START_US keep|forget cached|uncached
//   BOOTROM  4096 little-endian words        IMAGE  .bin or .uf2, used if FLASH does not exist
//   FLASH    file that holds the flash's content; written back as it changes, if it is to be kept
//   uncached: without the model of the flash's cache (cache.mjs), all of the flash is as fast as RAM
//
// stdin and stdout carry the 16-byte records of host/mirrormount/virtual/fakes/_seam.py (in R and T, b is the serial
// port: 0 the firmware's, 1 CircuitPython's console beside it), and these:
//   from the board  U USB is up (a = 1) or down     F the flash has been erased or programmed at a place
//                   L a packet for the firmware is in the board's memory; b bytes still wait in the host
//   to the board    D a program has opened the port (a = 1) or closed it
//                   X reset: a = 0 power, 1 the RUN pin, 2 power, and the flash is what it was at the last M
//                   M remember what the flash holds; at first that is what it held in the beginning
//                   J eject the board's drive: from here on it is the board's own
//                   C cut the power for a moment with the dt-th F from now; a = 1: that one is left half done
import fs from 'node:fs';
import { Board } from './board.mjs';

const [bootromFile, imageFile, flashFile, startText, keep, cached] = process.argv.slice(2);
const START_US = Number(startText);
const RECORD = 16;
const [EDGE, SENT, WAIT, USB, FLASH, LANDED] = Buffer.from('ETSUFL');
const [RECEIVED, PIN, COLLECTS, GO, OPEN, RESET, CUT, REMEMBER, EJECT, CHANGE, ENDS] = Buffer.from('RPWGDXCMJQN');

process.on('uncaughtException', error => { // the host shows the last line
  console.error(error.stack);
  console.error(error.message);
  process.exit(1);
});

const out = [];
function record(kind, a, b, dt) {
  const r = Buffer.alloc(RECORD);
  r.writeUInt8(kind, 0);
  r.writeUInt8(a, 1);
  r.writeUInt16LE(b, 2);
  r.writeUInt32LE(dt, 4);
  r.writeBigUInt64LE(BigInt(START_US + board.us), 8);
  out.push(r);
}

function image(file) {
  const data = fs.readFileSync(file);
  if (data.readUInt32LE(0) !== 0x0a324655) return [[0, data]];
  const blocks = [];
  for (let o = 0; o + 512 <= data.length; o += 512) {
    const family = data.readUInt32LE(o + 28);
    if (family !== 0xe48bff56) continue; // not for the RP2040
    blocks.push([data.readUInt32LE(o + 12) - 0x10000000, data.subarray(o + 32, o + 32 + data.readUInt32LE(o + 16))]);
  }
  return blocks;
}

const bootrom = fs.readFileSync(bootromFile);
const board = new Board(
  new Uint32Array(bootrom.buffer, bootrom.byteOffset, bootrom.length / 4),
  cached === 'cached',
  (pin, level) => record(EDGE, pin, level * 65535, 0),
  (byte, port) => record(SENT, byte, port, 0),
  up => record(USB, up ? 1 : 0, 0, 0),
  () => record(FLASH, 0, 0, 0),
  () => record(LANDED, 0, Math.min(board.host.waiting, 65535), 0),
);
function put(data, address, file) {
  const size = board.flash.memory.length;
  if (address < 0 || address + data.length > size) throw new Error(`${file} does not fit into a flash of ${size} bytes`);
  board.flash.memory.set(data, address);
}
if (fs.existsSync(flashFile)) put(fs.readFileSync(flashFile), 0, flashFile);
else for (const [address, data] of image(imageFile)) put(data, address, imageFile);
const remembered = Uint8Array.from(board.flash.memory);
board.boot('power');

let saved = 0;
function save() {
  if (keep !== 'keep' || board.flash.operations === saved) return;
  saved = board.flash.operations;
  fs.writeFileSync(flashFile + '.part', board.flash.memory);
  fs.renameSync(flashFile + '.part', flashFile);
}

function wait() {
  record(WAIT, 0, Math.min(board.host.waiting, 65535), 0);
  process.stdout.write(Buffer.concat(out.splice(0)));
}

function take(r) {
  const kind = r.readUInt8(0), a = r.readUInt8(1), b = r.readUInt16LE(2);
  if (kind === RECEIVED) board.host.send(a, b);
  else if (kind === PIN) board.drivePin(a, b);
  else if (kind === COLLECTS) board.setCollects(a === 1);
  else if (kind === OPEN) board.setOpen(a === 1);
  else if (kind === RESET) {
    if (a === 2) board.flash.memory.set(remembered);
    board.pending = { cause: a === 1 ? 'run' : 'power', watchdog: null };
  }
  else if (kind === REMEMBER) remembered.set(board.flash.memory);
  else if (kind === CHANGE) board.coming.push({ us: Number(r.readBigUInt64LE(8)) - START_US, wire: a, level: b });
  else if (kind === ENDS) board.ends.add(a);
  else if (kind === EJECT) board.host.eject();
  else if (kind === CUT) board.cutPower(r.readUInt32LE(4), a === 1);
  else if (kind === GO) {
    const until = Number(r.readBigUInt64LE(8)) + r.readUInt32LE(4) - START_US;
    board.runUntil(until * 1000);
    save();
    wait();
  }
}

let input = Buffer.alloc(0);
process.stdin.on('data', data => {
  input = Buffer.concat([input, data]);
  let o = 0;
  for (; o + RECORD <= input.length; o += RECORD) take(input.subarray(o, o + RECORD));
  input = input.subarray(o);
});
process.stdin.on('end', () => { save(); process.exit(0); });
process.stdout.on('error', () => process.exit(0)); // its simulation was killed
process.on('SIGINT', () => {}); // Ctrl-C in a terminal is the host's
wait();
