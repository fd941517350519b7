"""The paper's Fig. 5 from pictures: a square of steps, with the mount's own take-up. How well does it close?"""

import math
from itertools import pairwise

import numpy as np

from mirrormount.beam.estimate import Estimate
from mirrormount.beam.experiments.stepping import Log
from mirrormount.beam.result import Result, Series, Tell
from mirrormount.beam.rig import Rig
from mirrormount.common.beam_errors import NotMeasurable

SIDE = 10  # steps, as in the paper's Fig. 5
_APPROACH = 3  # steps, so that the first side begins without a reversal
_SIDES = (("x", 1, "right"), ("y", 1, "up"), ("x", -1, "left"), ("y", -1, "down"))


def run(rig: Rig, result: Result, tell: Tell, side: int = SIDE) -> None:
    """Fill the result; the mount needs axes x and y. Raises NotMeasurable, SpotLost, CameraError, MountError."""
    if not {"x", "y"} <= set(rig.axes):
        raise NotMeasurable("a square needs the axes x and y")
    log = Log(rig, result)
    for axis in ("x", "y"):
        rig.step(axis, -_APPROACH)
        rig.step(axis, _APPROACH)
    corners = [log.look()]
    for number, (axis, way, name) in enumerate(_SIDES):
        for k in range(side):
            tell((number + k / side) / len(_SIDES), f"{name}, step {k + 1}")
            rig.step(axis, way)
            log.look()
        corners.append(log.last)
    reading = math.sqrt(2) * log.error_px
    for (a, b), (_, _, name) in zip(pairwise(corners), _SIDES, strict=True):
        result.estimates[f"side.{name}"] = Estimate(float(np.linalg.norm(b - a)), reading, "px")
    gap = corners[-1] - corners[0]
    result.estimates["closure.x"] = Estimate(float(gap[0]), reading, "px")
    result.estimates["closure.y"] = Estimate(float(gap[1]), reading, "px")
    points = [(float(row[1]), float(row[2]), 0.0) for row in result.readings]
    result.series.append(Series("The square in the picture", "x in px", "y in px", points, in_picture=True))
    tell(1.0, "")
