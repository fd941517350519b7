"""The hardware's verbs on CircuitPython. Only ports/circuitpython*.py name its modules.

CircuitPython has no interrupts for Python code: end-stops are polled. Its finest clock that does not
allocate has steps of 1/1024 s. docs/circuitpython.md has what follows from both.
"""

import binascii
import gc
import os
import time

import microcontroller
import supervisor

from mountfw import codes
from mountfw.ports.circuitpython_console import any, drain, pack, writable, write  # noqa: F401 (verbs of this port, too)
from mountfw.ports.circuitpython_files import firmware_hash, load, remove, rename, store  # noqa: F401 (likewise)
from mountfw.ports.circuitpython_pins import (  # noqa: F401 (likewise)
    PERIOD_US,
    TwoPwmBridge,
    find_board,
    led,
    motors_off,
    on_rise,
    output,
    reader,
)

_WRAP_MASK = 0x3FFF_FFFF  # written as a sum with 1 << 30 it would be a large integer, and allocate at each use
_MS_MASK = (1 << 29) - 1  # supervisor.ticks_ms() wraps there
_MOST_MS = (1 << 20) - 1  # between two readings; in microseconds still a small integer
_HALF = 1 << 29
_ticks_ms = supervisor.ticks_ms
_delay_us = microcontroller.delay_us

# The watchdog waits so long. While the PC writes on the drive, its flash is erased in the middle of our loop, sector
# by sector, 0.4 s each at worst (W25Q16JV): a reset then would damage the drive.
_HUNG_S = 4


class _Clock:
    """Time that wraps at 2**30, without an integer that would allocate, in the steps that CircuitPython's clock has.

    Those are 1/1024 s, read as whole milliseconds, rounded down: 128 steps are 125 ms, in which three of them do not
    show. So the milliseconds come at uneven times, but known ones: the microseconds are those of the step that was
    seen last. It must be asked at least each 17 minutes: after a longer silence some of the microseconds are lost.
    """

    def __init__(self):
        while True:
            self._seen_ms = _ticks_ms()
            steps = (2 * time.monotonic_ns() + 1) // 1953125
            if _ticks_ms() == self._seen_ms:
                break
        # Of the millisecond among 125. What comes of a large integer stays one, however small its value, and allocates
        # at each use, and so does all that comes of it: but not what is read from digits.
        self._place = int(str(steps * 1000 // 1024 % 125))
        self._ms = 0
        self._us = _WRAP_MASK - 499_999  # half a second before it wraps: every start lives through that

    def us(self):
        """Microseconds."""
        now_ms = _ticks_ms()
        if now_ms != self._seen_ms:
            passed_ms = now_ms - self._seen_ms & _MS_MASK
            self._seen_ms = now_ms
            self._ms = self._ms + (passed_ms - _HALF - _HALF) & _WRAP_MASK
            self._forward(passed_ms & _MOST_MS)
        return self._us

    def _forward(self, passed_ms):
        place = self._place + passed_ms
        passed_us = place // 125 * 125_000 - _steps_us(self._place)
        self._place = place % 125
        passed_us += _steps_us(self._place)
        self._us = self._us + (passed_us - _HALF - _HALF) & _WRAP_MASK

    def ms(self):
        """Milliseconds."""
        self.us()
        return self._ms


def _steps_us(ms):
    """The time in microseconds of the step at which the clock reads ms (0 ... 124)."""
    return (ms * 128 + 124) // 125 * 15625 // 16


_clock = _Clock()
ticks_us = _clock.us
ticks_ms = _clock.ms


def pause_us(us):
    """Wait for us and a PWM period, then for the clock's next step: what begins on a step can end on one."""
    _delay_us(us + PERIOD_US)
    ms = _ticks_ms()
    while _ticks_ms() == ms:
        pass


def unique_id():
    """The chip's own number, as hex (bytes)."""
    return binascii.hexlify(microcontroller.cpu.uid)


def boot_id():
    """A number that differs from boot to boot, 0 ... 2**30-1."""
    return int.from_bytes(os.urandom(4), "little") & 0x3FFFFFFF


def reset_cause():
    """Why the board started, as in codes.py."""
    reason = microcontroller.cpu.reset_reason
    if reason == microcontroller.ResetReason.WATCHDOG:
        return codes.WATCHDOG
    return codes.ASKED if reason == microcontroller.ResetReason.SOFTWARE else codes.POWER


def start_watchdog():
    """From here on the board is reset unless the function that this returns is called every few seconds."""
    dog = microcontroller.watchdog
    if dog is None:
        return stop_watchdog
    from watchdog import WatchDogMode  # a board without one may lack the module

    dog.timeout = _HUNG_S
    dog.mode = WatchDogMode.RESET
    return dog.feed


def stop_watchdog():
    """No feeding is needed from here on: at the prompt."""
    if microcontroller.watchdog is not None:
        microcontroller.watchdog.mode = None


def encoder(number, pins):
    """The reader (counted.py) of an axis whose pins name an encoder; None, after a printed line."""
    from mountfw.ports import circuitpython_encoder  # only where there is one

    return circuitpython_encoder.reader(number, pins)


def collect():
    """Free what starting up has left behind; the loop leaves nothing."""
    gc.collect()


def free_memory():
    """Bytes of the heap that are free. Allocates nothing, but walks the heap: ask it seldom."""
    return gc.mem_free()  # pyright: ignore[reportAttributeAccessIssue]


def uninterrupted(action, argument):
    """action(argument), from the start again however often Ctrl-C comes meanwhile: it cannot be switched off here."""
    while True:
        try:
            action(argument)
            return
        except KeyboardInterrupt:
            pass


def leave(board):
    """Motors off and watchdog off on the way to the prompt, however often Ctrl-C comes meanwhile."""
    uninterrupted(_leave, board)


def _leave(board):
    motors_off(board)
    stop_watchdog()
