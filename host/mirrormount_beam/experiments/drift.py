"""Experiments in which the mount stands: drift over a long time, and the time to settle after a move."""

import math

import numpy as np
from numpy.typing import NDArray

from mirrormount_beam.estimates import Estimate, Result, Series, Tell, student
from mirrormount_beam.experiments.rig import Rig
from mirrormount_beam.experiments.steps import Log, come_back

DRIFT_S = 3600.0
EVERY_S = 10.0
LEAST_DRIFT_S = 3 * EVERY_S  # fewer readings have no error
SETTLE_S = 30.0
_MOVE = 10  # steps before the mount settles
_LAST = 0.3  # of the time: the end of a settling, which counts as at rest


def drift(rig: Rig, result: Result, tell: Tell, seconds: float = DRIFT_S, every_s: float = EVERY_S) -> None:
    """Nothing moves; the place of the spot over time. Raises SpotLost, CameraError, MountError."""
    log = Log(rig, result)
    result.moves = False
    log.observe()
    while log.now_s < seconds:
        tell(log.now_s / seconds, f"{log.now_s:.0f} s of {seconds:.0f} s")
        rig.sleep(every_s)
        log.observe()
        _drifted(result, log.error_px)
    tell(1.0, "")


def _drifted(result: Result, reading_px: float) -> None:
    """The figures of all readings so far: an experiment that ends early has them, too."""
    rows = np.array([row[:3] for row in result.readings], dtype=float)
    t, places = rows[:, 0], rows[:, 1:]
    n = len(t) - 1
    result.series = [
        Series(
            f"Drift of the spot, {name}",
            "time in s",
            "px",
            [(a, b, reading_px) for a, b in zip(t, at - at[0], strict=True)],
        )
        for name, at in (("x", places[:, 0]), ("y", places[:, 1]))
    ]
    result.remarks = [
        f"rms and peak to peak are those of these {t[-1] / 60:.1f} min, with the errors of the readings in them:"
        " they have no error, and grow with the time"
    ]
    for name, at in (("x", places[:, 0]), ("y", places[:, 1])):
        result.estimates[f"{name}.rms"] = Estimate(float(np.std(at)), float("nan"), "px", n + 1)
        result.estimates[f"{name}.peak_to_peak"] = Estimate(float(np.ptp(at)), float("nan"), "px", n + 1)
        if n > 1:
            # a random walk: increments of variance w² dt, and twice the reading's own
            walk = max(0.0, float(np.mean((np.diff(at) ** 2 - 2 * reading_px**2) / np.diff(t))))
            noise = float(np.mean(2 * reading_px**2 / np.diff(t)))
            error = (walk + noise) * math.sqrt(2 / n) * student(n)
            w = math.sqrt(walk)
            result.estimates[f"{name}.walk"] = Estimate(w, error / (2 * w) if w else math.sqrt(error), "px/sqrt(s)", n)


def settle(rig: Rig, result: Result, tell: Tell, seconds: float = SETTLE_S) -> None:
    """The way of the spot after the end of a move, in both directions of each axis. Raises as drift()."""
    log = Log(rig, result)
    log.rest()
    home, ways = log.last, {}
    runs = [(axis, way) for axis in rig.axes for way in (1, -1)]
    for number, (axis, way) in enumerate(runs):
        name = f"{axis}.{'positive' if way > 0 else 'negative'}"
        rig.step(axis, -way * _MOVE)
        before = log.observe()
        rig.step(axis, way * _MOVE)
        after = log.observe()
        line = (after - before) / max(float(np.linalg.norm(after - before)), 1e-9)
        ways[axis] = way * (after - before) / _MOVE
        start_s, points = log.now_s, [(log.now_s, float(after @ line))]
        while points[-1][0] - start_s < seconds:
            tell((number + (points[-1][0] - start_s) / seconds) / len(runs), f"{name}: settling")
            points.append((0.0, float(log.observe() @ line)))
            points[-1] = log.now_s, points[-1][1]
        _settled(result, name, np.array(points), log)
    for axis, each in ways.items():
        if float(np.linalg.norm(each)) > 3 * log.error_px:
            come_back(rig, log, axis, home, each)
    tell(1.0, "")


def _settled(result: Result, name: str, points: NDArray[np.float64], log: Log) -> None:
    t, at = points[:, 0] - points[0, 0], points[:, 1]
    reading2 = log.error_px**2
    late = t >= t[-1] * (1 - _LAST)
    rest, rest_s = float(at[late].mean()), float(t[late][0])
    # the beam drifts meanwhile: a random walk's mean over the last part, against its first place
    walked_s = rest_s + (t[-1] - rest_s) / 3
    error = log.error_between(walked_s, 1 + 1 / int(np.count_nonzero(late)))
    creep = Estimate(rest - float(at[0]), error, "px", len(at))
    result.estimates[f"{name}.creep"] = creep
    seen_px = 2 * np.sqrt(2 * reading2 + log.walk2 * (t[-1] - t))  # a creep that is larger would show
    outside = np.nonzero(np.abs(at - rest) > seen_px)[0]
    settled_s = float(t[min(outside[-1] + 1, len(t) - 1)]) if len(outside) else 0.0
    if abs(creep.value) < 2 * creep.error:
        result.remarks.append(f"{name}: no creep that is larger than the beam's own drift in {t[-1]:.0f} s")
    elif settled_s > (1 - _LAST) * t[-1]:
        result.remarks.append(
            f"{name}: the spot moves until the end of the {t[-1]:.0f} s: when it is at rest is not known"
        )
    else:
        # no error: the time depends on what the drift lets see
        result.estimates[f"{name}.settled_after"] = Estimate(settled_s, math.nan, "s", len(at))
        result.remarks.append(
            f"{name}: from {settled_s:.0f} s on the spot is within {seen_px[0]:.2g} px of its rest, as far as the drift"
            " lets see"
        )
    result.series.append(
        Series(
            f"After {_MOVE} steps: {name}",
            "time after the move in s",
            "px",
            [(float(a), float(b - rest), log.error_px) for a, b in zip(t, at, strict=True)],
        )
    )
