// Executes the processor's instructions, until something happens that is not its own affair. It does what rp2040js does in
// executeInstruction (rewritten by core.mjs), in the same cycles: compare.mjs holds the two to each other. What is rare it
// leaves to that function: most wide instructions and special registers, exceptions, waiting.
//
// Its text is put together here, of what the instructions have in common. All values are integers of 32 bits, all memory
// is one array and a constant: so the optimizing compiler keeps values in registers, and knows where things are.
import { FlashCache } from './cache.mjs';

const RAM = 0x20000000, RAM_SIZE = 0x42000, ROM_SIZE = 0x4000; // bytes
// places in the memory: the flash's window of 16 MiB, whose first byte is 0, and the others
const [RAM_AT, ROM_AT, WAY0, WAY1, OLDER, REGISTERS] = [0x1000000, 0x1080000, 0x1090000, 0x1092000, 0x1094000, 0x1098000];
const SIZE = 0x109a000;
const LONGEST = 0x3fffffff; // cycles that are executed at once

const memory = new ArrayBuffer(SIZE);
const array = (Type, at, size) => new Type(memory, at, size / Type.BYTES_PER_ELEMENT);
const R = array(Uint32Array, REGISTERS, 64);
// After the registers: the flags (N is n < 0, Z is z == 0, C is c, V is v < 0), the cycles since the clock was right,
// the word that was fetched last, whether interrupts must be looked at, whether execute() may go on, PRIMASK.
const [N, Z, C, V, RAN, AHEAD, ATTENTION, GOES, MASK] = [16, 17, 18, 19, 20, 21, 22, 23, 24];
const state = array(Int32Array, REGISTERS, 128);
const window = array(Uint8Array, 0, 1 << 24).fill(0xff);
const ram = array(Uint8Array, RAM_AT, RAM_SIZE);
const cache = new FlashCache(array(Int32Array, WAY0, 8192), array(Int32Array, WAY1, 8192), array(Uint8Array, OLDER, 1024));
let core = null;

// Make these the registers and memories of an rp2040js RP2040 that has just been made. Its RAM is 0 and its cache
// empty; the flash is what it was.
export function adopt(mcu) {
  core = mcu.core;
  const [start, loader] = [Uint32Array.from(core.registers), Uint32Array.from(mcu.bootrom)];
  const rom32 = array(Uint32Array, ROM_AT, ROM_SIZE);
  Object.assign(mcu, {
    sram: ram, sramView: new DataView(memory, RAM_AT, RAM_SIZE), bootrom: rom32,
    flash: window, flash16: array(Uint16Array, 0, 1 << 24), flashView: new DataView(memory, 0, 1 << 24),
  });
  Object.assign(core, {
    registers: R.subarray(0, 16), cache, rom32, rom16: array(Uint16Array, ROM_AT, ROM_SIZE),
    sram8: ram, sram16: array(Uint16Array, RAM_AT, RAM_SIZE), sram32: array(Uint32Array, RAM_AT, RAM_SIZE),
    flash8: window, flash16: mcu.flash16, flash32: array(Uint32Array, 0, 1 << 24),
  });
  if (!rehearsed) rehearse();
  rehearsed = true;
  R.set(start);
  rom32.set(loader);
  ram.fill(0);
  cache.reset();
}

// Execute instructions of every kind once. A kind that comes up for the first time in a function that has been compiled
// makes the compiler throw it away, and begin anew: in its first seconds a board would be half as fast.
let rehearsed = false;
function rehearse() {
  const instruction = array(Uint16Array, RAM_AT, 4);
  const warn = console.warn;
  console.warn = () => {}; // a store goes to the CPUID, too, which rp2040js would tell
  const flags = [core.N, core.Z, core.C, core.V];
  for (let op = 0; op < 0xf800; op += op < 0x4800 ? 3 : 29) {
    const upper = op >> 8;
    if (upper === 0xb6 || upper === 0xdf || upper === 0xde || upper === 0xbe || upper === 0xbf || upper === 0xba) continue;
    instruction.set([op, 0xf800]); // if it is wide: BL
    for (let i = 0; i < 15; i++) R[i] = RAM + 0x100 + ((op * 5 + i * 36) & 0x7f8);
    R[(op >> 6) & 7] = op & 1 ? 4 : 0xfffffff0;
    if (op % 5 === 0) R[(op >> 3) & 7] = op & 1 ? 0x10000000 : 0xd0000000 - ((op >> 4) & 0x7c); // flash; CPUID
    R[13] = RAM + 0x800;
    R[15] = RAM;
    core.ran = 0;
    given();
    execute(1);
    taken();
  }
  console.warn = warn;
  core.touched = core.waiting = core.interruptsUpdated = false;
  core.ran = 0;
  [core.N, core.Z, core.C, core.V] = flags;
}

