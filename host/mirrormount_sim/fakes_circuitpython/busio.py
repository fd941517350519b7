"""busio on the virtual CircuitPython board: a bus with at most an AS5600 on it."""

import _as5600
import _chip


class I2C:
    """The bus must be locked before it is used."""

    def __init__(self, scl, sda, *, frequency=100_000, timeout=255):
        if scl.number != sda.number + 1:
            raise ValueError("Invalid pins")
        for pin in (scl, sda):
            _chip.claim(pin, self)
        self._pins = (scl, sda)
        self._locked = False

    def deinit(self):
        if self._pins:
            for pin in self._pins:
                _chip.release(pin)
            self._pins = ()

    def try_lock(self):
        if self._locked:
            return False
        self._locked = True
        return True

    def unlock(self):
        if not self._locked:
            raise ValueError("Not locked")
        self._locked = False

    def writeto_then_readfrom(self, address, out_buffer, in_buffer):
        if not self._pins:
            raise _chip.deinited()
        if not self._locked:
            raise RuntimeError("Function requires lock")
        _as5600.read(self._pins[1].number, address, out_buffer[0], in_buffer)
