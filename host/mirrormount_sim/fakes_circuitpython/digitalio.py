"""digitalio on the virtual CircuitPython board."""

import _chip
import _seam


class Direction:
    INPUT = "INPUT"
    OUTPUT = "OUTPUT"


class Pull:
    UP = "UP"
    DOWN = "DOWN"


class DigitalInOut:
    """One pin as a level. It keeps its pin until deinit()."""

    def __init__(self, pin):
        _chip.claim(pin, self)
        self._pin = pin
        self.direction = Direction.INPUT
        self.pull = None
        self._level = False

    def deinit(self):
        if self._pin is not None:
            _chip.release(self._pin)
            self._pin = None

    def switch_to_output(self, value=False):
        self._check()
        self.direction = Direction.OUTPUT
        self.pull = None
        self.value = value

    def switch_to_input(self, pull=None):
        self._check()
        if pull not in (None, Pull.UP, Pull.DOWN):
            raise ValueError("Invalid pull")
        self.direction = Direction.INPUT
        self.pull = pull

    @property
    def value(self):
        self._check()
        s = _seam.seam
        s.tick(2)
        if self.direction == Direction.OUTPUT:
            return self._level
        return bool(s.levels.get(self._pin.number, 1 if self.pull == Pull.UP else 0))

    @value.setter
    def value(self, level):
        self._check()
        if self.direction != Direction.OUTPUT:
            raise AttributeError("Cannot set value when direction is input.")
        s = _seam.seam
        s.tick(4)
        if bool(level) != self._level:
            self._level = bool(level)
            s.edge(self._pin.number, 65535 if level else 0)

    def _check(self):
        if self._pin is None:
            raise _chip.deinited()
