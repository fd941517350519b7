"""Wrap-safe microseconds. Pure; imports nothing of ours.

Clocks here count modulo 2**30, as MicroPython's ticks_us does. diff() is right while two
times are less than 2**29 us (537 s) apart, so every time in the firmware stays under 500 s
and a disarmed timer holds no time at all. On a board the built-in functions serve; the
others are for CPython, written so that no step between leaves +-2**30 (a MicroPython small
integer on a 32-bit board: beyond it, arithmetic allocates).
"""

_MASK = (1 << 30) - 1
_HALF = 1 << 29

try:
    from time import ticks_add as add
    from time import ticks_diff as diff
except ImportError:

    def diff(later_us, earlier_us):
        """Signed time from earlier_us to later_us, microseconds."""
        d = (later_us - earlier_us) & _MASK
        return d if d < _HALF else d - _HALF - _HALF

    def add(us, delta_us):
        """The time delta_us (0 ... 2**30-1) after us."""
        return (us + (delta_us - _HALF - _HALF)) & _MASK
