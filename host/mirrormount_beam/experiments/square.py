"""The paper's Fig. 5 from pictures: a square of steps, right, down, left, up. How well does it close?

It is driven twice: first without the mount's take-up, as the paper did, so that what stays open is the backlash; then
with it. What is open is told along the mount's own axes, by the ways of the first two sides in the picture.

Steps there and back may differ, and then a square stays open without any backlash. So the backlash of a way
back is not read from the gap of the square, but found from the steps behind the backlash: how many steps back cover
the same way as how many steps there.
"""

import math
from dataclasses import dataclass

import numpy as np

from mirrormount_beam.errors import NotMeasurable
from mirrormount_beam.estimates import Estimate, Result, Series, Tell, student
from mirrormount_beam.experiments.rig import Rig, Vector
from mirrormount_beam.experiments.steps import LEAD, Log, come_back, room

SIDE = 20  # steps, as in the paper's Fig. 5
_APPROACH = 3  # steps, so that the first two sides begin without a reversal
_SIDES = (("x", 1, "right"), ("y", -1, "down"), ("x", -1, "left"), ("y", 1, "up"))
_WAYS = {"x": "right", "y": "down"}  # the sides that begin without a reversal
_LEAST = 4  # steps behind the gap, for what is lost in it
_INTERPOLATED = 1.2  # 2 / (1 + 2/3): the way there is interpolated, which leaves 2/3 of its variance


@dataclass(frozen=True)
class _Square:
    """The five corners, when each was seen, and the places of each side, both corners among them."""

    corners: list[Vector]
    times_s: list[float]
    sides: list[list[Vector]]


@dataclass(frozen=True)
class _Turn:
    """The backlash of a way back, in steps back, and the size of a step back over that of a step there."""

    lost: Estimate
    ratio: Estimate


def run(rig: Rig, result: Result, tell: Tell, side: int = SIDE) -> None:
    """Fill the result; the mount needs axes x and y. Raises NotMeasurable, SpotLost, CameraError, MountError."""
    if not {"x", "y"} <= set(rig.axes):
        raise NotMeasurable("a square needs the axes x and y")
    log = Log(rig, result)
    tell(0.0, "the beam at rest")
    log.rest()
    home = log.last
    shown = min(room(rig, log, axis)[0] for axis in ("x", "y"))
    if shown < side:
        result.remarks.append(f"the picture shows a square of {shown} steps only, not {side}")
        side = shown
    as_is = _drive(rig, log, result, tell, side, home)
    _of_the_first(result, log, as_is, side)
    pulses = {axis: _take_up_us(rig, log, result, as_is, axis) for axis in ("x", "y")}
    closed = _drive(rig, log, result, tell, side, home, pulses)
    gaps = _open(log, closed, as_is)
    result.estimates.update({f"{axis}.open_with_take_up": gap for axis, gap in gaps.items()})
    for axis in ("x", "y"):
        own_us = rig.take_up_us(axis)
        shown = f"what the first square has shown, {pulses[axis]} us" if pulses[axis] else "none"
        what = f"the board's, {own_us} us" if own_us else shown
        result.remarks.append(f"{axis}: the take-up of the second square: {what}")
    tell(1.0, "")


