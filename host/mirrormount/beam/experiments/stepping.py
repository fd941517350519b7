"""Steps along a line: how far each of them moves the spot. Imports estimate, result, rig, numpy.

Successive readings r_0 … r_n give n displacements d_k = r_k - r_(k-1). Their mean is (r_n - r_0)/n, so a reading's own
error counts in it twice and not 2n times, and the scatter of the d_k is that of the steps plus twice a reading's.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mirrormount.beam.estimate import Estimate, student
from mirrormount.beam.observer import Sighting
from mirrormount.beam.result import Result
from mirrormount.beam.rig import Rig, Vector, place

_LEAST_PERIOD = 12.0  # steps of a screw's turn that are looked for; the paper's screw has 40
_TRIED = 60  # periods
_SIGNIFICANT = 6.0  # the F of three more parameters, of which the period is chosen among many
_LEAST_FITTED = 16  # steps, for a fit of four parameters
_AT_REST = 16  # looks without a move
_CREEP_S = 6.0  # between two looks at a mount that may creep: a part of the time constants that are usual
_MOST_WAITS = 12


@dataclass(frozen=True)
class Wave:
    """A periodic error: amplitude in parts of a step, period in steps."""

    amplitude: float
    period: float


@dataclass(frozen=True)
class Line:
    """Steps along a line: their mean, the scatter of one step without the reading's error, and a periodic part."""

    mean: Estimate
    scatter: Estimate
    wave: Wave | None


class Log:
    """Looks with a rig, and keeps each reading in a Result."""

    def __init__(self, rig: Rig, result: Result) -> None:
        self._rig = rig
        self._result = result
        self._first_s: float | None = None
        self._variances: list[float] = []
        self.drift2 = 0.0  # variance of the spot's drift between two looks, in px² ...
        self.walk2 = 0.0  # ... and in one second

    def look(self) -> Vector:
        """Where the spot is, in px. Raises SpotLost, CameraError."""
        sighting: Sighting = self._rig.look()
        if self._first_s is None:
            self._first_s = sighting.time_s
        self._result.readings.append(
            (sighting.time_s - self._first_s, sighting.x, sighting.y, sighting.error_x, sighting.error_y)
        )
        self._variances.append((sighting.error_x**2 + sighting.error_y**2) / 2)
        return place(sighting)

    def rest(self) -> None:
        """Look several times without a move, to know by how much the beam drifts from look to look."""
        places = np.array([self.look() for _ in range(_AT_REST)])
        variance = float(np.mean(np.diff(places, axis=0) ** 2))
        self.drift2 = max(0.0, variance - 2 * self.error_px**2)
        self.walk2 = self.drift2 * (_AT_REST - 1) / self.now_s

    def settle(self) -> Vector:
        """Wait until the mount does not creep any more, as far as the beam's own drift lets see. Returns the place."""
        places = [self.look()]
        allowed = 2 * math.sqrt(4 * self.error_px**2 + 2 * _CREEP_S * self.walk2)  # in either direction, in two waits
        for _ in range(_MOST_WAITS):
            self._rig.sleep(_CREEP_S)
            places.append(self.look())
            if len(places) > 2 and float(np.linalg.norm(places[-1] - places[-3])) < allowed:
                break
        return places[-1]

    def error_of_mean(self, d: NDArray[np.float64]) -> float:
        """The standard error of the mean of displacements between successive readings along a line."""
        n = len(d)
        return math.sqrt((self.own_variance(float(d.var(ddof=1))) + 2 * self.error_px**2 / n) / n) * student(n - 1)

    def own_variance(self, variance: float) -> float:
        """Of displacements, without the readings' errors: not less than the beam's drift."""
        return max(self.drift2, variance - 2 * self.error_px**2)

    @property
    def last(self) -> Vector:
        """The last reading, in px."""
        return np.array(self._result.readings[-1][1:3], dtype=float)

    @property
    def error_px(self) -> float:
        """The standard error of one reading in one direction: root mean square of all so far."""
        return math.sqrt(sum(self._variances) / len(self._variances)) if self._variances else 0.0

    @property
    def now_s(self) -> float:
        """Time of the last reading since the first."""
        return float(self._result.readings[-1][0]) if self._result.readings else 0.0