// Execute until the clock's next alarm or `end` (ns), an access to anything but memory, or a wait; the clock is then
// right. cycle: of the processor, in ns.
export function run(clock, cycle, end) {
  core.clock = clock; core.cycle = cycle; core.ran = 0; core.touched = false;
  const alarm = clock.nextAlarm;
  const ns = (alarm !== null && alarm.nanos < end ? alarm.nanos : end) - clock.nanosCounter;
  given();
  execute(Math.min(Math.ceil(ns / cycle), LONGEST));
  taken();
  const passed = core.ran * cycle;
  core.ran = 0;
  clock.tick(passed);
}

// The core's state, for execute().
function given() {
  state[N] = core.N ? -1 : 0; state[Z] = core.Z ? 0 : 1; state[C] = core.C ? 1 : 0; state[V] = core.V ? -1 : 0;
  state[MASK] = core.PM ? 1 : 0;
  left();
}
function left() { // without the flags
  state[RAN] = core.ran;
  state[AHEAD] = cache.ahead;
  state[ATTENTION] = core.interruptsUpdated ? 1 : 0;
  state[GOES] = core.touched || core.waiting ? 0 : 1;
}
// The state that execute() leaves, for the core.
function taken() {
  core.N = state[N] < 0; core.Z = state[Z] === 0; core.C = state[C] !== 0; core.V = state[V] < 0;
  core.PM = state[MASK] !== 0;
  core.interruptsUpdated = state[ATTENTION] !== 0;
  core.ran = state[RAN];
  cache.ahead = state[AHEAD];
}
function stalled() { // cycles
  const cycles = cache.stall;
  cache.stall = 0;
  return cycles;
}

// What execute() calls. Each returns cycles.
const calls = {
  interrupt() {
    taken();
    if (core.checkForInterrupts()) core.waiting = false;
    given();
    return stalled();
  },
  chain() {
    taken();
    const cycles = core.executeInstruction();
    given();
    return cycles;
  },
  load(register, address, kind) {
    core.ran = state[RAN];
    cache.ahead = state[AHEAD];
    switch (kind) {
      case 0: R[register] = core.readUint32(address); break;
      case 1: R[register] = core.readUint16(address); break;
      case 2: R[register] = core.readUint8(address); break;
      case 3: R[register] = (core.readUint16(address) << 16) >> 16; break;
      case 4: R[register] = (core.readUint8(address) << 24) >> 24; break;
    }
    left();
    return 1 + core.cyclesIO(address) + stalled();
  },
  store(register, address, kind) {
    core.ran = state[RAN];
    cache.ahead = state[AHEAD];
    switch (kind) {
      case 0: core.writeUint32(address, R[register]); break;
      case 1: core.writeUint16(address, R[register]); break;
      case 2: core.writeUint8(address, R[register]); break;
    }
    left();
    return 1 + core.cyclesIO(address, true) + stalled();
  },
  sioLoad(register, offset) {
    R[register] = core.rp2040.sio.readUint32(offset);
  },
  sioStore(register, offset) {
    core.rp2040.sio.writeUint32(offset, R[register]);
  },
  miss(word, place) {
    cache.miss(word, place);
    return stalled();
  },
};

// ---- pieces of the text of execute()

