"""Whether the screw has moved: what one look says of a pulse that may have met the end of the gap. Pure.

Three cases are weighed by Bayes' rule: the shaft is still free, it has met the screw within this pulse, or the screw
follows since before. One look tells a motion of 10 um from the noise at 2 sigma; so a chance of a few percent, in a
creep of a dozen pulses, would be taken for a contact now and then. The odds of several looks are not.
"""

import math
from dataclasses import dataclass

_LEAST, _MOST = 0.01, 0.995  # chance of a contact within a pulse: gaps differ from one time to the next
_GAIN = 0.15  # relative error of a step's way that is expected
_ODD = 1.2  # factor of standard errors: a laser's drift is no Gaussian of known width
_UNLIKELY = 0.002  # of a look that fits none of the cases, against one in the middle of a case


@dataclass(frozen=True)
class Moved:
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

    def foreseen(self) -> Moved:
        """Before the look."""
        return self._mixed((1 - self.follows) * (1 - self._meets()), (1 - self.follows) * self._meets(), self.follows)

    def seen(self, way: float, error: float) -> Moved:
        """With a look by which the screw has moved by `way` ± error."""
        meets, spread = self._met_by()
        odds = self._meets()
        error *= _ODD
        free = (1 - self.follows) * (1 - odds) * _density(way, error)
        met = (1 - self.follows) * odds * _density(way - meets, math.hypot(error, spread))
        on = self.follows * _density(way - self.drove, math.hypot(error, self.scatter, _GAIN * self.drove))
        return self._mixed(free, met, on, way, error)

    def _mixed(self, free: float, met: float, on: float, way: float = 0.0, error: float = math.inf) -> Moved:
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
        return Moved(mean, max(square - mean**2, 0.0), follows, since)

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
    """Of a normal distribution, with tails that no single look can take to nothing."""
    sigma = max(sigma, 1e-9)
    return (math.exp(-0.5 * min((off / sigma) ** 2, 1000.0)) + _UNLIKELY) / sigma


def _below(x: float, sigma: float) -> float:
    """The chance that a normal variable (0, sigma) is below x."""
    return 0.5 * math.erfc(-x / (max(sigma, 1e-9) * math.sqrt(2)))
