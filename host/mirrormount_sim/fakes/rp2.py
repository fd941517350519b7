"""rp2 on the virtual board: a state machine whose program counts a quadrature encoder. No other program runs here.

The program itself is not executed: what its words look like is agreed with ports/ of the firmware. The emulated
RP2040 executes it.
"""

import _seam
from _quadrature import Quadrature


class PIO:
    JOIN_NONE = 0
    JOIN_TX = 1
    JOIN_RX = 2
    SHIFT_LEFT = 0
    SHIFT_RIGHT = 1


def asm_pio(**_options):
    return lambda program: program


class StateMachine:
    """Each word it gives is count << 2 | B << 1 | A."""

    def __init__(self, id, program, *, freq=0, in_base=None):
        if not 0 <= id <= 7:
            raise ValueError("invalid state machine")
        if program.__name__ != "quadrature":
            raise ValueError("the virtual board counts a quadrature encoder, and runs no other program")
        self._counter = Quadrature(in_base.number, in_base.number + 1)
        self._runs = False

    def active(self, value=None):
        if value is not None:
            self._runs = bool(value)
        return self._runs

    def get(self, buffer=None, shift=0):
        s = _seam.seam
        s.tick(20 if buffer is None else 20 * len(buffer))
        if not self._runs:
            raise OSError("the state machine does not run")
        word = self._counter.count << 2 | self._counter.levels
        if buffer is None:
            return word & 0xFFFFFFFF
        for i in range(len(buffer)):
            buffer[i] = word
        return buffer
