// Rewrites rp2040js' processor, CortexM0Core, of which the original is kept beside it. May be run again at any time.
//
// - More than three times faster: executeInstruction becomes a table-driven switch instead of a chain of tests, and
//   accesses to RAM, flash and the boot ROM get a short way. The bodies of the instructions are moved, not changed; flags
//   are computed in 32-bit integers. run() executes many instructions: the clock is brought up to date before an access
//   to anything but memory, and after it the next alarm is looked up again.
// - What is read from flash passes a model of its cache, core.cache (cache.mjs), which stalls the processor.
// - PUSH, POP and exceptions take the cycles of the Cortex-M0+.
// - An interrupt that is pending but masked wakes the core from WFI.
//
// usage: node core.mjs NODE_MODULES
import fs from 'node:fs';
import path from 'node:path';

// Cycles that rp2040js leaves out. Cortex-M0+ TRM, table 3-1: PUSH with LR takes 1 + N, POP with PC 3 + N, where LR and
// PC are of the N; 3.6: an exception is taken in 15.
const STACKED_CYCLES = 1;
const EXCEPTION_CYCLES = 15;

const file = path.join(process.argv[2], 'rp2040js/dist/esm/cortex-m0-core.js');
const original = file + '.orig';
if (!fs.existsSync(original)) fs.copyFileSync(file, original);
let source = fs.readFileSync(original, 'utf8');

// Replace `from`, which must be there `count` times.
function swap(from, to, count = 1) {
  const found = source.split(from).length - 1;
  if (found !== count) throw new Error(`${found} times instead of ${count}: ${from}`);
  source = source.split(from).join(to);
}

// ---- the instructions: a switch over the kind of each of the 65536 first half-words