const reg = index => `I32[(${REGISTERS} + ((${index}) << 2)) >> 2]`;
const [LOW, MIDDLE, HIGH, UPPER] = ['op & 7', '(op >> 3) & 7', '(op >> 6) & 7', '(op >> 8) & 7'].map(reg);
const [SP, LR] = [13, 14].map(reg);
const set = (to, value) => `r = ${value}; ${to} = r; n = r; z = r;`;
const ADD = 'r = (a + b) | 0; c = ((r >>> 0) < (a >>> 0)) | 0; v = (a ^ r) & (b ^ r); n = r; z = r;';
const SUB = 'r = (a - b) | 0; c = ((a >>> 0) >= (b >>> 0)) | 0; v = (a ^ b) & (a ^ r); n = r; z = r;';
const FLASH = address => `(${address} >>> 24 | 0) == 16`;
const inRam = (offset, less = 0) => `(${offset} >>> 0) < ${RAM_SIZE - less}`;
// The divider, the interpolators and the spin locks of the SIO know no time, and want nothing of the core. Nor does CPUID.
const atSio = (shift, what) => (shift < 2 ? '' : `
  if ((address & ${0xf0000003 | 0}) == ${0xd0000000 | 0}) {
    cycles = 1;
    ${what === 'load' ? `if ((address | 0) == ${0xd0000000 | 0}) { ${LOW} = 0; break instruction; }` : ''}
    if ((address & 0xfffffff) >>> 0 >= 0x60) {
      ${what === 'load' ? 'sioLoad' : 'sioStore'}(op & 7, address & 0xfffffff);
      break instruction;
    }
  }`);
const aligned = shift => (shift ? ` if (!(address & ${(1 << shift) - 1}))` : '');
// of an address, by an array and the shift of its width; kind: of calls.load and calls.store
const load = (address, view, shift, kind, extend = '| 0') => `
  address = ${address}; o = (address - ${RAM}) | 0; cycles = 2; kind = 1;
  if (${inRam('o')}) {${aligned(shift)} { ${LOW} = ${view}[(o + ${RAM_AT}) >> ${shift}] ${extend}; kind = 0; } }
  else if (${FLASH('address')}) {${aligned(shift)} {
    stall = (stall + (cached(address >>> 2) | 0)) | 0;
    ${LOW} = ${view}[(address & 0xffffff) >> ${shift}] ${extend}; kind = 0;
  } }
  if (kind) { ${atSio(shift, 'load')} ${leave} cycles = load(op & 7, address | 0, ${kind}) | 0; ${resume} }`;
const store = (address, view, shift, kind) => `
  address = ${address}; o = (address - ${RAM}) | 0; cycles = 2; kind = 1;
  if (${inRam('o')}) {${aligned(shift)} { ${view}[(o + ${RAM_AT}) >> ${shift}] = ${LOW}; kind = 0; } }
  if (kind) { ${atSio(shift, 'store')} ${leave} cycles = store(op & 7, address | 0, ${kind}) | 0; ${resume} }`;
const [PAIR, OFFSET] = [`(${MIDDLE} + ${HIGH}) | 0`, by => `(${MIDDLE} + (((op >> 6) & 31) << ${by})) | 0`];
const at = number => `I32[${(REGISTERS >> 2) + number}]`;
const leave = `${at(RAN)} = ran; ${at(AHEAD)} = ahead;`;
const resume = `ran = ${at(RAN)} | 0; ahead = ${at(AHEAD)} | 0; attention = ${at(ATTENTION)} | 0; goes = ${at(GOES)} | 0;`;
const leaveAll = `${reg(15)} = pc; ${at(ATTENTION)} = attention; ${at(MASK)} = mask; ${at(N)} = n; ${at(Z)} = z; ${at(C)} = c; ${at(V)} = v; ${leave}`;
const resumeAll = `mask = ${at(MASK)} | 0; n = ${at(N)} | 0; z = ${at(Z)} | 0; c = ${at(C)} | 0; v = ${at(V)} | 0; ${resume}`;
// of PUSH, STM and POP, LDM: the registers of a list, in their order, at place o
const listed = body => `for (i = 0; (i | 0) < 8; i = (i + 1) | 0) if (op & (1 << i)) { ${body} o = (o + 4) | 0; cycles = (cycles + 1) | 0; }`;
const pushed = listed(`I32[(o + ${RAM_AT}) >> 2] = ${reg('i')};`);
const popped = listed(`${reg('i')} = I32[(o + ${RAM_AT}) >> 2];`);
const wordAt = (to, address) => `
  o = (${address} - ${RAM}) | 0;
  if (${FLASH(address)}) ${to} = U16[(${address} & 0xffffff) >> 1] | 0;
  else if (${inRam('o')}) ${to} = U16[(o + ${RAM_AT}) >> 1] | 0;
  else if ((${address} >>> 0) < ${ROM_SIZE}) ${to} = U16[(${address} + ${ROM_AT}) >> 1] | 0;`;
