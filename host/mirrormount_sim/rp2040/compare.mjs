// Executes every first half-word of an instruction by execute.mjs and by rp2040js' own chain of tests, from the same
// state, and prints the instructions after which the two states differ, and how many were compared.
//
// usage: node compare.mjs
import { RP2040 } from 'rp2040js';
import { adopt, run } from './execute.mjs';

const [RAM, FLASH, DIVIDER] = [0x20000000, 0x10000000, 0xd0000060];
const CODE = 0x100, DATA = 0x2000, SIZE = 0x1000; // offsets in both memories
const CYCLE = 8; // ns
const MISS = 40; // cycles
// BLX LR: rp2040js sets LR before it reads it. The processor does not (ARMv6-M ARM: BLX, register), nor does execute.mjs.
const WRONG = [0x47f0];
const STOPS = op => op >> 8 === 0xbe || op >> 8 === 0xde; // breakpoints

let seed = 1;
const random = below => (seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0, (seed >>> 8) % below);
const pick = list => list[random(list.length)];

const mcu = new RP2040();
mcu.logger = { debug() {}, info() {}, warn() {}, error() {} };
console.warn = () => {};
mcu.onBreak = () => {};
adopt(mcu);
const { core, clock } = mcu;
const data = Uint8Array.from({ length: SIZE }, () => random(256));
mcu.flash.set(data, DATA);

function registers() {
  const kinds = [
    () => random(256), () => (random(65536) << 16) | random(65536), () => pick([0, 1, 31, 32, 33, 0x7fffffff, 0x80000000, 0xffffffff]),
    () => RAM + DATA + random(SIZE), () => RAM + DATA + (random(SIZE) & ~3), () => FLASH + DATA + random(SIZE),
    () => DIVIDER + 4 * random(6), () => 0xd0000000,
  ];
  const values = Uint32Array.from({ length: 16 }, () => pick(kinds)());
  values[13] = RAM + DATA + 0x400 + 4 * random(0x200);
  return values;
}

function start(at, op, op2, values, flags) {
  mcu.sram.set(data, DATA);
  const place = (at & 0xffffff) >> 1;
  const code = at >>> 24 === 0x10 ? mcu.flash16 : core.sram16;
  code[place] = op; code[place + 1] = op2;
  core.registers.set(values);
  core.registers[15] = at;
  [core.N, core.Z, core.C, core.V, core.PM] = [1, 2, 4, 8, 16].map(bit => Boolean(flags & bit));
  core.waiting = core.touched = core.interruptsUpdated = core.pendingSVCall = core.eventRegistered = core.nPRIV = false;
  core.SPSEL = core.currentMode = core.IPSR = core.ran = 0;
  core.bankedSP = RAM + DATA;
  core.clock = clock; core.cycle = CYCLE; clock.nanosCounter = 0;
  core.cache.reset();
  core.cache.cost = MISS;
  const { interp0, interp1 } = mcu.sio; // a read may change them
  Object.assign(mcu.sio, { interp0: new interp0.constructor(0), interp1: new interp1.constructor(1) });
  Object.assign(mcu.sio, { divDividend: 7, divDivisor: 3, divQuotient: 2, divRemainder: 1, divCSR: 0, spinLock: 0 });
}
const { way0, way1, older } = core.cache;
const state = () => JSON.stringify([
  [...core.registers], core.N, core.Z, core.C, core.V, core.PM, core.waiting, core.interruptsUpdated, core.pendingSVCall,
  core.SPSEL, core.bankedSP, core.cache.ahead, mcu.sio.divQuotient, mcu.sio.divRemainder,
]) + [mcu.sram.subarray(DATA - 512, DATA + SIZE + 512), way0, way1, older].map(part => Buffer.from(part.buffer, part.byteOffset, part.byteLength).toString('latin1')).join();

let compared = 0, different = 0;
for (let op = 0; op < 65536; op++) {
  if (STOPS(op) || WRONG.includes(op)) continue;
  const op2 = pick([() => 0xd000 | random(65536), () => pick([0x8f50, 0x8f4f, 0x8010, 0x8310, 0x8810, 0x8803]), () => random(65536)])();
  const given = [pick([RAM, FLASH]) + CODE + 2 * random(2), op, op2, registers(), random(32)];
  start(...given);
  if (given[0] >>> 24 === 0x10) core.cache.fetch(given[0]);
  const cycles = core.executeInstruction();
  const chain = [clock.nanosCounter + cycles * CYCLE, state()];
  start(...given);
  run(clock, CYCLE, 1);
  const fast = [clock.nanosCounter, state()];
  compared++;
  if (chain[0] !== fast[0] || chain[1] !== fast[1]) {
    different++;
    console.log(`${op.toString(16)} ${op2.toString(16)}: ${chain[0]} ns, ${fast[0]} ns`);
  }
}
console.log(`${compared} compared, ${different} differ`);
