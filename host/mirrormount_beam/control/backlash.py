"""Where the motor's shaft is in its gap: how far it still turns before the screw follows, and how sure that is.

Units: steps, which are travel of the shaft; those of the two ways may differ. What is left of a gap is a normal
distribution, cut at 0.

Whether the screw has moved, one observation says of a pulse that may have met the end of the gap. Three cases are
weighed by Bayes' rule: the shaft is still free, it has met the screw within this pulse, or the screw follows since
before. One observation tells a motion of 10 um from the noise at 2 sigma; so a chance of a few percent, in a creep of a
dozen pulses, would be taken for a contact now and then. The odds of several observations are not.
"""

import math
from dataclasses import dataclass

# The bounds of the chance of a contact within a pulse: a gap differs from one time to the next.
_LEAST, _MOST = 0.01, 0.995
_GAIN = 0.15  # The relative error of a step's way that is expected.
_ODD = 1.2  # Standard errors are taken as larger by this factor: a laser's drift is no Gaussian of known width.
# The likelihood of an observation that fits none of the cases, relative to one in the middle of a case.
_UNLIKELY = 0.002


@dataclass(frozen=True)
class ScrewMotion:
    """How far the screw was moved: mean and variance, in steps. follows: the chance that it follows now.

    since: how far it has been moved since the contact, if there is one.
    """

    mean: float
    variance: float
    follows: float
    since: float


@dataclass(frozen=True)
class Pulse:
    """A travel of the shaft by `drove` ± scatter steps. follows: the chance that the screw has followed before.

    since: how far, then. slack, sigma: what is left of the gap, if it has not.
    """

    drove: float
    scatter: float
    follows: float
    since: float
    slack: float
    sigma: float

    def foreseen(self) -> ScrewMotion:
        """Before the observation."""
        return self._mixed((1 - self.follows) * (1 - self._meets()), (1 - self.follows) * self._meets(), self.follows)

    def seen(self, way: float, error: float) -> ScrewMotion:
        """With an observation by which the screw has moved by `way` ± error."""
        meets, spread = self._met_by()
        odds = self._meets()
        error *= _ODD
        free = (1 - self.follows) * (1 - odds) * _density(way, error)
        met = (1 - self.follows) * odds * _density(way - meets, math.hypot(error, spread))
        on = self.follows * _density(way - self.drove, math.hypot(error, self.scatter, _GAIN * self.drove))
        return self._mixed(free, met, on, way, error)

    def _mixed(self, free: float, met: float, on: float, way: float = 0.0, error: float = math.inf) -> ScrewMotion:
        whole = free + met + on
        free, met, on = free / whole, met / whole, on / whole
        meets, spread = self._met_by()
        follows = met + on
        mean = met * meets + on * self.drove
        square = met * (meets**2 + spread**2) + on * (self.drove**2 + self.scatter**2)
        since = 0.0
        if follows:
            now = (_joined(meets, spread, way, error), _joined(self.drove, self.scatter, way, error))
            since = (met * now[0] + on * (self.since + now[1])) / follows
        return ScrewMotion(mean, max(square - mean**2, 0.0), follows, since)

    def _meets(self) -> float:
        """The chance that a shaft that is free meets the screw within this pulse."""
        before = _below(-self.slack, self.sigma)
        if before > 1 - 1e-9:
            return _MOST
        chance = (_below(self.drove - self.slack, math.hypot(self.sigma, self.scatter)) - before) / (1 - before)
        return min(max(chance, _LEAST), _MOST)

    def _met_by(self) -> tuple[float, float]:
        """How far the screw is moved then: mean and standard deviation."""
        sigma = math.hypot(self.sigma, self.scatter)
        if sigma <= 0:
            return max(self.drove - self.slack, 0.0), 0.0
        z = (self.drove - self.slack) / sigma
        tail = _below(z, 1.0)
        ratio = -z if tail < 1e-9 else math.exp(-z * z / 2) / math.sqrt(2 * math.pi) / tail
        mean = sigma * max(z + ratio, 0.0)
        variance = sigma**2 * max(1 - z * ratio - ratio**2, 1e-4)
        if mean > self.drove / 2 and z < 1.0:
            mean = self.drove / 2
        return mean, math.sqrt(min(variance, self.drove**2 / 12 + self.scatter**2))


def _joined(mean: float, sigma: float, way: float, error: float) -> float:
    """Two values of one quantity, weighed by their variances."""
    if not math.isfinite(error):
        return mean
    weight = sigma**2 / (sigma**2 + error**2 + 1e-18)
    return mean + weight * (way - mean)


def _density(off: float, sigma: float) -> float:
    """Of a normal distribution, with tails that no single observation can take to nothing."""
    sigma = max(sigma, 1e-9)
    return (math.exp(-0.5 * min((off / sigma) ** 2, 1000.0)) + _UNLIKELY) / sigma


def _below(x: float, sigma: float) -> float:
    """The chance that a normal variable (0, sigma) is below x."""
    return 0.5 * math.erfc(-x / (max(sigma, 1e-9) * math.sqrt(2)))


_LEARN = 0.12  # The weight of a new sample of the gap's width.
_TAIL_SIGMAS = 2.8  # Only 0.26 % of a normal distribution is beyond so many standard deviations.
_MET, _LOST = 0.99, 0.4  # The screw counts as engaged above _MET, and as free again below _LOST (hysteresis).
_SURE = 0.999  # A new contact never counts as more certain: a later motion can still show that it was none.
# A contact that has moved the screw by _FAR_SPREADS of the gap's scatter never counts as more certain.
_CERTAIN = 1 - 1e-6
_FAR_SPREADS = 3.0  # In standard deviations of the gap's width.
_LEFT = 0.5  # Where no contact was seen, this part of the gap's scatter may always be left.
_MAY_FOLLOW = 0.3  # If the screw follows with a larger chance, no part of the gap is surely free.
_LEAST_SPREAD = 0.01  # The scatter of a gap is at least this part of its width: a travel is not known better.


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
        """A travel of the shaft, before its observation: what it does to the screw, as far as that is known."""
        slack, sigma = self._slack[way]
        return Pulse(steps, scatter, self._follows[way], self._since[way], slack, sigma)

    def moved(self, way: int, steps: float, scatter: float, moved: ScrewMotion) -> bool:
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