// A switch over entries of [from, to, text]; what is in none is rare.
const cases = (from, to) => Array.from({ length: to - from + 1 }, (_, i) => `case ${from + i}:`).join(' ');
const switched = (value, entries) => `switch (${value}) {
${entries.map(([from, to, body]) => `${cases(from, to)} { ${body}\nbreak; }`).join('\n')}
default: rare = 1;
}`;
const RARE = '{ rare = 1; break instruction; }';

const OF_TWO_REGISTERS = [ // from, to, what it does
  [0, 0, `${set(LOW, 'a & b')} // ANDS`],
  [1, 1, `${set(LOW, 'a ^ b')} // EORS`],
  [2, 2, `// LSLS
    if (i) c = ((a & (1 << (32 - i))) != 0) | 0;
    ${set(LOW, '(i | 0) < 32 ? a << i : 0')}`],
  [3, 3, `// LSRS
    c = (i | 0) <= 32 ? (a >>> (i - 1)) & 1 : 0;
    ${set(LOW, '(i | 0) < 32 ? (a >>> i) | 0 : 0')}`],
  [4, 4, `// ASRS
    i = (i | 0) < 32 ? i : 32;
    c = (a >>> (i - 1)) & 1;
    ${set(LOW, 'a >> ((i | 0) < 32 ? i : 31)')}`],
  [5, 5, `// ADCS
    i = (a + c) | 0; r = (b + i) | 0;
    c = (c ? ((r >>> 0) <= (b >>> 0)) | 0 : ((r >>> 0) < (b >>> 0)) | 0);
    v = (b ^ r) & (i ^ r);
    ${set(LOW, 'r')}`],
  [6, 6, `// SBCS
    i = (b + 1 - c) | 0; r = (a - i) | 0;
    c = (c ? ((a >>> 0) >= (b >>> 0)) | 0 : ((a >>> 0) > (b >>> 0)) | 0);
    v = (a ^ i) & (a ^ r);
    ${set(LOW, 'r')}`],
  [7, 7, `// RORS
    i = i & 31;
    ${set(LOW, '(a >>> i) | (a << (32 - i))')}
    c = r >>> 31;`],
  [8, 8, `r = a & b; n = r; z = r; // TST`],
  [9, 9, `a = 0; ${SUB} ${LOW} = r; // RSBS`],
  [10, 10, `${SUB} // CMP`],
  [11, 11, `${ADD} // CMN`],
  [12, 12, `${set(LOW, 'a | b')} // ORRS`],
  [13, 13, `${set(LOW, 'imul(a, b) | 0')} // MULS`],
  [14, 14, `${set(LOW, 'a & ~b')} // BICS`],
  [15, 15, `${set(LOW, '~b')} // MVNS`],
];
// what each upper byte of an instruction stands for: from, to, what it does
const INSTRUCTIONS = [
  [0x00, 0x07, `// LSLS
      b = (op >> 6) & 31; a = ${MIDDLE} | 0;
      if (b) c = (a >>> (32 - b)) & 1;
      ${set(LOW, 'a << b')}`],
  [0x08, 0x0f, `// LSRS
      b = (op >> 6) & 31; a = ${MIDDLE} | 0;
      c = (a >>> ((b ? b : 32) - 1)) & 1;
      ${set(LOW, 'b ? (a >>> b) | 0 : 0')}`],
  [0x10, 0x17, `// ASRS
      b = (op >> 6) & 31; b = b ? b : 32; a = ${MIDDLE} | 0;
      c = (a >>> (b - 1)) & 1;
      ${set(LOW, 'a >> ((b | 0) < 32 ? b : 31)')}`],
  [0x18, 0x19, `a = ${MIDDLE} | 0; b = ${HIGH} | 0; ${ADD} ${LOW} = r;`],
  [0x1a, 0x1b, `a = ${MIDDLE} | 0; b = ${HIGH} | 0; ${SUB} ${LOW} = r;`],
  [0x1c, 0x1d, `a = ${MIDDLE} | 0; b = (op >> 6) & 7; ${ADD} ${LOW} = r;`],
  [0x1e, 0x1f, `a = ${MIDDLE} | 0; b = (op >> 6) & 7; ${SUB} ${LOW} = r;`],
  [0x20, 0x27, `${set(UPPER, 'op & 0xff')} // MOVS`],
  [0x28, 0x2f, `a = ${UPPER} | 0; b = op & 0xff; ${SUB} // CMP`],
  [0x30, 0x37, `a = ${UPPER} | 0; b = op & 0xff; ${ADD} ${UPPER} = r;`],
  [0x38, 0x3f, `a = ${UPPER} | 0; b = op & 0xff; ${SUB} ${UPPER} = r;`],
  [0x40, 0x43, `a = ${LOW} | 0; b = ${MIDDLE} | 0; i = b & 0xff; ${switched('(op >> 6) & 15', OF_TWO_REGISTERS)}`],
  [0x44, 0x44, `// ADD
      a = ((op >> 4) & 8) | (op & 7); b = (op >> 3) & 15;
      if ((a | 0) == 15) ${RARE}
      if ((b | 0) == 15) ${RARE}
      r = ((${reg('a')} | 0) + (${reg('b')} | 0)) | 0;
      ${reg('a')} = (a | 0) == 13 ? r & -4 : r;`],
  [0x45, 0x45, `// CMP
      a = ((op >> 4) & 8) | (op & 7); b = (op >> 3) & 15;
      if ((a | 0) == 15) ${RARE}
      if ((b | 0) == 15) ${RARE}
      a = ${reg('a')} | 0; b = ${reg('b')} | 0;
      ${SUB}`],
  [0x46, 0x46, `// MOV
      a = ((op >> 4) & 8) | (op & 7); b = (op >> 3) & 15;
      r = (b | 0) == 15 ? (pc + 4) | 0 : ${reg('b')} | 0;
      if ((a | 0) == 15) { next = r & -2; cycles = 2; }
      else ${reg('a')} = (a | 0) == 13 ? r & -4 : r;`],
  [0x47, 0x47, `// BX, BLX
      b = (op >> 3) & 15; a = ${reg('b')} | 0;
      if (op & 7) ${RARE}
      if ((b | 0) == 15) ${RARE}
      if (op & 0x80) ${LR} = (pc + 2) | 1;
      else if ((a >>> 28 | 0) == 15) ${RARE} // a return from an exception
      next = a & -2;
      cycles = 2;`],
  [0x48, 0x4f, `// LDR, literal
      address = (((pc + 4) & -4) + ((op & 0xff) << 2)) | 0; o = (address - ${RAM}) | 0; cycles = 2;
      if (${FLASH('address')}) {
        stall = (stall + (cached(address >>> 2) | 0)) | 0;
        ${UPPER} = I32[(address & 0xffffff) >> 2];
      } else if (${inRam('o')}) ${UPPER} = I32[(o + ${RAM_AT}) >> 2];
      else rare = 1;`],
  [0x50, 0x51, `${store(PAIR, 'I32', 2, 0)}`],
  [0x52, 0x53, `${store(PAIR, 'U16', 1, 1)}`],
  [0x54, 0x55, `${store(PAIR, 'U8', 0, 2)}`],
  [0x56, 0x57, `${load(PAIR, 'I8', 0, 4)}`],
  [0x58, 0x59, `${load(PAIR, 'I32', 2, 0)}`],
  [0x5a, 0x5b, `${load(PAIR, 'U16', 1, 1)}`],
  [0x5c, 0x5d, `${load(PAIR, 'U8', 0, 2)}`],
  [0x5e, 0x5f, `${load(PAIR, 'I16', 1, 3)}`],
  [0x60, 0x67, `${store(OFFSET(2), 'I32', 2, 0)}`],
  [0x68, 0x6f, `${load(OFFSET(2), 'I32', 2, 0)}`],
  [0x70, 0x77, `${store(OFFSET(0), 'U8', 0, 2)}`],
  [0x78, 0x7f, `${load(OFFSET(0), 'U8', 0, 2)}`],
  [0x80, 0x87, `${store(OFFSET(1), 'U16', 1, 1)}`],
  [0x88, 0x8f, `${load(OFFSET(1), 'U16', 1, 1)}`],
  [0x90, 0x97, `// STR, to the stack
      o = ((${SP} | 0) + ((op & 0xff) << 2) - ${RAM}) | 0; cycles = 2;
      if (${inRam('o')}) I32[(o + ${RAM_AT}) >> 2] = ${UPPER}; else rare = 1;`],
  [0x98, 0x9f, `// LDR, from the stack
      o = ((${SP} | 0) + ((op & 0xff) << 2) - ${RAM}) | 0; cycles = 2;
      if (${inRam('o')}) ${UPPER} = I32[(o + ${RAM_AT}) >> 2]; else rare = 1;`],
  [0xa0, 0xa7, `${UPPER} = ((pc & -4) + 4 + ((op & 0xff) << 2)) | 0; // ADR`],
  [0xa8, 0xaf, `${UPPER} = ((${SP} | 0) + ((op & 0xff) << 2)) | 0; // ADD, of the stack pointer`],
  [0xb0, 0xb0, `// ADD, SUB, to the stack pointer
      r = (op & 0x7f) << 2;
      ${SP} = ((${SP} | 0) + (op & 0x80 ? (0 - r) | 0 : r)) & -4;`],
  [0xb2, 0xb2, `// SXTH, SXTB, UXTH, UXTB
      r = ${MIDDLE} | 0;
      if (op & 0x80) r = r & (op & 0x40 ? 0xff : 0xffff);
      else { i = op & 0x40 ? 24 : 16; r = (r << i) >> i; }
      ${LOW} = r;`],
  [0xb4, 0xb5, `// PUSH
      r = ${SP} | 0;
      for (i = 0; (i | 0) < 9; i = (i + 1) | 0) if (op & (1 << i)) r = (r - 4) | 0;
      o = (r - ${RAM}) | 0;
      if (!(${inRam('o', 36)})) ${RARE}
      ${SP} = r;
      ${pushed}
      if (op & 0x100) { I32[(o + ${RAM_AT}) >> 2] = ${LR}; cycles = (cycles + 1) | 0; }`],
  [0xb6, 0xb6, `if ((op | 0) == 0xb672) mask = 1; // CPSID
      else if ((op | 0) == 0xb662) { mask = 0; attention = 1; } // CPSIE
      else rare = 1;`],
  [0xba, 0xba, `if (op & 0xc0) ${RARE} // REV
      a = ${MIDDLE} | 0;
      ${LOW} = (a << 24) | ((a & 0xff00) << 8) | ((a >> 8) & 0xff00) | (a >>> 24);`],
  [0xbc, 0xbd, `// POP
      o = ((${SP} | 0) - ${RAM}) | 0;
      if (!(${inRam('o', 36)})) ${RARE}
      if (op & 0x100) {
        a = o;
        for (i = 0; (i | 0) < 8; i = (i + 1) | 0) if (op & (1 << i)) a = (a + 4) | 0;
        r = I32[(a + ${RAM_AT}) >> 2] | 0;
        if ((r >>> 28 | 0) == 15) ${RARE} // a return from an exception
        next = r & -2;
        cycles = 4;
      }
      ${popped}
      ${SP} = (o + (op & 0x100 ? 4 : 0) + ${RAM}) | 0;`],
  [0xc0, 0xc7, `// STM
      i = (op >> 8) & 7; a = ${reg('i')} | 0; o = (a - ${RAM}) | 0;
      if (!(${inRam('o', 36)})) ${RARE}
      if (a & 3) ${RARE}
      ${pushed}
      if (!(op & (1 << ((op >> 8) & 7)))) ${UPPER} = (o + ${RAM}) | 0;`],
  [0xc8, 0xcf, `// LDM
      i = (op >> 8) & 7; a = ${reg('i')} | 0; o = (a - ${RAM}) | 0;
      if (!(${inRam('o', 36)})) ${RARE}
      if (a & 3) ${RARE}
      ${popped}
      if (!(op & (1 << ((op >> 8) & 7)))) ${UPPER} = (o + ${RAM}) | 0;`],
  ...[
    '!z', 'z', 'c', '!c', '(n | 0) < 0', '(n | 0) >= 0', '(v | 0) < 0', '(v | 0) >= 0', // EQ NE CS CC MI PL VS VC
    'c ? z : 0', 'c ? !z : 1', '(n ^ v | 0) >= 0', '(n ^ v | 0) < 0', // HI LS GE LT
    'z ? (n ^ v | 0) >= 0 : 0', 'z ? (n ^ v | 0) < 0 : 1', // GT LE
  ].map((condition, i) => [0xd0 + i, 0xd0 + i, `if (${condition}) { next = (pc + 4 + ((op << 24) >> 23)) | 0; cycles = 2; }`]),
  [0xe0, 0xe7, `next = (pc + 4 + ((op << 21) >> 20)) | 0; cycles = 2; // B`],
  [0xf0, 0xf7, `op2 = 0;
      ${wordAt('op2', 'next')}
      if ((op2 & 0xd000) == 0xd000) { // BL
        ${LR} = (pc + 4) | 1;
        r = (op >> 10) & 1;
        a = 1 - (r ^ ((op2 >> 13) & 1)) | 0;
        b = 1 - (r ^ ((op2 >> 11) & 1)) | 0;
        r = (r ? -16777216 : 0) | (a << 23) | (b << 22) | ((op & 0x3ff) << 12) | ((op2 & 0x7ff) << 1);
      } else if ((op | 0) == 0xf3bf) { // DSB, DMB, ISB
        i = (op2 - 0x8f40) | 0;
        if ((i >>> 0) >= 0x30) ${RARE}
        r = 0;
      } else if ((op | 0) == 0xf3ef) { // MRS, of PRIMASK
        if ((op2 & 0xf0ff) != 0x8010) ${RARE}
        i = (op2 >> 8) & 15;
        if ((i | 0) > 12) ${RARE}
        ${reg('i')} = mask;
        r = 0;
      } else if ((op & 0xfff0) == 0xf380) { // MSR, of PRIMASK
        if ((op2 & 0xffff) != 0x8810) ${RARE}
        i = op & 15;
        if ((i | 0) > 12) ${RARE}
        mask = ${reg('i')} & 1;
        attention = 1;
        r = 0;
      } else ${RARE}
      if (${FLASH('next')}) stall = (stall + (cached(next >>> 2) | 0)) | 0;
      next = (pc + 4 + r) | 0;
      cycles = 3;`],
];