def series(rig: Rig, log: Log, axis: str, count: int, n: int = 1) -> list[Vector]:
    """The readings r_0 … r_count, with n steps between two of them."""
    places = [log.look()]
    for _ in range(count):
        rig.step(axis, n)
        places.append(log.look())
    return places


def along(places: list[Vector]) -> tuple[NDArray[np.float64], Vector]:
    """The places along the line that fits them best (its way from the first to the last), and its unit vector."""
    points = np.array(places)
    centred = points - points.mean(axis=0)
    _, _, rows = np.linalg.svd(centred, full_matrices=False)
    way = rows[0] if float((points[-1] - points[0]) @ rows[0]) >= 0 else -rows[0]
    return centred @ way, way


def fit(places: NDArray[np.float64], log: Log, late_px: float = 0.0) -> Line:
    """Mean and scatter of the displacements between places along a line, r_0 … r_n with n of 2 or more.

    late_px: the way that the mount crept after the last of them; it belongs to the mean. A sine over the steps (the
    screw's turn) is fitted where it explains significantly more than chance: else its part of a period would count as
    an error of the mean.
    """
    d = np.diff(places)
    n = len(d)
    flat = float(d.var(ddof=1))
    tried = _waves(d) if n >= _LEAST_FITTED else []
    best = min(tried, key=lambda each: each.squares) if tried else None
    degrees = n - 4
    if best is None or (flat * (n - 1) - best.squares) / 3 < _SIGNIFICANT * best.squares / degrees:
        scatter = math.sqrt(max(0.0, log.own_variance(flat) - log.drift2))
        return Line(
            Estimate(float(d.mean()) + late_px / n, log.error_of_mean(d), "px", n), _scatter(scatter, flat, n - 1), None
        )
    residual = best.squares / degrees
    own = log.own_variance(residual) + 2 * log.error_px**2 / n
    error = _reach(tried, best, own) * student(degrees)
    scatter = math.sqrt(max(0.0, log.own_variance(residual) - log.drift2))
    wave = Wave(best.amplitude / abs(best.mean) if best.mean else math.inf, best.period)
    return Line(Estimate(best.mean + late_px / n, error, "px", n), _scatter(scatter, residual, degrees), wave)


def _scatter(scatter: float, variance: float, degrees: int) -> Estimate:
    return Estimate(scatter, math.sqrt(variance / (2 * degrees)), "px", degrees + 1)


@dataclass(frozen=True)
class _Fit:
    """A mean and a sine of one period. gain: variance of the mean, in parts of the variance of a displacement."""

    period: float
    mean: float
    amplitude: float
    squares: float
    gain: float


def _waves(d: NDArray[np.float64]) -> list[_Fit]:
    """The least-squares fits of a mean and a sine, for each of many periods."""
    n = len(d)
    k = np.arange(n) + 0.5
    fits = []
    for period in np.geomspace(_LEAST_PERIOD, 2 * n, _TRIED):
        w = 2 * math.pi / period
        model = np.column_stack([np.ones(n), np.cos(w * k), np.sin(w * k)])
        inverse = np.linalg.inv(model.T @ model)
        mean, cosine, sine = (float(c) for c in inverse @ (model.T @ d))
        squares = float(np.sum((d - model @ (mean, cosine, sine)) ** 2))
        fits.append(_Fit(float(period), mean, math.hypot(cosine, sine), squares, float(inverse[0, 0])))
    return fits


def _reach(tried: list[_Fit], best: _Fit, variance: float) -> float:
    """Half of the interval of the mean at two standard errors, by the profile of the likelihood over the periods.

    The period is not linear: with less than a turn of the screw, a longer one with another mean fits nearly as well.
    """
    reach = 0.0
    for each in tried:
        worse = (each.squares - best.squares) / variance
        if worse < 4:
            reach = max(reach, abs(each.mean - best.mean) + math.sqrt(each.gain * variance * (4 - worse)))
    return reach / 2
