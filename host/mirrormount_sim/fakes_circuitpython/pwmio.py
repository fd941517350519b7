"""pwmio on the virtual CircuitPython board: an RP2040's slices. A new duty shows when the running period is over."""

import _chip
import _seam

_slices = {}  # number: [frequency, channels in use]


class PWMOut:
    """One pin with a duty."""

    def __init__(self, pin, *, duty_cycle=0, frequency=500, variable_frequency=False):
        if variable_frequency or not isinstance(frequency, int) or not 0 < frequency <= 62_500_000:
            raise ValueError("Invalid frequency")
        _check(duty_cycle)
        slice_number, channel = pin.number >> 1 & 7, pin.number & 1
        used = _slices.get(slice_number)
        if used and (used[0] != frequency or channel in used[1]):
            raise RuntimeError("Conflicting settings for shared resource")
        _chip.claim(pin, self)
        _slices.setdefault(slice_number, [frequency, set()])[1].add(channel)
        self._pin = pin
        self._slice = slice_number
        self.frequency = frequency
        self._period_us = max(1, 1_000_000 // frequency)
        self._since = _seam.seam.t  # a period begins
        self._duty = duty_cycle
        _seam.seam.edge(pin.number, duty_cycle, frequency)

    def deinit(self):
        if self._pin is None:
            return
        channels = _slices[self._slice][1]
        channels.discard(self._pin.number & 1)
        if not channels:
            del _slices[self._slice]
        _chip.release(self._pin)
        self._pin = None

    @property
    def duty_cycle(self):
        self._check()
        return self._duty

    @duty_cycle.setter
    def duty_cycle(self, duty):
        self._check()
        _check(duty)
        s = _seam.seam
        s.tick(5)
        self._duty = duty
        periods = (s.t - self._since) // self._period_us + 1
        s.latch(self._since + periods * self._period_us, self._pin.number, duty, self.frequency)

    def _check(self):
        if self._pin is None:
            raise _chip.deinited()


def _check(duty):
    if not isinstance(duty, int):
        raise TypeError("can't convert %s to int" % type(duty).__name__)
    if not 0 <= duty <= 65535:
        raise ValueError("duty_cycle must be 0-65535")
