"""time on the virtual board. Each reading of a clock costs its microseconds; both wrap at 2**30."""

import _seam

_MASK = _seam.WRAP_MASK
_HALF = (_MASK + 1) // 2


def ticks_us():
    s = _seam.seam
    s.tick(3)
    return s.t & _MASK


def ticks_ms():
    s = _seam.seam
    s.tick(3)
    return s.t // 1000 & _MASK


def ticks_diff(later, earlier):
    return (later - earlier + _HALF & _MASK) - _HALF


def ticks_add(ticks, delta):
    return ticks + delta & _MASK


def sleep_us(us):
    s = _seam.seam
    until = s.t + us
    while s.t < until:
        s.tick(until - s.t)


def sleep_ms(ms):
    sleep_us(ms * 1000)
