"""The size of a step, and the pulse for a wanted step.

Size: how far a step moves the spot, in both directions of each axis, how much it scatters, and where the axes point.
Successive readings r_0 … r_n along a line give n displacements d_k = r_k - r_(k-1). Their mean is (r_n - r_0)/n, so a
reading's own error counts in it twice and not 2n times, and the scatter of the d_k is that of the steps plus twice a
reading's.

Wanted step: pulses of other lengths between steps. A pulse and the step beside it are at nearly the same place of the
screw, so their ratio does not have its periodic error; their order changes from pair to pair. A motor that starts up
covers less than in proportion, so a first length is tried and corrected, until the size is met.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mirrormount_beam.errors import NotMeasurable
from mirrormount_beam.estimates import Estimate, Result, Series, Tell, student
from mirrormount_beam.experiments.rig import Rig, Vector, place
from mirrormount_beam.observe import Sighting

# ---- steps along a line

_LEAST_PERIOD = 12.0  # The shortest period of a screw's turn that is searched for, in steps; the paper's screw has 40.
_TRIED = 60  # So many periods are tried.
# The least F of the three parameters of a period: it is large, because the best of many periods is taken.
_SIGNIFICANT = 6.0
LEAD = 5  # steps before a run, and at its turn: more than any backlash that setup accepts
_TRIAL = 4  # So many steps give a first estimate of the size of a step.
_MARGIN_PX = 40.0  # The spot stays so far from the picture's edge, so that it is seen whole.
_LEAST = 8  # The picture must have room for so many steps.
_LEAST_FITTED = 16  # A fit of four parameters needs so many steps.
AT_REST = 16  # So many observations are made without a move.
_REST_DEGREES = 2 * (AT_REST - 1)  # Degrees of freedom of the drift: each observation has two coordinates.
_CREEP_S = 6.0  # The time between two observations of a mount that may creep: a part of the usual time constants.
_MOST_WAITS = 12
_RETURNS = 4  # A return to a position takes up to so many moves: each turn loses some of the first move.


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
        """Observe several times without a move, to know how far the beam drifts between two observations."""
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

        Few displacements say little of their scatter. If they vary by less than drift and readings alone would
        make them, that is chance: their variance is pooled with the drift measured at rest. Otherwise their own
        variance is used. To pool also those that vary a little more would make the error too small wherever chance
        has hidden a real scatter.
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


# ---- the pulse for a wanted step

PAIRS = 16  # in each direction
LEAST_US, MOST_US = 200, 2_000_000  # of a pulse
WAYS = ((1, "positive"), (-1, "negative"))
_LEAST_PAIRS = 4
_TRIALS = 4
_SURE = 3.0  # standard errors
_NEAR = 0.03  # of the wanted size: from here on the curve is taken as straight


def run_step_size(rig: Rig, result: Result, tell: Tell, wanted_px: Mapping[str, float]) -> None:
    """Add, for each axis, `wanted.pulse` in us, and the size of a step of it in both directions.

    wanted_px: the mean of both directions. The result is that of steps.run(), and the mount is where that left it.
    Raises NotMeasurable, SpotLost, CameraError, MountError.
    """
    log = Log(rig, result)
    for number, (axis, wanted) in enumerate(wanted_px.items()):
        us, size = float(rig.step_us(axis)), _mean(_sizes(result, axis))
        tried = [(us, size.value, size.error)]
        sizes: list[Estimate] = []
        for trial in range(_TRIALS):
            us = _corrected(tried, wanted, axis)
            tell((number + trial / _TRIALS) / len(wanted_px), f"{axis}: pulses of {us / 1000:.1f} ms")
            sizes = _trial(rig, log, result, axis, round(us))
            size = _mean(sizes)
            tried.append((us, size.value, size.error))
            if size.value < _SURE * size.error:
                raise NotMeasurable(
                    f"{axis}: pulses of {us / 1000:.2g} ms do not move the spot for certain: take a larger step"
                )
            if abs(size.value / wanted - 1) < max(_NEAR, 2 * size.error / size.value):
                break
        else:
            raise NotMeasurable(
                f"{axis}: pulses of one length differ too much for a step of this size: take a larger one"
            )
        us = _corrected(tried, wanted, axis)
        result.estimates[f"{axis}.wanted.pulse"] = Estimate(round(us), us * size.error / size.value, "us", size.count)
        for (_, name), each in zip(WAYS, sizes, strict=True):
            result.estimates[f"{axis}.wanted.{name}.step"] = each.scaled(wanted / size.value, "px")
        points = sorted((t / 1000, px, error) for t, px, error in tried)
        result.series.append(Series(f"{axis}: the size of a step by its pulse", "pulse in ms", "px", points))
    tell(1.0, "")


def _sizes(result: Result, axis: str) -> list[Estimate]:
    """A step in both directions, as steps.run() has found it."""
    return [result.estimates[f"{axis}.{name}.step"] for _, name in WAYS]


def _mean(both: list[Estimate]) -> Estimate:
    error = math.hypot(*(each.error for each in both)) / 2
    return Estimate((both[0].value + both[1].value) / 2, error, "px", sum(each.count for each in both))


def _corrected(tried: list[tuple[float, float, float]], wanted: float, axis: str) -> float:
    """The length for the wanted size: in proportion, or by the slope if two lengths are apart. Raises NotMeasurable."""
    us, size, _ = tried[-1]
    slope = size / us
    if len(tried) > 1 and abs(us / tried[-2][0] - 1) > 0.1:
        slope = min(max((size - tried[-2][1]) / (us - tried[-2][0]), 0.5 * slope), 3 * slope)
    length = max(us + (wanted - size) / slope, us / 4)
    if not LEAST_US <= length <= MOST_US:
        raise NotMeasurable(
            f"{axis}: a step of this size would need a pulse of {length / 1000:.1f} ms;"
            f" a pulse has {LEAST_US / 1000:g} … {MOST_US / 1000:g} ms"
        )
    return length


def _trial(rig: Rig, log: Log, result: Result, axis: str, us: int) -> list[Estimate]:
    """The size of a pulse of `us` in both directions, by its ratio to the steps beside it."""
    steps = result.estimates[f"{axis}.positive.step"].count
    of_a_step = us / rig.step_us(axis)
    pairs = min(PAIRS, math.floor(steps / (1 + of_a_step)))
    if pairs < _LEAST_PAIRS:
        raise NotMeasurable(
            f"{axis}: the picture has no room for {_LEAST_PAIRS} steps of this size, each beside one of now"
        )
    half = math.ceil(pairs * (1 + of_a_step) / 2)
    rig.step(axis, -half - LEAD)
    rig.step(axis, LEAD)
    found = []
    for way, name in WAYS:
        ratio = _ratio(rig, log, axis, way, us, pairs)
        found.append(result.estimates[f"{axis}.{name}.step"].scaled(ratio, "px"))
        if way > 0:
            rig.step(axis, LEAD)
            rig.step(axis, -LEAD)
    rig.step(axis, half)
    return found


def _ratio(rig: Rig, log: Log, axis: str, way: int, us: int, pairs: int) -> Estimate:
    """The way of a pulse in parts of that of a step."""
    places, is_pulse = [log.observe()], []
    for pair in range(pairs):
        for pulse in (pair % 2 == 0, pair % 2 == 1):
            if pulse:
                rig.pulse(axis, way * us)
            else:
                rig.step(axis, way)
            places.append(log.observe())
            is_pulse.append(pulse)
    d, which = np.diff(along(places)[0]), np.array(is_pulse)
    pulses, steps = d[which], d[~which]
    ratio = float(pulses.sum() / steps.sum())
    rest = pulses - ratio * steps
    error = math.sqrt(float(rest @ rest) / (pairs - 1) / pairs) / float(steps.mean())
    return Estimate(ratio, error * student(pairs - 1), "", pairs)


# ---- the size of a step

STEPS = 60  # in each direction: more than a turn of a screw, so that its periodic error averages out


def run(rig: Rig, result: Result, tell: Tell, n: int = STEPS) -> None:
    """Fill the result. Raises NotMeasurable, SpotLost, CameraError, MountError."""
    log = Log(rig, result)
    log.rest()
    ways: dict[str, tuple[Vector, Estimate]] = {}
    for number, axis in enumerate(rig.axes):
        done = number / len(rig.axes)
        tell(done, f"{axis}: the size of a step")
        home = log.observe()
        most, step = room(rig, log, axis)
        count = min(n, most)
        if count < n:
            result.remarks.append(f"{axis}: the picture shows {count} steps only, not {n}")
        # each run has its middle at home: far from there the same turn of a mirror moves the spot another way
        come_back(rig, log, axis, home - (count // 2 + LEAD) * step, step)
        rig.step(axis, LEAD)
        for direction, name in ((1, "positive"), (-1, "negative")):
            tell(done + (0.1 if direction > 0 else 0.55) / len(rig.axes), f"{axis}: {count} steps, {name}")
            log.settle()
            places = series(rig, log, axis, count, direction)
            at, way = along(places)
            apart_s, last_s = log.apart_s(count), log.now_s
            late_px = float((log.settle() - places[-1]) @ way)
            ended = Ended(apart_s, late_px, log.now_s - last_s)
            ways[f"{axis}.{name}"] = _direction(places, log, apart_s)
            _add(result, f"{axis}.{name}", fit(at, log, ended), places)
            if direction > 0:
                rig.step(axis, LEAD)
                rig.step(axis, -LEAD)
        come_back(rig, log, axis, home, ways[f"{axis}.positive"][0])
        _compare(result, axis)
    _orientation(result, ways, rig.axes)
    tell(1.0, "")


def _direction(places: list[Vector], log: Log, apart_s: float) -> tuple[Vector, Estimate]:
    """The mean displacement, and its angle in the picture in mrad, from the picture's x towards its top."""
    steps = np.diff(np.array(places), axis=0)
    mean = steps.mean(axis=0)
    size = float(np.linalg.norm(mean))
    across = steps @ np.array([-mean[1], mean[0]]) / size
    error = log.error_of_mean(across, Ended(apart_s)) / size
    return mean, Estimate(math.atan2(-mean[1], mean[0]) * 1e3, error * 1e3, "mrad", len(steps))


