"""time on the virtual CircuitPython board: no ticks in it."""

import _seam

_POWER_UP_US = (1 << 30) - 500_000  # simulation.START_US


def sleep(seconds):
    s = _seam.seam
    until = s.t + round(seconds * 1e6)
    while s.t < until:
        s.wait(until)


def monotonic_ns():
    """As the real one: 1/32768 s, and an integer too large to be had without memory."""
    s = _seam.seam
    s.tick(3)
    parts = (s.t - _POWER_UP_US) * 32768 // 1_000_000
    ticks = parts // 32
    return 976_562 * ticks + ticks // 2 + 30_518 * (parts % 32)
