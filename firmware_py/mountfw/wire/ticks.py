"""Wrap-safe microseconds. Pure; imports nothing of ours.

Clocks here count modulo 2**30, as MicroPython's ticks_us does. diff() is right while two times are less than 2**29 us
(537 s) apart, so every interval in the firmware stays under 500 s. On a board the built-in functions serve; these two
are for CPython and a 64-bit MicroPython, written so that no step between leaves +-2**30.
"""

import time

_MASK = 0x3FFF_FFFF  # no `(1 << 30) - 1`: 2**30 is a large integer, and so is all that is made of one
_HALF = 1 << 29


if hasattr(time, "ticks_diff") and time.ticks_add(0, -1) == _MASK:  # pyright: ignore[reportAttributeAccessIssue]
    diff, add = time.ticks_diff, time.ticks_add  # pyright: ignore[reportAttributeAccessIssue]
else:

    def diff(later_us, earlier_us):
        """Signed time between, microseconds."""
        d = (later_us - earlier_us) & _MASK
        return d if d < _HALF else d - _HALF - _HALF

    def add(us, delta_us):
        """The time delta_us (0 ... 2**30-1) after us."""
        return (us + (delta_us - _HALF - _HALF)) & _MASK
