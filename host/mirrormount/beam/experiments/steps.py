"""How far a step moves the spot, in both directions of each axis, how much it scatters, and where the axes point."""

import math
from itertools import pairwise

import numpy as np

from mirrormount.beam.estimate import Estimate
from mirrormount.beam.experiments.stepping import LEAD, Ended, Line, Log, along, come_back, fit, room, series
from mirrormount.beam.result import Result, Series, Tell
from mirrormount.beam.rig import Rig, Vector

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
        # each run has its middle at home: elsewhere the way of a mirror across the incidence has another direction
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
