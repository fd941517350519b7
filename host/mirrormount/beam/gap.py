"""Where the motor's shaft is in its gap: how far it still turns before the screw follows, and how sure that is.

Units: steps, which are travel of the shaft; those of the two ways may differ. What is left of a gap is a normal
distribution, cut at 0.
"""

import math
from dataclasses import dataclass

from mirrormount.beam.contact import Moved, Pulse

_LEARN = 0.12  # weight of a new sample of the gap's width
_TAIL_SIGMAS = 2.8  # of a normal distribution, beyond which is 0.26 % of it
_MET, _LOST = 0.99, 0.4  # chances that the screw follows: beyond, a contact is taken for one; below, it is none
_SURE = 0.999  # chance that is not exceeded by a contact that is new: a later motion can still show that it was none
_CERTAIN = 1 - 1e-6  # nor by one that has moved the screw ...
_FAR_SPREADS = 3.0  # ... by so many times the gap's scatter
_LEFT = 0.5  # of the gap's scatter, that always may be left where no contact was seen
_MAY_FOLLOW = 0.3  # beyond, nothing is surely free
_LEAST_SPREAD = 0.01  # of the gap's width, in parts of it: a travel is not known better


@dataclass
class Width:
    """The gap's width in one direction, in steps, and its scatter from reversal to reversal."""

    mean: float
    spread: float
    samples: int = 1

    def learn(self, sample: float) -> None:
        """A reversal has met the screw after so many steps."""
        weight = max(_LEARN, 1 / (self.samples + 1))
        off = sample - self.mean
        if abs(off) > 4 * max(self.spread, 0.03 * self.mean):
            off = math.copysign(4 * max(self.spread, 0.03 * self.mean), off)  # one odd sample says little
        self.mean += weight * off
        variance = (1 - weight) * (self.spread**2 + weight * off**2)
        self.spread = max(math.sqrt(variance), _LEAST_SPREAD * abs(self.mean))
        self.samples += 1