const lines = source.split('\n');
const start = lines.findIndex(l => l === '    executeInstruction() {');
const end = lines.findIndex((l, i) => i > start && l === '    }');
const chainStart = lines.findIndex((l, i) => i > start && /^        let deltaCycles = 1;/.test(l)) + 1;
const chainEnd = lines.findIndex((l, i) => i > start && /^        this\.cycles \+= deltaCycles;/.test(l));
const branches = [];
let branch = null;
for (let i = chainStart; i < chainEnd; i++) {
  const line = lines[i];
  const condition = /^        (?:else )?if \((.*)\) \{$/.exec(line);
  if (condition || /^        else \{$/.test(line)) branches.push(branch = { condition: condition?.[1] ?? null, body: [] });
  else if (line === '        }') branch = null;
  else if (branch) branch.body.push(line);
  else if (!/^\s*\/\//.test(line) && line.trim()) throw new Error(`line ${i} is not understood: ${line}`);
}
if (branches.length < 70 || branches.at(-1).condition !== null) throw new Error(`unexpected: ${branches.length} kinds`);
const tests = branches.map(({ condition }) => {
  if (condition === null) return () => true;
  return condition.includes('opcode2') ? null : new Function('opcode', 'return ' + condition);
});
const WIDE = branches.length; // instructions of two half-words: BL, and others that go through the original chain
const kinds = new Uint8Array(65536);
for (let opcode = 0; opcode < 65536; opcode++) {
  const wide = opcode >> 12 === 15 || opcode >> 11 === 29;
  kinds[opcode] = wide ? WIDE : tests.findIndex(test => test && test(opcode));
}
const branchLink = branches.find(b => b.condition?.startsWith('opcode >> 11 === 0b11110 && opcode2 >> 14 === 0b11'));
const COUNT = `        if (this.cache.stall) { deltaCycles += this.cache.stall; this.cache.stall = 0; }
        this.cycles += deltaCycles;
        return deltaCycles;`;
const cases = [...new Set(kinds)].filter(kind => kind !== WIDE).flatMap(kind => [
  `        case ${kind}: { // ${branches[kind].condition ?? 'else'}`, ...branches[kind].body, '            break;', '        }',
]);
const execute = `    executeInstruction() {
        if (this.interruptsUpdated) { if (this.checkForInterrupts()) { this.waiting = false; } }
        const opcodePC = this.registers[15] & ~1;
        let opcode;
        if ((opcodePC >>> 24) === 0x10) {
            if (opcodePC & 2 || opcodePC >>> 2 !== this.cache.ahead) this.cache.fetch(opcodePC);
            opcode = this.flash16[(opcodePC & 0xffffff) >> 1];
        } else opcode = this.readUint16(opcodePC);
        const kind = OPTABLE[opcode];
        if (kind === ${WIDE}) {
            const opcode2 = this.readUint16((opcodePC + 2) >>> 0);
            if (!(${branchLink.condition})) return this.executeInstructionSlow();
            let deltaCycles = 1; this.registers[15] += 2;
${branchLink.body.join('\n')}
${COUNT}
        }
        const opcode2 = 0;
        this.registers[15] += 2;
        let deltaCycles = 1;
        switch (kind) {
${cases.join('\n')}
        }
${COUNT}
    }
    // Execute until the next alarm or \`end\`, an access to anything but memory, or a wait; the clock is then right.
    run(clock, cycle, end) {
        this.clock = clock; this.cycle = cycle; this.ran = 0; this.touched = false;
        const alarm = clock.nextAlarm;
        const ns = (alarm !== null && alarm.nanos < end ? alarm.nanos : end) - clock.nanosCounter;
        const last = Math.ceil(ns / cycle);
        do {
            const cycles = this.executeInstruction(); // it may set \`ran\`
            this.ran += cycles;
        } while (this.ran < last && !this.touched && !this.waiting);
        const passed = this.ran * cycle;
        this.ran = 0;
        clock.tick(passed);
    }
    touch() {
        this.touched = true;
        this.clock.nanosCounter += this.ran * this.cycle;
        this.ran = 0;
    }`;
const slow = ['    executeInstructionSlow() {', ...lines.slice(start + 1, end + 1)];
source = [...lines.slice(0, start), execute, ...slow, ...lines.slice(end + 1)].join('\n');
swap(`        }\n        this.cycles += deltaCycles;\n        return deltaCycles;`, `        }\n${COUNT}`); // the original chain
const table = Buffer.from(kinds).toString('base64');
swap('export class CortexM0Core {', `const OPTABLE = new Uint8Array(Buffer.from('${table}', 'base64'));\nexport class CortexM0Core {`);

// ---- memory

function replaceMethod(name, parameters, body) {
  const method = new RegExp(`    ${name}\\(${parameters}\\) \\{\\n[^\\n]*\\n    \\}`);
  if (!method.test(source)) throw new Error(`no ${name}`);
  source = source.replace(method, `    ${name}(${parameters}) {
        address = address >>> 0; const o = (address - 0x20000000) >>> 0;
${body}
    }`);
}
for (const [bits, shift] of [[32, 2], [16, 1], [8, 0]]) {
  const aligned = shift ? ` && !(address & ${(1 << shift) - 1})` : '';
  replaceMethod(`readUint${bits}`, 'address', `        if (o < 0x42000${aligned}) return this.sram${bits}[o >>> ${shift}];
        if ((address >>> 24) === 0x10${aligned}) { this.cache.read(address >>> 2); return this.flash${bits}[(address & 0xffffff) >>> ${shift}]; }
${bits > 8 ? `        if (address < 0x4000${aligned}) return this.rom${bits}[address >>> ${shift}];
` : ''}        if ((address >>> 26) === 4) this.cache.bypass();
        this.touch();
        return this.rp2040.readUint${bits}(address);`);
  replaceMethod(`writeUint${bits}`, 'address, value', `        if (o < 0x42000${aligned}) { this.sram${bits}[o >>> ${shift}] = value; return; }
        this.touch();
        this.rp2040.writeUint${bits}(address, value);`);
}
swap('        this.rp2040 = rp2040;\n', `        this.rp2040 = rp2040;
        this.cache = null; // set before the first instruction
        this.sram8 = rp2040.sram; this.sram16 = new Uint16Array(rp2040.sram.buffer); this.sram32 = new Uint32Array(rp2040.sram.buffer);
        this.flash8 = rp2040.flash; this.flash16 = rp2040.flash16; this.flash32 = new Uint32Array(rp2040.flash.buffer);
        this.rom32 = rp2040.bootrom; this.rom16 = new Uint16Array(rp2040.bootrom.buffer);
        this.clock = rp2040.clock; this.cycle = this.ran = 0; this.touched = false;
`);

// ---- flags, and the cycles of an access

function replaceBody(head, body) {
  const at = source.indexOf(`    ${head} {\n`), to = source.indexOf('\n    }\n', at);
  if (at < 0 || to < 0) throw new Error(`no ${head}`);
  source = source.slice(0, at) + `    ${head} {\n${body}\n    }` + source.slice(to + 6);
}
replaceBody('substractUpdateFlags(minuend, subtrahend)', `        const result = (minuend - subtrahend) | 0;
        this.N = result < 0;
        this.Z = result === 0;
        this.C = minuend >= subtrahend;
        this.V = ((minuend ^ subtrahend) & (minuend ^ result)) < 0;
        return result;`);
replaceBody('addUpdateFlags(addend1, addend2)', `        const sum = addend1 + addend2, result = sum | 0;
        this.N = result < 0;
        this.Z = result === 0;
        this.C = sum > 0xffffffff;
        this.V = ((addend1 ^ result) & (addend2 ^ result)) < 0;
        return result;`);
replaceBody('cyclesIO(addr, write = false)', `        const region = addr >>> 28; // 0xd: SIO, 4: APB
        return region === 0xd ? 0 : region === 4 ? (write ? 4 : 3) : 1;`);

// ---- cycles, and waking up. The instructions stand twice, in the switch and in the original chain

const PUSH = 'this.writeUint32(address, this.registers[14]);';
swap(PUSH, `${PUSH} deltaCycles += ${STACKED_CYCLES};`, 2);
const POP = /(this\.BXWritePC\(this\.readUint32\(address\)\);\s*deltaCycles \+= 2);/g;
if (source.match(POP)?.length !== 2) throw new Error('POP is not as expected');
source = source.replace(POP, `$1 + ${STACKED_CYCLES};`);
swap('        const vectorTable = this.VTOR;\n', `        const vectorTable = this.VTOR;
        this.cache.stall += ${EXCEPTION_CYCLES};
`);
swap(`            if (this.waiting && this.checkForInterrupts()) {
                this.waiting = false;
            }`, `            if (this.waiting && this.PM) { if (this.pendingInterrupts & this.enabledInterrupts) this.waiting = false; } // masked: wake, do not enter
            else if (this.waiting && this.checkForInterrupts()) {
                this.waiting = false;
            }`);
fs.writeFileSync(file, source);
