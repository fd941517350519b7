"""supervisor on the virtual CircuitPython board. Its clock is the real one's: ticks of 1/1024 s, given in whole ms."""

import _seam

_WRAP_MS = 1 << 29
_POWER_UP_US = (1 << 30) - 500_000  # simulation.START_US
_BEFORE_WRAP_MS = 65_536  # at power-up


class _Runtime:
    autoreload = True


class _StatusBar:
    console = True


runtime = _Runtime()
status_bar = _StatusBar()


def ticks_ms():
    s = _seam.seam
    s.tick(3)
    ticks = (s.t - _POWER_UP_US) * 1024 // 1_000_000
    return (ticks * 1000 // 1024 - _BEFORE_WRAP_MS) % _WRAP_MS
