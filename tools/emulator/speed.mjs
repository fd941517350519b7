// Makes rp2040js more than three times faster: CortexM0Core.executeInstruction becomes a table-driven switch instead of
// a chain of tests, and accesses to RAM, flash and the boot ROM get a short way. The bodies of the instructions are
// moved, not changed; flags are computed in 32-bit integers. run() executes many instructions: the clock is brought up
// to date before an access to anything but memory, and after it the next alarm is looked up again. Also: an interrupt
// that is pending but masked wakes the core from WFI. May be run again at any time.
//
// usage: node speed.mjs NODE_MODULES
import fs from 'node:fs';
import path from 'node:path';
const f = path.join(process.argv[2], 'rp2040js/dist/esm/cortex-m0-core.js');
const orig = f + '.orig';
if (!fs.existsSync(orig)) fs.copyFileSync(f, orig);
let src = fs.readFileSync(orig, 'utf8');
const L = src.split('\n');
const start = L.findIndex(l => l === '    executeInstruction() {');
const end = L.findIndex((l, i) => i > start && l === '    }');
const chainStart = L.findIndex((l, i) => i > start && /^        let deltaCycles = 1;/.test(l)) + 1;
const chainEnd = L.findIndex((l, i) => i > start && /^        this\.cycles \+= deltaCycles;/.test(l));
const br = []; let cur = null;
for (let i = chainStart; i < chainEnd; i++) {
  const l = L[i]; const m = /^        (?:else )?if \((.*)\) \{$/.exec(l);
  if (m) { cur = { cond: m[1], body: [] }; br.push(cur); }
  else if (/^        else \{$/.test(l)) { cur = { cond: null, body: [] }; br.push(cur); }
  else if (l === '        }') cur = null;
  else if (cur) cur.body.push(l);
  else if (!/^\s*\/\//.test(l) && l.trim()) throw new Error('unparsed line ' + i + ': ' + l);
}
if (br.length < 70 || br.at(-1).cond !== null) throw new Error('unexpected shape ' + br.length);
const tests = br.map(b => b.cond === null ? () => true : b.cond.includes('opcode2') ? null : new Function('opcode', 'return ' + b.cond));
const wideIdx = br.length; // slow chain
const table = new Uint8Array(65536);
for (let op = 0; op < 65536; op++) {
  const wide = op >> 12 === 15 || op >> 11 === 29;
  table[op] = wide ? wideIdx : tests.findIndex(t => t && t(op));
}
const bl = br.findIndex(b => b.cond?.startsWith('opcode >> 11 === 0b11110 && opcode2 >> 14 === 0b11'));
const used = new Set(table);
const order = [...used].filter(k => k !== wideIdx);
const out = [];
out.push(`    executeInstruction() {
        if (this.interruptsUpdated) { if (this.checkForInterrupts()) { this.waiting = false; } }
        const opcodePC = this.registers[15] & ~1;
        const opcode = (opcodePC >>> 24) === 0x10 ? this.flash16[(opcodePC & 0xffffff) >> 1] : this.readUint16(opcodePC);
        const kind = OPTABLE[opcode];
        if (kind === ${wideIdx}) {
            const opcode2 = this.readUint16((opcodePC + 2) >>> 0);
            if (!(${br[bl].cond})) return this.executeInstructionSlow();
            let deltaCycles = 1; this.registers[15] += 2;
${br[bl].body.join('\n')}
            this.cycles += deltaCycles; return deltaCycles;
        }
        const opcode2 = 0;
        this.registers[15] += 2;
        let deltaCycles = 1;
        switch (kind) {`);
for (const k of order) out.push(`        case ${k}: { // ${br[k].cond ?? 'else'}`, ...br[k].body, '            break;', '        }');
out.push('        }', '        this.cycles += deltaCycles;', '        return deltaCycles;', '    }');
out.push(`    // Execute until the next alarm or \`end\`, an access to anything but memory, or a wait; the clock is then right.
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
    }`);
const slow = L.slice(start, end + 1); slow[0] = '    executeInstructionSlow() {';
let res = [...L.slice(0, start), ...out, ...slow, ...L.slice(end + 1)].join('\n');
// memory fast paths
const rep = (name, code) => { const re = new RegExp(`    ${name}\\(address(, value)?\\) \\{\\n[^\\n]*\\n    \\}`); if (!re.test(res)) throw new Error('no ' + name); res = res.replace(re, code); };
rep('readUint32', `    readUint32(address) {
        address = address >>> 0; const o = (address - 0x20000000) >>> 0;
        if (o < 0x42000 && !(address & 3)) return this.sram32[o >>> 2];
        if ((address >>> 24) === 0x10 && !(address & 3)) return this.flash32[(address & 0xffffff) >>> 2];
        if (address < 0x4000 && !(address & 3)) return this.rom32[address >>> 2];
        this.touch();
        return this.rp2040.readUint32(address);
    }`);
rep('readUint16', `    readUint16(address) {
        address = address >>> 0; const o = (address - 0x20000000) >>> 0;
        if (o < 0x42000 && !(address & 1)) return this.sram16[o >>> 1];
        if ((address >>> 24) === 0x10 && !(address & 1)) return this.flash16[(address & 0xffffff) >>> 1];
        if (address < 0x4000 && !(address & 1)) return this.rom16[address >>> 1];
        this.touch();
        return this.rp2040.readUint16(address);
    }`);
rep('readUint8', `    readUint8(address) {
        address = address >>> 0; const o = (address - 0x20000000) >>> 0;
        if (o < 0x42000) return this.sram8[o];
        if ((address >>> 24) === 0x10) return this.flash8[address & 0xffffff];
        this.touch();
        return this.rp2040.readUint8(address);
    }`);
rep('writeUint32', `    writeUint32(address, value) {
        address = address >>> 0; const o = (address - 0x20000000) >>> 0;
        if (o < 0x42000 && !(address & 3)) { this.sram32[o >>> 2] = value; return; }
        this.touch();
        this.rp2040.writeUint32(address, value);
    }`);
rep('writeUint16', `    writeUint16(address, value) {
        address = address >>> 0; const o = (address - 0x20000000) >>> 0;
        if (o < 0x42000 && !(address & 1)) { this.sram16[o >>> 1] = value; return; }
        this.touch();
        this.rp2040.writeUint16(address, value);
    }`);
rep('writeUint8', `    writeUint8(address, value) {
        address = address >>> 0; const o = (address - 0x20000000) >>> 0;
        if (o < 0x42000) { this.sram8[o] = value; return; }
        this.touch();
        this.rp2040.writeUint8(address, value);
    }`);
res = res.replace(/        this\.rp2040 = rp2040;\n/, m => m + `        this.sram8 = rp2040.sram; this.sram16 = new Uint16Array(rp2040.sram.buffer); this.sram32 = new Uint32Array(rp2040.sram.buffer);
        this.flash8 = rp2040.flash; this.flash16 = rp2040.flash16; this.flash32 = new Uint32Array(rp2040.flash.buffer);
        this.rom32 = rp2040.bootrom; this.rom16 = new Uint16Array(rp2040.bootrom.buffer);
        this.clock = rp2040.clock; this.cycle = this.ran = 0; this.touched = false;
`);
const body = (name, code) => {
    const at = res.indexOf(`    ${name} {\n`), to = res.indexOf('\n    }\n', at);
    if (at < 0 || to < 0) throw new Error('no ' + name);
    res = res.slice(0, at) + code + res.slice(to + 6);
};
body('substractUpdateFlags(minuend, subtrahend)', `    substractUpdateFlags(minuend, subtrahend) {
        const result = (minuend - subtrahend) | 0;
        this.N = result < 0;
        this.Z = result === 0;
        this.C = minuend >= subtrahend;
        this.V = ((minuend ^ subtrahend) & (minuend ^ result)) < 0;
        return result;
    }`);
body('addUpdateFlags(addend1, addend2)', `    addUpdateFlags(addend1, addend2) {
        const sum = addend1 + addend2, result = sum | 0;
        this.N = result < 0;
        this.Z = result === 0;
        this.C = sum > 0xffffffff;
        this.V = ((addend1 ^ result) & (addend2 ^ result)) < 0;
        return result;
    }`);
body('cyclesIO(addr, write = false)', `    cyclesIO(addr, write = false) {
        const region = addr >>> 28; // 0xd: SIO, 4: APB
        return region === 0xd ? 0 : region === 4 ? (write ? 4 : 3) : 1;
    }`);

const wk = "if (this.waiting && this.checkForInterrupts()) {\n                this.waiting = false;\n            }";
if (!res.includes(wk)) throw new Error('no wake code');
res = res.replace(wk, `if (this.waiting && this.PM) { if (this.pendingInterrupts & this.enabledInterrupts) this.waiting = false; } // masked: wake, do not enter
            else ` + wk);
const b64 = Buffer.from(table).toString('base64');
res = res.replace('export class CortexM0Core {', `const OPTABLE = new Uint8Array(Buffer.from('${b64}', 'base64'));\nexport class CortexM0Core {`);
fs.writeFileSync(f, res);
