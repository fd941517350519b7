"""Where the spots are, from noisy observations: a Kalman filter for a random walk whose drift is learned.

R. E. Kalman, J. Basic Eng. 82 (1960) 35. The covariance of the drift is estimated from the innovations at rest, as by
R. K. Mehra, IEEE Trans. Autom. Control 15 (1970) 175: a laser that wanders moves all spots together, and once that is
known an observation at all spots tells more of each.
"""

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_FIRST_DRIFT_UM2_S = 30.0  # The drift of each error, until observations have shown it.
_LEAST_DRIFT_UM2_S = 0.5
_LEARN = 0.01  # The weight of a new innovation in the long run.
_PRIOR = 10  # The first drift counts as much as so many innovations.
# Only a rest of at least this length teaches the drift: between two images of a camera there is more noise than
# drift.
_SPAN_S = 0.3
_OUTLIER = 5.0  # An innovation of more standard deviations teaches nothing.


class Tracker:
    """Errors of all spots (um) and their covariance. noise: covariance of one image's errors.

    seen: there was an observation; before the first one the mean says nothing.
    """

    def __init__(self, noise: Matrix) -> None:
        n = len(noise)
        self.noise = noise
        self.seen = False
        self.mean = np.zeros(n)
        self.covariance = np.eye(n) * 1e8
        self.drift = np.eye(n) * _FIRST_DRIFT_UM2_S  # um² a second
        self.time_s: float | None = None
        self._learned = 0
        self._from: tuple[Vector, Matrix] | None = None  # mean and covariance at the begin of a span of rest ...
        self._span_s = 0.0  # ... and for how long that lasts

    def pass_to(self, time_s: float) -> float:
        """Time has passed, up to time_s. Returns by how much, in seconds."""
        dt = 0.0 if self.time_s is None else max(0.0, time_s - self.time_s)
        self.time_s = time_s
        self.covariance = self.covariance + self.drift * dt
        return dt

    def moved(self, effect: Vector, covariance: Matrix) -> None:
        """The loop has moved the spots by effect, which is not sure."""
        self.mean = self.mean + effect
        self.covariance = self.covariance + covariance

    def innovation(self, errors: Vector, frames: int) -> tuple[Vector, Matrix]:
        """By how much an observation differs from what was expected, and the covariance of that."""
        return errors - self.mean, self.covariance + self.noise / frames

    def see(self, errors: Vector, frames: int, rested_s: float = 0.0) -> None:
        """An observation. rested_s: the time since the one before, if nothing was moved in between: then it teaches."""
        self.seen = True
        nu, s = self.innovation(errors, frames)
        learns = self._learn(errors, frames, rested_s)
        gain = self.covariance @ np.linalg.inv(s)
        self.mean = self.mean + gain @ nu
        self.covariance = (np.eye(len(nu)) - gain) @ self.covariance
        self.covariance = (self.covariance + self.covariance.T) / 2
        if learns:
            self._from, self._span_s = (self.mean, self.covariance), 0.0

    def lose(self) -> None:
        """Nothing is known of the spots any more, but the drift is."""
        self.covariance = np.eye(len(self.mean)) * 1e8
        self.time_s = self._from = None

    @property
    def sigma_um(self) -> Vector:
        """Standard errors of the means."""
        return np.sqrt(np.diag(self.covariance))

    def _learn(self, errors: Vector, frames: int, rested_s: float) -> bool:
        """A span of rest teaches by its last observation. True: another one begins with that."""
        if rested_s <= 0 or self._from is None:
            return True
        self._span_s += rested_s
        if self._span_s < _SPAN_S:
            return False
        mean, covariance = self._from
        nu, s = errors - mean, covariance + self.drift * self._span_s + self.noise / frames
        if float(nu @ np.linalg.solve(s, nu)) <= _OUTLIER**2 * len(nu):
            self._learned += 1
            weight = max(_LEARN, 1 / (self._learned + _PRIOR))
            drift = self.drift + weight * (np.outer(nu, nu) - s) / self._span_s
            values, vectors = np.linalg.eigh((drift + drift.T) / 2)
            self.drift = (vectors * np.maximum(values, _LEAST_DRIFT_UM2_S)) @ vectors.T
        return True
