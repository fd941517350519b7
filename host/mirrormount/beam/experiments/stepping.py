"""Steps along a line: how far each of them moves the spot. Imports estimate, result, rig, numpy.

Successive readings r_0 … r_n give n displacements d_k = r_k - r_(k-1). Their mean is (r_n - r_0)/n, so a reading's own
error counts in it twice and not 2n times, and the scatter of the d_k is that of the steps plus twice a reading's.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mirrormount.beam.estimate import Estimate, student
from mirrormount.beam.observe import Sighting
from mirrormount.beam.result import Result
from mirrormount.beam.rig import Rig, Vector, place
from mirrormount.common.beam_errors import NotMeasurable

_LEAST_PERIOD = 12.0  # steps of a screw's turn that are looked for; the paper's screw has 40
_TRIED = 60  # periods
_SIGNIFICANT = 6.0  # the F of three more parameters, of which the period is chosen among many
LEAD = 5  # steps before a run, and at its turn: more than any backlash that setup accepts
_TRIAL = 4  # steps for a first look at the size of a step
_MARGIN_PX = 40.0  # of the picture's edge: a spot must be whole
_LEAST = 8  # steps that the picture shows
_LEAST_FITTED = 16  # steps, for a fit of four parameters
AT_REST = 16  # looks without a move
_REST_DEGREES = 2 * (AT_REST - 1)  # of freedom of the drift: each look has two coordinates
_CREEP_S = 6.0  # between two looks at a mount that may creep: a part of the time constants that are usual
_MOST_WAITS = 12
_RETURNS = 4  # moves back to a place: a turn loses some of the first


@dataclass(frozen=True)
class Ended:
    """How a series ended. apart_s: the mean time between two of its readings. late_px, late_s: what the mount crept
    on after the last of them, along the line, and the time that this was waited for."""

    apart_s: float
    late_px: float = 0.0
    late_s: float = 0.0


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
        self.walk2 = 0.0  # variance of the spot's drift in one second, in px²
        self._walk2_error = 0.0  # its standard error

    def observe(self) -> Vector:
        """Where the spot is, in px. Raises SpotLost, CameraError."""
        sighting: Sighting = self._rig.observe()
        if self._first_s is None:
            self._first_s = sighting.time_s
        self._result.readings.append(
            (sighting.time_s - self._first_s, sighting.x, sighting.y, sighting.error_x, sighting.error_y)
        )
        self._variances.append((sighting.error_x**2 + sighting.error_y**2) / 2)
        return place(sighting)

    def rest(self) -> None:
        """Observe several times without a move, to know by how much the beam drifts from look to look."""
        places = np.array([self.observe() for _ in range(AT_REST)])
        variance = float(np.mean(np.diff(places, axis=0) ** 2))
        apart_s = self.apart_s(AT_REST - 1)
        self.walk2 = max(0.0, variance - 2 * self.error_px**2) / apart_s
        self._walk2_error = variance * math.sqrt(2 / _REST_DEGREES) / apart_s

    def settle(self) -> Vector:
        """Wait until the mount does not creep any more, as far as the beam's own drift lets see. Returns the place."""
        places = [self.observe()]
        allowed = 2 * math.sqrt(4 * self.error_px**2 + 2 * _CREEP_S * self.walk2)  # in either direction, in two waits
        for _ in range(_MOST_WAITS):
            self._rig.sleep(_CREEP_S)
            places.append(self.observe())
            if len(places) > 2 and float(np.linalg.norm(places[-1] - places[-3])) < allowed:
                break
        return places[-1]

    def apart_s(self, n: int) -> float:
        """The mean time between two of the last n + 1 readings."""
        return (self._result.readings[-1][0] - self._result.readings[-1 - n][0]) / n

    def error_of_mean(self, d: NDArray[np.float64], ended: Ended) -> float:
        """The standard error of the mean of displacements between successive readings along a line."""
        n = len(d)
        own, degrees = self.own_variance(float(d.var(ddof=1)), n - 1, ended.apart_s)
        return math.sqrt((own + self.of_ends(n, ended)) / n) * student(degrees)

    def of_ends(self, n: int, ended: Ended) -> float:
        """What the first and the last reading, and the wait after it, add to the variance of n displacements."""
        return (2 * self.error_px**2 + self.walk2 * ended.late_s) / n

    def own_variance(self, variance: float, degrees: int, apart_s: float) -> tuple[float, float]:
        """The variance of displacements without the readings' errors, and its degrees of freedom.

        Few displacements say little of their scatter. Those that vary by less than drift and readings alone do so by
        chance, and are put together with what they were at rest. All others stand for themselves: to choose by what is
        clearly more would make the error too small wherever chance has hidden a real scatter.
        """
        reading2, drift2 = 2 * self.error_px**2, self.walk2 * apart_s
        if not drift2 or variance > drift2 + reading2:
            return max(0.0, variance - reading2), degrees
        alike = min(degrees, _REST_DEGREES)
        both = (degrees * (variance - reading2) + alike * drift2) / (degrees + alike)
        return max(drift2 / 2, both), degrees + alike

    def error_between(self, seconds: float, readings: float = 2.0) -> float:
        """The standard error of the way between two readings, along one line: theirs, and the drift of that time.

        The drift is an estimate itself, so the error is widened as by few samples (Satterthwaite's degrees of freedom;
        Biometrics Bull. 2 (1946) 110), at most to what twice the drift's own error makes of it.
        readings: what they add, in variances of one reading.
        """
        variance = readings * self.error_px**2 + self.walk2 * seconds
        unsure = self._walk2_error * seconds / variance if variance else 0.0
        few = student(2 / unsure**2) if unsure else 1.0
        return math.sqrt(variance) * min(few, math.sqrt(1 + 2 * unsure))

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
    places = [log.observe()]
    for _ in range(count):
        rig.step(axis, n)
        places.append(log.observe())
    return places


