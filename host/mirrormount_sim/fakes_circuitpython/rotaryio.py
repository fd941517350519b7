"""rotaryio on the virtual CircuitPython board."""

import _chip
import _seam
from _quadrature import Quadrature


class IncrementalEncoder:
    """Counts in the background; with divisor 1 each edge counts."""

    def __init__(self, pin_a, pin_b, divisor=4):
        if divisor not in (1, 2, 4):
            raise ValueError("divisor must be 1, 2 or 4")
        if abs(pin_a.number - pin_b.number) != 1:
            raise RuntimeError("Pins must be sequential GPIO pins")
        for pin in (pin_a, pin_b):
            _chip.claim(pin, self)
        self._pins = (pin_a, pin_b)
        self._divisor = divisor
        self._counter = Quadrature(pin_a.number, pin_b.number)

    def deinit(self):
        if self._counter is not None:
            for pin in self._pins:
                _chip.release(pin)
            self._counter = None

    @property
    def position(self):
        if self._counter is None:
            raise _chip.deinited()
        _seam.seam.tick(5)
        return self._counter.count // self._divisor
