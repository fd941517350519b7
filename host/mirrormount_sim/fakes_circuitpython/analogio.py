"""analogio on the virtual CircuitPython board."""

import _chip
import _seam


class AnalogIn:
    """An analog input: the simulation tells its value as a level, 0 ... 65535. It keeps its pin until deinit()."""

    def __init__(self, pin):
        if pin.number not in (26, 27, 28, 29):
            raise ValueError("Pin does not have ADC capabilities")
        _chip.claim(pin, self)
        self._pin = pin

    def deinit(self):
        if self._pin is not None:
            _chip.release(self._pin)
            self._pin = None

    @property
    def value(self):
        if self._pin is None:
            raise _chip.deinited()
        _seam.seam.tick(30)
        return _seam.seam.levels.get(self._pin.number, 0)
