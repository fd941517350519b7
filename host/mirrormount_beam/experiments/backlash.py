"""Backlash, and the shortest pulses.

Pulses: how far a pulse moves the spot, by its length; a motor that starts up covers less than in proportion.

Backlash: how many steps a reversal loses, at several positions of the travel and again and again. A leg goes so many
steps one way and the same back, and the spot is observed after each step. The last steps of a leg are behind the gap.
A screw that is not straight makes steps differ from position to position, also within a leg, so the step at a position
is taken from both directions: where one leg is in the gap, the leg back is behind it. One fit has, for an axis, the
number of steps N(p) to each position p as a polynomial, the ratio of the steps of both directions, and what each
direction loses.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mirrormount_beam.errors import NotMeasurable
from mirrormount_beam.estimates import Estimate, Result, Series, Tell, spread, student
from mirrormount_beam.experiments.rig import Rig, Vector
from mirrormount_beam.experiments.steps import Ended, Log, along, come_back, series

# ---- pulses

LENGTHS_MS = (1, 2, 3, 5, 8, 12, 20, 35, 60, 100)
COUNT = 8  # pulses of each length
_LEAD = 5  # steps before a run: through any backlash
_LEAST_US = 200  # of the board


def run_pulses(
    rig: Rig, result: Result, tell: Tell, lengths_ms: tuple[float, ...] = LENGTHS_MS, count: int = COUNT
) -> None:
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


# ---- backlash

PLACES = 3
REPEATS = 3
_THROUGH = 5  # steps, of which some are lost in the gap
_BEHIND = 6  # steps behind it, for the size of a step there
_SPACING = 4  # steps from place to place
_LEG = _THROUGH + _BEHIND
_DEGREE = 4  # of N(p): over less than half a turn of the screw
_ROUNDS = 6


@dataclass(frozen=True, slots=True)
class _Leg:
    """Its direction, its place, and where the spot was after each step, px along the axis's way."""

    way: int
    at: int
    places: NDArray[np.float64]


