"""Moves the spot to a position in the picture: learns what a step of each axis does, then observes and moves.

Every move is bounded, and the spot is observed after each. Pulses are not linear in their length, and a screw's tip
sticks and slips, so a move that does little is followed by a longer one, up to a bound. A reversal has to cross the
backlash, whose width the first crossing tells. An axis that is near enough is left alone, for its next slip may be
longer than what is left.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mirrormount_beam.errors import NotMeasurable
from mirrormount_beam.observe import Sighting

LEARN_STEPS = 2  # So many steps of each axis are measured, after those that take up the backlash.
GAP_STEPS = 6  # The spot must be seen to move after at most so many steps of an axis.
CORRECTIONS = 40  # One move of the spot takes at most so many corrections.
WITHIN_PX = 0.5  # The spot has arrived if it is no farther from the target.
_MOST_STEPS = 4.0  # One correction moves an axis by no more steps.
_GAIN = 0.8  # A correction goes this part of the way: the response is known to some per cent.
# A correction after one without effect is twice as long, up to a bound: it may go too far by so much. The bound is
# large until the backlash is known: it is one and a half steps wide on the paper's mount.
_CREEP_UNKNOWN, _CREEP = 0.8, 0.1
_OF_GAP = 0.6  # One correction crosses this part of what is left of the backlash, when the backlash is known.
_ALONE = 0.5  # An axis stays as it is while it is off by less than this part of WITHIN_PX.
_LEAST_US, _MOST_US = 500, 2_000_000  # A shorter pulse moves no motor, and the board refuses a longer one.
_NO_EFFECT = 0.3  # If a smaller part of a correction is seen, the correction was lost in the backlash.
_WORSE = 3  # Give up after so many corrections in a row that end farther from the target.
_ANGLE = 0.2  # The sine of the angle between the ways of both axes in the picture, at least.
_SURE = 6.0  # The spot has moved if it moved by so many standard errors.
_FRAMES = 3  # Images of one observation.


class Hands(Protocol):
    """What moves the mount and observes the spot. Moves return when the motors are at rest."""

    def step(self, axis: str, n: int) -> None: ...

    def pulse(self, axis: str, us: int) -> None: ...

    def observe(self, frames: int) -> Sighting: ...

    def step_us(self, axis: str) -> int:
        """The length of one step's pulse."""
        ...


Say = Callable[[str], object]


@dataclass(frozen=True)
class Learned:
    """How far one step moves the spot, in px (right, down): columns of `px` are the axes."""

    axes: tuple[str, str]
    px: tuple[tuple[float, float], tuple[float, float]]

    def steps(self, right: float, down: float) -> tuple[float, float]:
        """The steps of each axis for a shift of the spot."""
        first, second = np.linalg.solve(np.array(self.px), [right, down])
        return float(first), float(second)


@dataclass(frozen=True)
class Arrival:
    """The end of a move of the spot: where it is, and how far from the target."""

    sighting: Sighting
    off_px: float
    corrections: int

    @property
    def reached(self) -> bool:
        """True if the spot is where it should be."""
        return self.off_px <= WITHIN_PX


def learn(hands: Hands, axes: tuple[str, str], say: Say) -> Learned:
    """Move each axis by 3 to 8 steps, and see what they do. Raises NotMeasurable, SpotLost, CameraError."""
    columns = [_learn_axis(hands, axis, say) for axis in axes]
    (a, b), (c, d) = columns
    if abs(a * d - b * c) < _ANGLE * math.hypot(a, b) * math.hypot(c, d):
        raise NotMeasurable(f"{axes[0]} and {axes[1]} move the spot along the same line: is one of them not connected?")
    return Learned(axes, ((a, c), (b, d)))


