// Model of the RP2040's flash cache (XIP): a word of flash that is not in it stalls the processor, by cycles that
// follow from the SSI's registers. core.mjs puts its calls into the processor. The scores of real Picos in MicroPython's
// benchmarks judge it (tests/emulated/test_flash_cache.py): they are met to +-25 %, the effect of code layout.
// Not modelled: the second core, reads by DMA, contention of the bus.

const SIZE_BYTES = 16 * 1024; // RP2040 datasheet, 2.6.3.1; two ways, a hit stalls for 0 cycles: the same place
const LINE_BYTES = 8; // RP2040 datasheet, 2.6.3.2
// A miss reads one word of 4 bytes, not the line, which has two valid bits: Wren6991 in raspberrypi/pico-feedback#307,
// pico-sdk 2.2.0 src/rp2_common/hardware_xip_cache/xip_cache.c ("two valid flags per cache line").
const WORDS = SIZE_BYTES / 4 / 2; // of a way
const SETS = SIZE_BYTES / LINE_BYTES / 2;
// The way to fill is the one used longer ago. Not documented. Random replacement changed the mean score by 0.2 %.
// An instruction in the upper half of a word has the next word fetched before it is decided: fetches have 32 bits, the
// pipeline two stages (Cortex-M0+ TRM, 1.1, 3.2). The order of the two is not documented. Without it scores rise by 1 %.

// Serial clocks of a transfer beside those of command, address, wait and data: chip select, hand-over to the bus.
// Not documented. oberon-rtk.org measured about 400 ns a load without the cache at clk_sys / 4: 25 clocks where the
// others are 20. 0 is the least it can be, and raises the mean score by 2 %.
const OVERHEAD_CLOCKS = 5;

// Offsets of the SSI's registers (RP2040 datasheet, 4.10.13).
const [CTRLR0, BAUDR, SPI_CTRLR0] = [0x00, 0x14, 0xf4];

// Cycles of clk_sys that a miss takes, for an SSI that reads words. register(offset): the value of an SSI register.
// The second-stage boot loader of an image sets them: with boot2_w25q080.S and PICO_FLASH_SPI_CLKDIV 2 (pico-sdk,
// src/boards/include/boards/pico.h) 8 clocks of address and mode, 4 of wait, 8 of data, 2 cycles each.
export function missCycles(register) {
  const control = register(CTRLR0), spi = register(SPI_CTRLR0), divider = register(BAUDR) & 0xfffe;
  const lines = [1, 2, 4, 1][(control >>> 21) & 3]; // SPI_FRF
  const kind = spi & 3; // TRANS_TYPE: 0 all on one line, 1 the command on one, 2 nothing on one
  const commandBits = [0, 4, 8, 16][(spi >>> 8) & 3]; // INST_L
  const addressBits = ((spi >>> 2) & 15) * 4; // ADDR_L
  const wait = lines > 1 ? (spi >>> 11) & 31 : 0; // WAIT_CYCLES
  const dataBits = ((control >>> 16) & 31) + 1; // DFS_32
  const command = commandBits / (kind === 2 ? lines : 1);
  const address = addressBits / (kind === 0 ? 1 : lines);
  return Math.round(divider * (command + address + wait + dataBits / lines + OVERHEAD_CLOCKS));
}

// What the processor reads is named by word: address >>> 2. stall collects cycles until the processor counts them.
export class FlashCache {
  // Two Int32Array of WORDS and a Uint8Array of SETS.
  constructor(way0, way1, older) {
    this.way0 = way0; // the word that each place holds, or -1
    this.way1 = way1;
    this.older = older; // the way that was used longer ago
    this.reset();
  }
  reset() {
    this.cost = 0; // cycles of a miss; 0 until the SSI is set up
    this.stall = 0;
    this.ahead = -1; // the word that was fetched last
    this.older.fill(0);
    this.flush();
  }
  flush() {
    this.way0.fill(-1);
    this.way1.fill(-1);
    this.ahead = -1;
  }
  // Fetch the instruction at an address, unless it is in the lower half of the word `ahead`.
  fetch(address) {
    const word = address >>> 2;
    if (word !== this.ahead) this.read(word);
    if (address & 2) this.read(word + 1);
    this.ahead = address & 2 ? word + 1 : word;
  }
  read(word) {
    const place = word & (WORDS - 1);
    if (this.way0[place] === word) this.older[place >>> 1] = 1;
    else if (this.way1[place] === word) this.older[place >>> 1] = 0;
    else this.miss(word, place);
  }
  bypass() { this.stall += this.cost; } // a read of one of the aliases that do not use the cache
  miss(word, place) {
    this.stall += this.cost;
    const { way0, way1 } = this;
    const other = place ^ 1; // the other half of the line
    let way = this.older[place >>> 1];
    if (way0[other] === (word ^ 1)) way = 0;
    else if (way1[other] === (word ^ 1)) way = 1;
    else {
      if (way0[place] < 0 && way0[other] < 0) way = 0;
      else if (way1[place] < 0 && way1[other] < 0) way = 1;
      (way ? way1 : way0)[other] = -1;
    }
    (way ? way1 : way0)[place] = word;
    this.older[place >>> 1] = way ^ 1;
  }
}
