"""How far a pulse moves the spot, by its length: a motor that starts up covers less than in proportion."""

import math

import numpy as np

from mirrormount.beam.estimate import Estimate
from mirrormount.beam.experiments.stepping import Ended, Log, come_back
from mirrormount.beam.result import Result, Series, Tell
from mirrormount.beam.rig import Rig, Vector
from mirrormount.common.beam_errors import NotMeasurable

LENGTHS_MS = (1, 2, 3, 5, 8, 12, 20, 35, 60, 100)
COUNT = 8  # pulses of each length
_LEAD = 5  # steps before a run: through any backlash
_LEAST_US = 200  # of the board


def run(rig: Rig, result: Result, tell: Tell, lengths_ms: tuple[float, ...] = LENGTHS_MS, count: int = COUNT) -> None:
    """Fill the result. Raises NotMeasurable, SpotLost, CameraError, MountError."""
    log = Log(rig, result)
    log.rest()
    home = log.last
    runs = [(axis, way) for axis in rig.axes for way in (1, -1)]
    for number, (axis, way) in enumerate(runs):
        name = f"{axis}.{'positive' if way > 0 else 'negative'}"
        rig.step(axis, -way * _LEAD)
        rig.step(axis, way * _LEAD)
        first = log.settle()
        rig.step(axis, way)
        line = log.observe() - first
        step_px = float(np.linalg.norm(line))
        if step_px < 3 * log.error_px:
            raise NotMeasurable(f"{axis}: a step did not move the spot: look at motor and coupler")
        per_step, line = line, line / step_px
        points: list[tuple[float, float, float]] = []
        for at, ms in enumerate(sorted(lengths_ms)):
            tell((number + at / len(lengths_ms)) / len(runs), f"{name}: pulses of {ms:g} ms")
            each = _pulses(rig, log, axis, way * round(ms * 1000), count, line)
            result.estimates[f"{name}.pulse_{ms:g}ms"] = each
            points.append((ms, each.value, each.error))
        result.series.append(Series(f"One pulse: {name}", "length in ms", "px", points))
        result.remarks.append(f"{name}: {_proportion(points, step_px, rig.step_us(axis))}")
        come_back(rig, log, axis, home, way * per_step)
    result.remarks.append("all at one place of the travel: where the screw's steps are larger, pulses are, too")
    result.remarks.append("what a mount creeps on after the last pulse of a length is not in it")
    tell(1.0, "")


def _pulses(rig: Rig, log: Log, axis: str, us: int, count: int, line: Vector) -> Estimate:
    """The mean way of a pulse along a line, by readings between the pulses."""
    places = [float(log.observe() @ line)]
    for _ in range(count):
        rig.pulse(axis, int(math.copysign(max(abs(us), _LEAST_US), us)))
        places.append(float(log.observe() @ line))
    d = np.diff(places)
    return Estimate(float(d.mean()), log.error_of_mean(d, Ended(log.apart_s(count))), "px", count)


def _proportion(points: list[tuple[float, float, float]], step_px: float, step_us: int) -> str:
    """The length from which on every pulse moves the spot for certain, and its way beside that in proportion."""
    certain = None
    for ms, px, error in reversed(points):
        if px < 3 * error:
            break
        certain = ms, px
    if certain is None:
        return "no pulse of these lengths moved the spot for certain"
    ms, px = certain
    share = px / (step_px * ms * 1000 / step_us)
    return f"from {ms:g} ms on a pulse moves the spot for certain: {share:.2f} of its share of a step"
