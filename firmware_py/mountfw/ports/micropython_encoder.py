"""Readers of encoders on MicroPython: PIO on an RP2040 or RP2350, machine.Encoder where a port has it, an AS5600.

encoders.py says what a reader is.
"""

# pyright: reportUndefinedVariable=false, reportAttributeAccessIssue=false
import time
from array import array

import machine
from machine import Pin

from mountfw import const
from mountfw.ports.encoders import Phases, Turns

try:
    import rp2
except ImportError:
    rp2 = None

_HZ = const(4_000_000)  # a turn of the program takes at most 14 cycles, 3.5 us: an edge each 4 us is seen
_FIFO = const(4)  # old words wait in there
_ADDRESS = const(0x36)  # AS5600 data sheet: its only one
_STATUS = const(0x0B)  # the register before RAW ANGLE
_TIMEOUT_US = const(2_000)  # an answer takes 0.2 ms; a stop waits as long for a bus that hangs
_AGAIN_MS = const(500)  # until a sensor that is gone is asked again: each OSError takes a piece of the heap


def reader(number, pins):
    """The reader of axis `number`'s encoder. None, after a printed line, where this MicroPython has no way to count."""
    if "shaft" in pins:
        return Shaft(*pins["shaft"])
    if rp2:
        return Edges(number - 1, pins["encoder"][0])
    if hasattr(machine, "Encoder"):
        return Counter(number - 1, pins["encoder"])
    print("mountfw: axis %d: encoder not fitted: this MicroPython has neither PIO nor machine.Encoder" % number)
    return None


if rp2:
    import micropython

    @rp2.asm_pio(in_shiftdir=rp2.PIO.SHIFT_LEFT)
    def quadrature():
        """X counts the edges of A and B; Y has in its lowest bits what they were at the last look.

        A look pushes X and them as one word, and jumps to 4 * before + now in the table. The table must begin at
        address 0: the program fills the memory of its PIO, so it lies nowhere else. Where the FIFO is full the word
        is dropped.
        """
        jmp("look")
        jmp("up")
        jmp("down")
        jmp("look")  # both changed: not counted
        jmp("down")
        jmp("look")
        jmp("look")
        jmp("up")
        jmp("up")
        jmp("look")
        jmp("look")
        jmp("down")
        jmp("look")
        jmp("down")
        jmp("up")
        jmp("look")
        label("down")
        jmp(x_dec, "look")
        label("look")
        mov(isr, x)
        in_(y, 2)
        push(noblock)
        in_(y, 2)
        in_(pins, 2)
        mov(y, isr)
        mov(pc, isr)
        label("up")
        mov(x, invert(x))
        jmp(x_dec, "next")
        label("next")
        mov(x, invert(x))
        jmp("look")
        nop()
        nop()
        nop()
        nop()

    class Edges(Phases):
        """Edges of A (pin `a`) and B (the next one), counted by state machine `number`."""

        gone = False

        def __init__(self, number, a):
            super().__init__()
            Pin(a + 1, Pin.IN, Pin.PULL_UP)
            counter = rp2.StateMachine(  # pyright: ignore[reportOptionalMemberAccess]
                number, quadrature, freq=_HZ, in_base=Pin(a, Pin.IN, Pin.PULL_UP)
            )
            counter.active(1)
            self._get = counter.get
            self._words = array("i", [0] * (_FIFO + 2))

        @micropython.viper
        def counts(self) -> int:
            """The edges so far; A before B is positive."""
            self._get(self._words)
            word = ptr32(self._words)[_FIFO + 1]
            phase = word & 3
            if ((word >> 2) - (phase ^ phase >> 1)) & 3 != int(self._apart):  # a slip
                return int(self.take(word))
            return word >> 2


class Counter:
    """Edges by a counter of the chip's own."""

    gone = False
    slips = 0
    play_us = 0

    def __init__(self, number, pins):
        pin_a, pin_b = [Pin(pin, Pin.IN, Pin.PULL_UP) for pin in pins]
        self._value = getattr(machine, "Encoder")(number, pin_a, pin_b, phases=4).value  # noqa: B009

    def counts(self):
        """The edges so far."""
        return self._value()


class Shaft(Turns):
    """An AS5600 on a bus of its own."""

    def __init__(self, sda, scl):
        super().__init__()
        bus = machine.I2C(sda >> 1 & 1, scl=Pin(scl), sda=Pin(sda), freq=400_000, timeout=_TIMEOUT_US)
        self._read = bus.readfrom_mem_into
        self._answer = bytearray(3)
        self._left_at = None  # when it did not answer last, if it is gone

    def counts(self):
        """4096 a turn; the lowest 12 bits are the angle."""
        if self._left_at is not None and time.ticks_diff(time.ticks_ms(), self._left_at) < _AGAIN_MS:
            return self.count
        answer = self._answer
        try:
            self._read(_ADDRESS, _STATUS, answer)
        except OSError:
            if self.silent():
                self._left_at = time.ticks_ms()
        else:
            self._left_at = None
            self.take(answer[0], answer[1], answer[2])
        return self.count
