"""The hardware's verbs on CircuitPython. Only ports/circuitpython*.py name its modules.

CircuitPython has no interrupts for Python code, so end-stops are polled. The finest clock that does not allocate has
steps of 1/1024 s. docs/circuitpython.md lists the consequences.
"""

import binascii
import gc
import os
import time

import microcontroller
import supervisor

from mountfw import codes
from mountfw.ports import circuitpython_encoder
from mountfw.ports.circuitpython_console import any, drain, pack, writable, write  # noqa: F401 (verbs of this port, too)
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
from mountfw.ports.circuitpython_storage import firmware_hash, load, remove, rename, store  # noqa: F401 (likewise)

_WRAP_MASK = 0x3FFF_FFFF  # a literal: computed from 1 << 30 it would be a large integer, and allocate at each use
_MS_MASK = (1 << 29) - 1  # supervisor.ticks_ms() wraps there
_MOST_MS = (1 << 20) - 1  # between two readings; in microseconds still a small integer
_HALF = 1 << 29
_ticks_ms = supervisor.ticks_ms
_delay_us = microcontroller.delay_us

# The watchdog's timeout. When the PC writes to the drive, CircuitPython erases flash during a pass of the loop, up to
# 0.4 s a sector (W25Q16JV). A reset in an erase would damage the drive's file system.
_HUNG_S = 4


class _Clock:
    """Time that wraps at 2**30, in the steps of CircuitPython's clock, without an allocation.

    A step is 1/1024 s, and the clock is read as whole milliseconds, rounded down. So 128 steps are 125 ms, and three of
    them do not change the reading. The time of each change is known all the same: us() returns that of the last one.
    Call us() at least every 17 minutes: after a longer pause it loses time.
    """

    def __init__(self):
        while True:
            self._seen_ms = _ticks_ms()
            steps = (2 * time.monotonic_ns() + 1) // 1953125
            if _ticks_ms() == self._seen_ms:
                break
        # The millisecond's place among 125. It goes through text: a number that is computed from a large integer stays
        # one, and allocates at each use.
        self._place = int(str(steps * 1000 // 1024 % 125))
        self._ms = 0
        self._us = _WRAP_MASK - 499_999  # half a second before it wraps: each start tests that

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
    """Microseconds of the step at which the clock first reads ms (0 ... 124)."""
    return (ms * 128 + 124) // 125 * 15625 // 16


_clock = _Clock()
ticks_us = _clock.us
ticks_ms = _clock.ms


def pause_us(us):
    """Wait for us and a PWM period, then for the clock's next step: a drive that begins on a step can end on one."""
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
    """Start the watchdog. Returns the function that feeds it; call that every few seconds, or the board is reset."""
    dog = microcontroller.watchdog
    if dog is None:
        return stop_watchdog
    from watchdog import WatchDogMode  # a board without one may lack the module

    dog.timeout = _HUNG_S
    dog.mode = WatchDogMode.RESET
    return dog.feed


def stop_watchdog():
    """Stop the watchdog: at the prompt nothing feeds it."""
    if microcontroller.watchdog is not None:
        microcontroller.watchdog.mode = None


def encoder(number, pins):
    """The reader (encoders.py) of an axis whose pins name an encoder; None, after a printed line."""
    return circuitpython_encoder.reader(number, pins)


def collect():
    """Collect the garbage of the start; the loop makes none."""
    gc.collect()


def free_memory():
    """Free bytes of the heap. Allocates nothing, but walks the heap, which takes milliseconds."""
    return gc.mem_free()  # pyright: ignore[reportAttributeAccessIssue]


def uninterrupted(action, argument):
    """Call action(argument), again after each Ctrl-C, until it has returned: Ctrl-C cannot be switched off here."""
    while True:
        try:
            action(argument)
            return
        except KeyboardInterrupt:
            pass


def leave(board):
    """Turn motors and watchdog off before the prompt, whatever Ctrl-C interrupts."""
    uninterrupted(_leave, board)


def _leave(board):
    motors_off(board)
    stop_watchdog()