const text = `
'use strict';
const I32 = new Int32Array(heap), U16 = new Uint16Array(heap), I16 = new Int16Array(heap);
const U8 = new Uint8Array(heap), I8 = new Int8Array(heap), imul = Math.imul;
const interrupt = calls.interrupt, chain = calls.chain, load = calls.load, store = calls.store, miss = calls.miss;
const sioLoad = calls.sioLoad, sioStore = calls.sioStore;

// Have a word of flash in its cache (FlashCache.read). Returns the cycles that this takes.
function cached(word) {
  word = word | 0;
  var place = 0;
  place = word & 2047;
  if ((I32[(${WAY0} + (place << 2)) >> 2] | 0) == (word | 0)) { U8[${OLDER} + (place >> 1)] = 1; return 0; }
  if ((I32[(${WAY1} + (place << 2)) >> 2] | 0) == (word | 0)) { U8[${OLDER} + (place >> 1)] = 0; return 0; }
  return miss(word | 0, place | 0) | 0;
}

// Execute instructions for so many cycles, or until the core has touched something or waits.
function execute(last) {
  last = last | 0;
  var ran = 0, pc = 0, ahead = 0, attention = 0, goes = 0, mask = 0, n = 0, z = 0, c = 0, v = 0, r = 0, a = 0, b = 0, i = 0, o = 0;
  var op = 0, op2 = 0, word = 0, rare = 0, cycles = 0, stall = 0, next = 0, address = 0, kind = 0;
  pc = ${reg(15)} & -2;
  ${resumeAll}
  do {
    stall = 0;
    if (attention) {
      ${leaveAll}
      stall = interrupt() | 0;
      pc = ${reg(15)} & -2;
      ${resumeAll}
    }
    rare = 0; cycles = 1; next = (pc + 2) | 0;
    if (${FLASH('pc')}) {
      word = pc >>> 2;
      if ((word | 0) != (ahead | 0)) { stall = (stall + (cached(word) | 0)) | 0; ahead = word; }
      if (pc & 2) { ahead = (word + 1) | 0; stall = (stall + (cached(ahead) | 0)) | 0; }
      op = U16[(pc & 0xffffff) >> 1] | 0;
    } else { op = 0xffff; ${wordAt('op', 'pc')} }
    instruction: do {
${switched('op >> 8', INSTRUCTIONS)}
    } while (0);
    if (rare) {
      ${leaveAll}
      cycles = chain() | 0;
      next = ${reg(15)} & -2;
      ${resumeAll}
    }
    ran = (ran + cycles + stall) | 0;
    pc = next;
  } while ((ran | 0) < (last | 0) ? goes : 0);
  ${leaveAll}
}
return execute;
`;
const execute = new Function('calls', 'heap', text)(calls, memory);