def _drive(
    rig: Rig,
    log: Log,
    result: Result,
    tell: Tell,
    side: int,
    home: Vector,
    take_up_us: dict[str, int] | None = None,
) -> _Square:
    """One square about the present place, and then home. take_up_us: None for none."""

    def step(axis: str, n: int) -> None:
        if take_up_us is None:
            rig.step(axis, n)
        else:
            rig.step_taken_up(axis, n, take_up_us[axis])

    begun, first = (0.0, len(result.readings)) if take_up_us is None else (0.5, len(result.readings))
    for axis, way in (("x", 1), ("y", -1)):
        step(axis, -way * (side // 2 + _APPROACH))
        step(axis, way * _APPROACH)
    corners, times_s, sides = [log.observe()], [log.now_s], list[list[Vector]]()
    for number, (axis, way, name) in enumerate(_SIDES):
        sides.append([corners[-1]])
        for k in range(side):
            tell(begun + (number + k / side) / len(_SIDES) / 2, f"{name}, step {k + 1}")
            step(axis, way)
            sides[-1].append(log.observe())
        corners.append(log.last)
        times_s.append(log.now_s)
    points = [(float(row[1]), float(row[2]), 0.0) for row in result.readings[first:]]
    for axis, way, side_of in (("x", 1, corners[1] - corners[0]), ("y", -1, corners[2] - corners[1])):
        come_back(rig, log, axis, home, way * side_of / side)
    title = "The square in the picture, without take-up" if take_up_us is None else "The same with take-up"
    result.series.append(Series(title, "x in px", "y in px", points, in_picture=True))
    return _Square(corners, times_s, sides)


def _of_the_first(result: Result, log: Log, square: _Square, side: int) -> None:
    """Add sides, steps and what is open."""
    for k, (axis, _, name) in enumerate(_SIDES):
        length = float(np.linalg.norm(square.corners[k + 1] - square.corners[k]))
        error = log.error_between(square.times_s[k + 1] - square.times_s[k])
        result.estimates[f"{axis}.side_{name}"] = Estimate(length, error, "px", side)
    steps = {axis: result.estimates[f"{axis}.side_{name}"].scaled(1 / side, "px") for axis, name in _WAYS.items()}
    result.estimates.update({f"{axis}.step": step for axis, step in steps.items()})
    result.estimates.update({f"{axis}.open": gap for axis, gap in _open(log, square, square).items()})


def _take_up_us(rig: Rig, log: Log, result: Result, square: _Square, axis: str) -> int:
    """The pulse that takes up what the way back has lost; 0 where that is not known. Adds it, and what else is open."""
    there, back = (name for of, _, name in _SIDES if of == axis)
    turn = _turn(log, square, axis)
    if turn is None:
        result.remarks.append(f"{axis}: the way {back} has too few steps behind its backlash to tell how much that is")
        return 0
    result.estimates[f"{axis}.take_up"] = turn.lost.scaled(rig.step_us(axis), "us")
    ratio = turn.ratio
    if abs(ratio.value - 1) > 2 * ratio.error:
        result.remarks.append(
            f"{axis}: a step {back} is {ratio} of a step {there}: so the square stays open with any take-up"
        )
    return max(0, round(turn.lost.value * rig.step_us(axis)))


def _turn(log: Log, square: _Square, axis: str) -> _Turn | None:
    """Of an axis's two sides; None: too few steps behind the gap.

    Behind it, k steps back have made the way of m steps there: k = lost + m / ratio + a random walk of the steps'
    scatter, which begins at the corner. So the first and the last of them give the ratio, and the first one the loss.
    """
    first = 0 if axis == "x" else 1
    ways = np.column_stack([square.corners[1] - square.corners[0], square.corners[2] - square.corners[1]])
    along = np.linalg.inv(ways / np.linalg.norm(ways, axis=0))[first]
    there, back = (np.array(square.sides[k]) @ along for k in (first, first + 2))
    there = np.maximum.accumulate(there + (back[0] - there[-1]))  # what it drifted and crept between both is no way
    n = len(there) - 1
    at = np.arange(LEAD, 1 + int(np.max(np.nonzero(back >= there[0])[0])))
    if len(at) <= _LEAST:
        return None
    m = n - np.interp(back[at], there, np.arange(n + 1))
    count = len(at) - 1
    if m[-1] <= m[0]:
        return None
    per_step = count / float(m[-1] - m[0])
    lost = LEAD - per_step * float(m[0])
    scatter2 = _INTERPOLATED * float(np.sum((1 - per_step * np.diff(m)) ** 2)) / (count - 1)
    behind = max(0.0, LEAD - lost)
    reading2 = (log.error_px * n / float(there[-1] - there[0])) ** 2  # of one reading, in steps
    error = math.sqrt(scatter2 * (behind + behind**2 / count) + 4 * reading2) * student(count - 1)
    ratio_error = math.sqrt(scatter2 / count) / per_step * student(count - 1)
    return _Turn(Estimate(lost, error, "steps", count), Estimate(1 / per_step, ratio_error, "", count))


def _open(log: Log, square: _Square, scale: _Square) -> dict[str, Estimate]:
    """What is open along x and y, in px: to the right and up. scale: the square whose sides are the axes' ways."""
    ways = {"x": scale.corners[1] - scale.corners[0], "y": scale.corners[1] - scale.corners[2]}
    matrix = np.column_stack([way / np.linalg.norm(way) for way in ways.values()])
    inverse = np.linalg.inv(matrix)
    gap = inverse @ (square.corners[-1] - square.corners[0])
    error = log.error_between(square.times_s[-1] - square.times_s[0])
    return {
        axis: Estimate(float(gap[k]), error * float(np.linalg.norm(inverse[k])), "px") for k, axis in enumerate(ways)
    }