def _add(result: Result, name: str, line: Line, places: list[Vector]) -> None:
    result.estimates[f"{name}.step"] = line.mean
    result.estimates[f"{name}.scatter"] = line.scatter.scaled(100 / line.mean.value, "% of a step")
    if line.wave:
        result.remarks.append(
            f"{name}: the step changes by ± {100 * line.wave.amplitude:.0f} % with a period of"
            f" {line.wave.period:.0f} steps (a turn of the screw?)"
        )
    sizes = [float(np.linalg.norm(b - a)) for a, b in pairwise(places)]
    points = [(float(k), size, 0.0) for k, size in enumerate(sizes, 1)]
    result.series.append(Series(f"Each step: {name}", "step", "px", points))


def _compare(result: Result, axis: str) -> None:
    positive, negative = (result.estimates[f"{axis}.{way}.step"] for way in ("positive", "negative"))
    result.estimates[f"{axis}.negative_over_positive"] = negative.over(positive)


def _orientation(result: Result, ways: dict[str, tuple[Vector, Estimate]], axes: tuple[str, ...]) -> None:
    """The camera's rotation, by x's way in the picture, and by how much the axes are not square."""
    angles: dict[str, Estimate] = {}
    for axis in axes:
        there, back = ways[f"{axis}.positive"][1], ways[f"{axis}.negative"][1]
        turned = _near(back.value + math.pi * 1e3, there.value)
        error = math.hypot(there.error, back.error) / 2
        angles[axis] = Estimate((there.value + turned) / 2, error, "mrad", there.count + back.count)
        result.estimates[f"{axis}.angle_in_picture"] = angles[axis]
    if "x" in angles and "y" in angles:
        apart = angles["y"].minus(angles["x"])
        right = math.copysign(math.pi / 2 * 1e3, _near(apart.value, 0.0))
        cross = Estimate(_near(apart.value, right) - right, apart.error, "mrad", apart.count)
        result.estimates["cross_talk"] = cross  # by how much y's way is not perpendicular to x's


def _near(mrad: float, to: float) -> float:
    """The same angle, within half a turn of another one."""
    turn = 2 * math.pi * 1e3
    return to + (mrad - to + turn / 2) % turn - turn / 2