def _learn_axis(hands: Hands, axis: str, say: Say) -> tuple[float, float]:
    start = hands.observe(_FRAMES)
    for count in range(1, GAP_STEPS + 1):
        say(f"step {count} of {axis}: until the spot moves")
        hands.step(axis, 1)
        seen = hands.observe(_FRAMES)
        if _apart(start, seen) > _SURE * _error(start, seen):
            break
    else:
        raise NotMeasurable(f"{GAP_STEPS} steps of {axis} did not move the spot: is its motor connected, is it seen?")
    say(f"{LEARN_STEPS} steps of {axis}: to measure them")
    hands.step(axis, LEARN_STEPS)
    end = hands.observe(_FRAMES)
    if _apart(seen, end) <= _SURE * _error(seen, end):
        raise NotMeasurable(f"{LEARN_STEPS} steps of {axis} did not move the spot, and the one before did")
    return (end.x - seen.x) / LEARN_STEPS, (end.y - seen.y) / LEARN_STEPS


def approach(hands: Hands, learned: Learned, target: tuple[float, float], say: Say) -> Arrival:
    """Move the spot to a place in the picture (x, y), px. Raises NotMeasurable, SpotLost, CameraError."""
    ways_px = (math.hypot(*column) for column in zip(*learned.px, strict=True))
    drives = [_Drive(hands, axis, _ALONE * WITHIN_PX / px) for axis, px in zip(learned.axes, ways_px, strict=True)]
    seen, worse = hands.observe(_FRAMES), 0
    for count in range(CORRECTIONS):
        right, down = target[0] - seen.x, target[1] - seen.y
        off_px = math.hypot(right, down)
        if off_px <= WITHIN_PX:
            return Arrival(seen, off_px, count)
        say(f"correction {count + 1}: {off_px:.1f} px to go")
        for drive, wanted in zip(drives, learned.steps(right, down), strict=True):
            drive.correct(wanted)
        before, seen = seen, hands.observe(_FRAMES)
        for drive, moved in zip(drives, learned.steps(seen.x - before.x, seen.y - before.y), strict=True):
            drive.see(moved)
        now_px = math.hypot(target[0] - seen.x, target[1] - seen.y)
        worse = worse + 1 if now_px > off_px + _SURE * _error(before, seen) else 0
        if worse >= _WORSE:
            raise NotMeasurable("the spot moves away from its target: something has changed; learn again")
    return Arrival(seen, math.hypot(target[0] - seen.x, target[1] - seen.y), CORRECTIONS)


class _Drive:
    """Corrections of one axis, in steps. It learns its backlash when it crosses it. near: a smaller error stays."""

    def __init__(self, hands: Hands, axis: str, near: float) -> None:
        self._hands = hands
        self._axis = axis
        self._near = near
        self._asked = 0.0  # the last correction
        self._is_lost = False  # it had no effect
        self._crosses = False  # the backlash, since the last reversal
        self._crossed = 0.0  # so much of it
        self._gap = 0.0  # its width; 0: not known
        self._gives = False  # a pulse, in this correction

    def correct(self, wanted: float) -> None:
        """Give one pulse towards a place so many steps away."""
        self._gives = abs(wanted) >= self._near
        if not self._gives:
            return
        steps = min(_MOST_STEPS, _GAIN * abs(wanted))
        if wanted * self._asked < 0:  # too far, or another target
            self._crosses, self._crossed, self._is_lost = True, 0.0, False
        creep = _CREEP if self._gap else _CREEP_UNKNOWN
        left = _OF_GAP * (self._gap - self._crossed) if self._crosses else 0.0
        if left > max(steps, creep):
            steps = left
        elif self._is_lost:
            steps = max(steps, min(creep, 2 * abs(self._asked)))
        us = round(steps * self._hands.step_us(self._axis))
        if us >= _LEAST_US:
            self._asked = math.copysign(steps, wanted)
            self._hands.pulse(self._axis, round(math.copysign(min(_MOST_US, us), wanted)))

    def see(self, moved: float) -> None:
        """How far it has moved since, as the camera says."""
        if not self._gives:
            return
        asked = abs(self._asked)
        self._is_lost = abs(moved) < _NO_EFFECT * asked
        if self._crosses and self._is_lost:
            self._crossed += asked
        elif self._crosses:
            self._crosses = False
            self._gap = min(self._crossed + max(0.0, asked - abs(moved)), _MOST_STEPS)


def _apart(a: Sighting, b: Sighting) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)


def _error(a: Sighting, b: Sighting) -> float:
    return math.sqrt(a.error_x**2 + a.error_y**2 + b.error_x**2 + b.error_y**2)
