"""Counts of an encoder wrap at 2**30, as times do. Pure; imports nothing of ours.

A reader, which the port makes (ports/counted.py), has counts(), slips, gone and play_us.
"""

from mountfw import const

_MASK = const(0x3FFF_FFFF)
_HALF = const(1 << 29)


def apart(later, earlier):
    """Signed counts from earlier to later, less than 2**29 apart."""
    d = (later - earlier) & _MASK
    return d if d < _HALF else d - _HALF - _HALF
