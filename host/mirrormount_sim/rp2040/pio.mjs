// Time for the state machines of rp2040js' PIO. It would run them by timers of the host computer; here they are brought up
// to emulated time whenever something could tell the difference: a register is read or written, or an input changes.
// A program that polls inputs which do not change repeats itself: of such a stretch one round is executed, and as many
// more are skipped as fit. So each edge of an encoder is counted by the program's own instructions, and time between
// edges costs nothing. Not modelled: what a program puts out in between shows at the next such moment only.

const [CLKDIV, SHIFTCTRL, MACHINE, LAST] = [0xc8, 0xd0, 0x18, 0x128];
const [JOIN_TX, JOIN_RX] = [1 << 30, 1 << 31];
const LONGEST_ROUND = 200; // in instructions; of what takes longer each one is executed

// Returns two functions: bring the machines up to now, before an input changes; and see to it that they look at the
// change soon, for what they push then may pace a DMA that reads the clock.
const LOOK_NS = 500;
export function attachPio(mcu) {
  const blocks = mcu.pio.map(pio => new Timed(pio, mcu));
  const upToNow = () => { for (const block of blocks) block.catchUp(); };
  const soon = mcu.clock.createAlarm(upToNow);
  const look = () => { if (mcu.pio.some(pio => pio.machines.some(machine => machine.enabled))) soon.schedule(LOOK_NS); };
  return [upToNow, look];
}

class Timed {
  constructor(pio, mcu) {
    this.pio = pio;
    this.mcu = mcu;
    this.sinceNs = pio.machines.map(() => 0);
    pio.run = () => {};
    const read = pio.readUint32.bind(pio), write = pio.writeUint32.bind(pio);
    pio.readUint32 = offset => { this.catchUp(); return read(offset); };
    pio.writeUint32 = (offset, value) => {
      this.catchUp();
      write(offset, value);
      if (offset >= CLKDIV && offset < LAST && (offset - CLKDIV) % MACHINE === SHIFTCTRL - CLKDIV) this.join((offset - CLKDIV) / MACHINE | 0);
    };
  }
  join(index) { // the FIFOs' sizes (RP2040 datasheet, 3.5.6.1), which rp2040js leaves at 4
    const machine = this.pio.machines[index];
    const [rx, tx] = machine.shiftCtrl & JOIN_RX ? [8, 0] : machine.shiftCtrl & JOIN_TX ? [0, 8] : [4, 4];
    if (machine.rxFIFO.size === rx) return;
    machine.rxFIFO = new machine.rxFIFO.constructor(rx);
    machine.txFIFO = new machine.txFIFO.constructor(tx);
  }
  catchUp() {
    const now = this.mcu.clock.nanos;
    this.pio.machines.forEach((machine, i) => {
      const divider = (machine.clockDivInt || 65536) + machine.clockDivFrac / 256;
      const cycleNs = divider * 1e9 / this.mcu.clkSys;
      const cycles = Math.floor((now - this.sinceNs[i]) / cycleNs);
      if (!machine.enabled) this.sinceNs[i] = now;
      else if (cycles > 0) {
        this.sinceNs[i] += (cycles - this.execute(machine, cycles)) * cycleNs;
      }
    });
    this.pio.checkChangedPins();
  }
  execute(machine, cycles) { // returns what is left of them; less than 0 after an instruction with a delay
    let [round, executed, known, at] = [0, 0, '', -1]; // of the state to which it may return
    while (cycles > 0) {
      if (at === machine.pc) {
        const state = stateOf(machine, this.pio);
        if (state === known) { cycles %= round; if (!cycles) return 0; known = ''; at = -2; } // no second search
        else { known = state; round = executed = 0; }
      } else if (at === -1 || (at >= 0 && executed > LONGEST_ROUND)) {
        at = machine.pc;
        known = stateOf(machine, this.pio);
        round = executed = 0;
      }
      const before = machine.cycles;
      machine.step();
      const took = Math.max(1, machine.cycles - before);
      cycles -= took;
      round += took;
      executed++;
      if (machine.waiting) return 0; // until a register or an input changes
    }
    return cycles;
  }
}

function stateOf(m, pio) {
  return [m.x, m.y, m.inputShiftReg, m.inputShiftCount, m.outputShiftReg, m.outputShiftCount, m.rxFIFO.used, m.txFIFO.used, pio.irq].join();
}