def run(rig: Rig, result: Result, tell: Tell, places: int = PLACES, repeats: int = REPEATS) -> None:
    """Fill the result. Raises NotMeasurable, SpotLost, CameraError, MountError."""
    log = Log(rig, result)
    for number, axis in enumerate(rig.axes):
        legs: list[tuple[int, int, list[Vector]]] = []
        home = log.observe()
        rig.step(axis, _LEG // 2 - _SPACING * (places // 2))
        for at in range(places):
            if at:
                rig.step(axis, _LEG + _SPACING)
            rig.step(axis, -_LEG)  # so that the first leg begins with a reversal
            for repeat in range(repeats):
                tell((number + (at + repeat / repeats) / places) / len(rig.axes), f"{axis}: reversals, place {at + 1}")
                for way in (1, -1):
                    legs.append((way, at, _leg(rig, log, axis, way)))
        come_back(rig, log, axis, home, (legs[0][2][-1] - legs[0][2][_THROUGH]) / _BEHIND)
        _add(result, axis, _on_a_line(legs), rig.step_us(axis))
    tell(1.0, "")


def _leg(rig: Rig, log: Log, axis: str, way: int) -> list[Vector]:
    """The readings of a leg."""
    places = series(rig, log, axis, _LEG, way)
    at, _ = along(places)
    if (at[-1] - at[_THROUGH]) / _BEHIND < 3 * log.error_px:
        raise NotMeasurable(f"{axis}: steps behind the gap did not move the spot: look at motor and coupler")
    return places


def _on_a_line(legs: list[tuple[int, int, list[Vector]]]) -> list[_Leg]:
    """The legs along the way of the first, which goes to positive."""
    _, unit = along(legs[0][2])
    return [_Leg(way, at, np.array(places) @ unit) for way, at, places in legs]


def _lost(legs: list[_Leg]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(steps lost in a turn to positive, to negative; those of each leg), by least squares (Gauss and Newton).

    Steps scatter, so the places are not exact: a regression of the exact number of steps on them is too flat, and
    what is lost too large. So the fit
    of the number of steps on the places gives the shape of N(p) only; scale and loss are a regression on the number of
    steps.
    """
    every = np.concatenate([leg.places for leg in legs])
    middle, half = (every.max() + every.min()) / 2, (every.max() - every.min()) / 2
    powers = np.arange(1, _DEGREE + 1)
    k = np.arange(_THROUGH, _LEG + 1, dtype=float)
    terms = []
    for leg in legs:
        p = ((leg.places - middle) / half)[:, None] ** powers
        terms.append(leg.way * (p[_THROUGH:] - p[0]))
    basis = np.concatenate(terms)
    back = np.repeat([leg.way < 0 for leg in legs], len(k))
    counts = np.tile(k, len(legs))
    ratio = 1.0  # a step to negative, of one to positive
    fitted = np.zeros(3 + _DEGREE)
    for _ in range(_ROUNDS):
        scale = np.where(back, 1 / ratio, 1.0)
        bend = np.where(back, -(basis @ fitted[3:]) / ratio**2, 0.0)
        design = np.column_stack([~back, back, bend, basis * scale[:, None]])
        fitted = np.asarray(np.linalg.lstsq(design, counts, rcond=None)[0], np.float64)
        ratio += float(np.clip(fitted[2], -0.5 * ratio, ratio))
    ways = basis @ fitted[3:]
    lost, each = np.zeros(2), np.zeros(len(counts))
    for side, leg in enumerate((~back, back)):
        slope, offset = np.polyfit(counts[leg], ways[leg], 1)
        lost[side] = -offset / slope
        each[leg] = counts[leg] - ways[leg] / slope
    return lost, each.reshape(len(legs), -1).mean(axis=1)


def _add(result: Result, axis: str, legs: list[_Leg], step_us: int) -> None:
    """Estimates of an axis; errors by the jackknife over pairs of legs, there and back.

    Source: B. Efron and C. Stein, Ann. Statist. 9 (1981) 586.
    """
    found, each = _lost(legs)
    if found.max() > _THROUGH - 0.5:
        raise NotMeasurable(f"{axis}: the backlash is larger than {_THROUGH} steps: make the step (pulse_us) longer")
    n = len(legs) // 2
    without = np.array([_lost(legs[: 2 * i] + legs[2 * i + 2 :])[0] for i in range(n)])
    errors = np.sqrt((n - 1) * without.var(axis=0)) * student(n - 1)
    both: list[Estimate] = []
    by_place: list[list[float]] = []
    for side, (way, name) in enumerate(((1, "positive"), (-1, "negative"))):
        some = [(leg.at, float(value)) for leg, value in zip(legs, each, strict=True) if leg.way == way]
        both.append(Estimate(float(found[side]), float(errors[side]), "steps", n))
        result.estimates[f"{axis}.to_{name}"] = both[-1]
        result.estimates[f"{axis}.to_{name}.repeatability"] = spread([value for _, value in some], "steps")
        points = [(float(at + 1), value, 0.0) for at, value in some]
        result.series.append(Series(f"{axis}: steps lost in a turn to {name}", "place", "steps", points, joined=False))
        places = sorted({at for at, _ in some})
        by_place.append([float(np.mean([value for at, value in some if at == place])) for place in places])
    # what one direction is found to lose too much the other one loses too little, so the mean has its own jackknife
    error = float(np.sqrt((n - 1) * without.mean(axis=1).var())) * student(n - 1)
    total = Estimate(float(found.mean()), error, "steps", 2 * n)
    result.estimates[f"{axis}.backlash"] = total
    result.estimates[f"{axis}.take_up"] = total.scaled(step_us, "us")
    if abs(both[0].value - both[1].value) > 2 * math.hypot(both[0].error, both[1].error):
        result.remarks.append(
            f"{axis}: the two directions lose {both[0]} and {both[1]}; the board has one take-up, for their mean"
        )
    result.remarks.append(
        f"{axis}: the means of the {len(by_place[0])} places lie within {np.ptp(by_place, axis=1).max():.2f} steps"
    )