class Gap:
    """Of one actuator. widths: for the ways 1 and -1."""

    def __init__(self, widths: dict[int, Width]) -> None:
        self.widths = widths
        self.way = 0  # of the last contact; 0: not known
        self._travelled = 0.0  # from that contact on, signed, in parts of the gap
        self._slack: dict[int, tuple[float, float]] = {}  # if the screw does not follow
        self._follows: dict[int, float] = {}  # the chance that it does
        self._since: dict[int, float] = {}  # how far it has then been moved
        self._contact: dict[int, bool] = {}  # what is decided of that
        self.forget()

    def forget(self) -> None:
        """Somebody else has moved it: the shaft is anywhere in the gap."""
        self.way, self._travelled = 0, 0.0
        self._slack = {way: (width.mean / 2, width.mean / 2) for way, width in self.widths.items()}
        self._follows = dict.fromkeys(self.widths, 0.0)
        self._since = dict.fromkeys(self.widths, 0.0)
        self._contact = dict.fromkeys(self.widths, False)

    def slack(self, way: int) -> tuple[float, float]:
        """Steps until the screw follows in this way, and the standard deviation; (0, 0): it follows at once."""
        return (0.0, 0.0) if self._contact[way] else self._slack[way]

    def in_contact(self, way: int) -> bool:
        """True if the screw follows at once."""
        return self._contact[way]

    def free(self, way: int, mean: float, most: float, scatter: float) -> float:
        """Steps that can be driven while the screw moves by less than `mean` on average, and hardly ever by `most`.

        scatter: of the way of a step, in steps.
        """
        slack, sigma = self.slack(way)
        if slack <= 0 or self._follows[way] > _MAY_FOLLOW:
            return 0.0
        sigma = math.hypot(sigma, scatter * math.sqrt(slack))
        low, high = 0.0, max(0.0, slack - _TAIL_SIGMAS * sigma + most)
        if _expected(high - slack, sigma) <= mean:
            return high
        for _ in range(20):
            middle = (low + high) / 2
            low, high = (middle, high) if _expected(middle - slack, sigma) <= mean else (low, middle)
        return low

    def pulse(self, way: int, steps: float, scatter: float) -> Pulse:
        """A travel of the shaft, before its look: what it does to the screw, as far as that is known."""
        slack, sigma = self._slack[way]
        return Pulse(steps, scatter, self._follows[way], self._since[way], slack, sigma)

    def moved(self, way: int, steps: float, scatter: float, moved: Moved) -> bool:
        """The shaft was turned by so many steps (± scatter), and the screw so far. True: a contact is new."""
        slack, sigma = self._slack[way]
        width, back = self.widths[way].mean, self.widths[-way]
        if self._contact[way] and moved.follows <= _LOST and self._since[way] > _FAR_SPREADS * self.widths[way].spread:
            self.forget()  # what was certain is wrong: it is not known by how much
            return False
        self._travelled += way * steps / width
        slack, sigma = _cut(slack - steps, math.hypot(sigma, scatter))
        least = _LEFT * self.widths[way].spread  # a gap that is longer than it ever was is not the least likely case
        self._slack[way] = max(slack, least), max(sigma, least)
        most = _CERTAIN if moved.since > _FAR_SPREADS * self.widths[way].spread else _SURE
        self._follows[way], self._since[way] = min(moved.follows, most), moved.since
        was, self._contact[way] = self._contact[way], moved.follows > (_LOST if self._contact[way] else _MET)
        steps_back = steps * back.mean / width
        if self._contact[way]:
            if not was and self.way == -way:
                self.widths[way].learn(max(0.0, abs(self._travelled) * width - moved.since))
            self.way, self._travelled = way, 0.0
            self._slack[-way] = back.mean, back.spread
            if moved.follows >= _SURE:  # if it does not after all, the contact was seen a little too early
                self._slack[way] = self.widths[way].spread, self.widths[way].spread
        else:
            if was:
                self.way = 0  # no sample of the width
            mean, unsure = (0.0, 0.0) if self._contact[-way] else self._slack[-way]
            mean = min(mean + steps_back, back.mean)
            contact = back.spread * mean / back.mean  # the other end of the gap is not twice at one place
            self._slack[-way] = mean, max(math.hypot(unsure, scatter), contact)
        self._contact[-way], self._follows[-way], self._since[-way] = False, 0.0, 0.0
        return self._contact[way] and not was

    def followed(self, way: int) -> None:
        """The screw is in contact in this way, as was seen otherwise."""
        self.way, self._travelled = way, 0.0
        here, back = self.widths[way], self.widths[-way]
        self._contact, self._since = {way: True, -way: False}, {way: here.mean, -way: 0.0}
        self._follows = {way: _CERTAIN, -way: 0.0}
        self._slack = {way: (here.spread, here.spread), -way: (back.mean, back.spread)}


def _expected(beyond: float, sigma: float) -> float:
    """The mean of what a normal variable (0, sigma) is below `beyond` by, where it is."""
    if sigma <= 0:
        return max(beyond, 0.0)
    z = beyond / sigma
    return beyond * 0.5 * math.erfc(-z / math.sqrt(2)) + sigma * math.exp(-z * z / 2) / math.sqrt(2 * math.pi)


def _cut(mean: float, sigma: float) -> tuple[float, float]:
    """Mean and standard deviation of a normal distribution of which only what is above 0 is left."""
    if sigma <= 0:
        return max(mean, 1e-6), 0.0
    a = -mean / sigma
    if a < -6:
        return mean, sigma
    tail = 0.5 * math.erfc(a / math.sqrt(2))
    ratio = a + 1 / max(a, 1.0) if tail < 1e-12 else math.exp(-a * a / 2) / math.sqrt(2 * math.pi) / tail
    return max(mean + sigma * ratio, 1e-6), sigma * math.sqrt(max(1 + a * ratio - ratio**2, 1e-4))
