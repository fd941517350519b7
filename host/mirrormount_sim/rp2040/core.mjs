// Rewrites rp2040js' processor, CortexM0Core, of which the original is kept beside it. May be run again at any time.
//
// - Faster: execute.mjs executes nearly all instructions. What stays here gets a short way to the memories, and flags in
//   32-bit integers. The clock is brought up to date (touch) before an access to anything but memory.
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

// ---- instructions: the chain of tests stays, for what execute.mjs leaves to it

swap(`        this.cycles += deltaCycles;
        return deltaCycles;
    }`, `        if (this.cache.stall) { deltaCycles += this.cache.stall; this.cache.stall = 0; }
        this.cycles += deltaCycles;
        return deltaCycles;
    }
    touch() { // something that is not memory: the clock must be right
        this.touched = true;
        this.clock.nanosCounter += this.ran * this.cycle;
        this.ran = 0;
    }`);

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

// ---- cycles, and waking up

const PUSH = 'this.writeUint32(address, this.registers[14]);';
swap(PUSH, `${PUSH} deltaCycles += ${STACKED_CYCLES};`);
const POP = /(this\.BXWritePC\(this\.readUint32\(address\)\);\s*deltaCycles \+= 2);/g;
if (source.match(POP)?.length !== 1) throw new Error('POP is not as expected');
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