def come_back(rig: Rig, log: Log, axis: str, home: Vector, way: Vector) -> None:
    """Step until the spot is beside home, along the axis's way, by less than half a step or so.

    Counting steps does not bring it there: a turn loses some, and steps there and back differ.
    way: of one step to positive, in px. Raises SpotLost, CameraError, MountError.
    """
    for _ in range(_RETURNS):
        n = round(float((home - log.observe()) @ way / (way @ way)))
        if not n:
            return
        rig.step(axis, n)


def along(places: list[Vector]) -> tuple[NDArray[np.float64], Vector]:
    """The places along the line that fits them best (its way from the first to the last), and its unit vector."""
    points = np.array(places)
    centred = points - points.mean(axis=0)
    _, _, rows = np.linalg.svd(centred, full_matrices=False)
    way = rows[0] if float((points[-1] - points[0]) @ rows[0]) >= 0 else -rows[0]
    return centred @ way, way


def room(rig: Rig, log: Log, axis: str) -> tuple[int, Vector]:
    """How many steps the picture shows, half of them on either side of the present place; the way of one, px.

    Raises NotMeasurable.
    """
    origin = log.observe()
    rig.step(axis, LEAD)
    start = log.observe()
    rig.step(axis, _TRIAL)
    step = (log.observe() - start) / _TRIAL
    rig.step(axis, -_TRIAL - LEAD)
    size = float(np.linalg.norm(step))
    if size < 3 * log.error_px:
        raise NotMeasurable(
            f"{axis}: {_TRIAL} steps moved the spot by {size * _TRIAL:.2f} px: look at motor and coupler"
        )
    ways = []  # from the origin to the nearer edge, in steps
    for at, way, length in zip(origin, step, rig.picture_px, strict=True):
        if abs(way) > size / 50:
            ways.append((min(at, length - 1 - at) - _MARGIN_PX) / abs(way))
    count = 2 * (math.floor(min(ways)) - LEAD)
    if count < _LEAST:
        raise NotMeasurable(
            f"{axis}: the picture has room for {max(count, 0)} steps of {size:.0f} px: move the spot to its middle, or"
            " put the camera nearer to the mirror"
        )
    return count, step


def fit(places: NDArray[np.float64], log: Log, ended: Ended) -> Line:
    """Mean and scatter of the displacements between places along a line, r_0 … r_n with n of 2 or more.

    What the mount crept on after the last of them belongs to the mean. A sine over the steps (the
    screw's turn) is fitted where it explains significantly more than chance: else its part of a period would count as
    an error of the mean.
    """
    d = np.diff(places)
    n = len(d)
    flat = float(d.var(ddof=1))
    tried = _waves(d) if n >= _LEAST_FITTED else []
    best = min(tried, key=lambda each: each.squares) if tried else None
    degrees, late = n - 4, ended.late_px / n
    if best is None or (flat * (n - 1) - best.squares) / 3 < _SIGNIFICANT * best.squares / degrees:
        mean = Estimate(float(d.mean()) + late, log.error_of_mean(d, ended), "px", n)
        return Line(mean, _scatter(log, flat, n - 1, ended), None)
    residual = best.squares / degrees
    own, degrees = log.own_variance(residual, degrees, ended.apart_s)
    error = _reach(tried, best, own + log.of_ends(n, ended)) * student(degrees)
    wave = Wave(best.amplitude / abs(best.mean) if best.mean else math.inf, best.period)
    return Line(Estimate(best.mean + late, error, "px", n), _scatter(log, residual, n - 4, ended), wave)


def _scatter(log: Log, variance: float, degrees: int, ended: Ended) -> Estimate:
    """The scatter of one step: what drift and readings leave of the variance of displacements.

    The variances have errors, so 0 ± something is an answer: that scatter is too small to be seen.
    """
    other = 2 * log.error_px**2 + log.walk2 * ended.apart_s
    error = math.hypot(variance * math.sqrt(2 / degrees), other * math.sqrt(2 / _REST_DEGREES))
    own = max(0.0, variance - other)
    value = math.sqrt(own)
    upper, lower = math.sqrt(own + 2 * error) - value, value - math.sqrt(max(0.0, own - 2 * error))
    return Estimate(value, max(upper, lower) / 2, "px", degrees + 1)


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
