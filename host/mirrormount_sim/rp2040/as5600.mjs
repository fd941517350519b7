// An AS5600 on one of the board's I2C buses: the registers that a reader of the angle needs, with the bus's time.
import { I2CMode } from 'rp2040js';

const ADDRESS = 0x36;
const NO_ANSWER = 0xffff;
const [STATUS, RAW_HIGH, RAW_LOW, HIGH, LOW] = [0x0b, 0x0c, 0x0d, 0x0e, 0x0f];
const MAGNET = 1 << 5;
const BITS = 9; // a byte and its acknowledge
const TX_EMPTY = 1 << 4; // of IC_RAW_INTR_STAT

// angle() returns 0 ... 4095, or NO_ANSWER.
export function attachAs5600(i2c, mcu, angle) {
  let register = 0, pointed = false, latched = 0;
  const after = done => {
    const hz = mcu.clkSys / (i2c.sclHighPeriod + i2c.sclLowPeriod);
    mcu.clock.createAlarm(done).schedule(BITS * 1e9 / Math.min(hz, 1e6));
  };
  const read = () => {
    if (register === STATUS) return MAGNET;
    if (register === RAW_HIGH || register === HIGH) { latched = angle(); return latched >> 8; }
    return register === RAW_LOW || register === LOW ? latched & 255 : 0;
  };
  // the chip's FIFO is empty after an abort, and says so: without it the SDK waits for its whole timeout
  const abort = i2c.abort.bind(i2c);
  i2c.abort = reason => { abort(reason); i2c.setInterrupts(TX_EMPTY); };
  i2c.onStart = () => i2c.completeStart();
  i2c.onConnect = (address, mode) => {
    pointed = mode === I2CMode.Read;
    after(() => i2c.completeConnect(address === ADDRESS && angle() !== NO_ANSWER));
  };
  i2c.onWriteByte = value => {
    if (!pointed) { register = value; pointed = true; }
    after(() => i2c.completeWrite(true));
  };
  i2c.onReadByte = () => {
    const value = read();
    register = (register + 1) & 255;
    after(() => i2c.completeRead(value));
  };
  i2c.onStop = () => i2c.completeStop();
}
