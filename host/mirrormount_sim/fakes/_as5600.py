"""The AS5600 on a bus: its registers from 0x0b, as far as the firmware reads them."""

import _seam

ADDRESS = 0x36
_BUS = 64
_NO_ANSWER = 0xFFFF
_BIT_US = 3  # at 400 kHz, rounded up
_MAGNET = 1 << 5


def read(sda, address, register, buffer):
    """Fill buffer from the sensor on the bus with that SDA. Raises OSError if nothing answers."""
    s = _seam.seam
    angle = s.levels.get(_BUS + sda, _NO_ANSWER)
    s.tick(_BIT_US * 9 * 2)
    if address != ADDRESS or angle == _NO_ANSWER:
        raise OSError(5)
    s.tick(_BIT_US * 9 * (1 + len(buffer)))
    angle = s.levels.get(_BUS + sda, 0) & 4095
    for i in range(len(buffer)):
        buffer[i] = _register(register + i, angle)


def _register(number, angle):
    if number == 0x0B:
        return _MAGNET
    if number == 0x0C or number == 0x0E:
        return angle >> 8
    return angle & 255 if number == 0x0D or number == 0x0F else 0
