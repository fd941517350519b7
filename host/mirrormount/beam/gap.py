"""Where the motor's shaft is in its gap: how far it still turns before the screw follows, and how sure that is.

Units: steps, which are travel of the shaft; those of the two ways may differ. What is left of a gap is a normal
distribution, cut at 0.
"""

import math
from dataclasses import dataclass

_LEARN = 0.12  # weight of a new sample of the gap's width
_TAIL_SIGMAS = 3.2  # of a normal distribution, beyond which is 0.07 % of it
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
        self._slack: dict[int, tuple[float, float]] = {}
        self.forget()

    def forget(self) -> None:
        """Somebody else has moved it: the shaft is anywhere in the gap."""
        self.way, self._travelled = 0, 0.0
        self._slack = {way: (width.mean / 2, width.mean / 2) for way, width in self.widths.items()}

    def slack(self, way: int) -> tuple[float, float]:
        """Steps until the screw follows in this way, and the standard deviation; (0, 0): it follows at once."""
        return self._slack[way]

    def in_contact(self, way: int) -> bool:
        """True if the screw follows at once."""
        return self._slack[way][0] <= 0

    def free(self, way: int, mean: float, most: float) -> float:
        """Steps that can be driven while the screw moves by less than `mean` on average, and hardly ever by `most`."""
        slack, sigma = self._slack[way]
        if slack <= 0:
            return 0.0
        low, high = 0.0, max(0.0, slack - _TAIL_SIGMAS * sigma + most)
        if _expected(high - slack, sigma) <= mean:
            return high
        for _ in range(20):
            middle = (low + high) / 2
            low, high = (middle, high) if _expected(middle - slack, sigma) <= mean else (low, middle)
        return low

    def drove(self, way: int, steps: float, scatter: float) -> None:
        """The shaft turned by so many steps (± scatter), and the screw was not seen to move."""
        mean, sigma = self._slack[way]
        if mean <= 0:
            return
        self._travelled += way * steps / self.widths[way].mean
        steps_back = steps * self.widths[-way].mean / self.widths[way].mean
        self._slack[way] = _cut(mean - steps, math.hypot(sigma, scatter))
        back, unsure = self._slack[-way]
        self._slack[-way] = min(back + steps_back, self.widths[-way].mean), math.hypot(unsure, scatter)

    def met(self, way: int, steps: float, moved: float) -> None:
        """The shaft turned by so many steps, and the screw was seen to follow for `moved` of them."""
        if self._slack[way][0] > 0 and self.way == -way:
            self.widths[way].learn(max(0.0, abs(self._travelled) * self.widths[way].mean + steps - moved))
        self._set_contact(way)

    def followed(self, way: int) -> None:
        """The screw is in contact in this way."""
        self._set_contact(way)

    def doubt(self, way: int) -> None:
        """The screw was taken to follow, and did not: a contact that was seen too early."""
        width = self.widths[way]
        self._slack[way] = width.spread, width.spread
        self._slack[-way] = max(0.0, self.widths[-way].mean - width.spread), self.widths[-way].spread
        self.way = 0  # no sample of the width

    def _set_contact(self, way: int) -> None:
        self.way, self._travelled = way, 0.0
        self._slack[way] = 0.0, 0.0
        width = self.widths[-way]
        self._slack[-way] = width.mean, width.spread


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
