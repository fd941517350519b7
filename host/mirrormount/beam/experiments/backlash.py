"""How many steps a reversal loses, at several places of the travel and again and again.

A leg goes so many steps one way and the same back; each step is looked at. The last steps of a leg, which are behind
the gap, tell the size of a step there; the first ones tell what is missing.
"""

import numpy as np

from mirrormount.beam.estimate import Estimate, combined, mean, spread
from mirrormount.beam.experiments.stepping import Log, along, series
from mirrormount.beam.result import Result, Series, Tell
from mirrormount.beam.rig import Rig
from mirrormount.common.beam_errors import NotMeasurable

PLACES = 3
REPEATS = 3
_THROUGH = 5  # steps, of which some are lost in the gap
_BEHIND = 6  # steps behind it, for the size of a step there
_SPACING = 4  # steps from place to place
_LEG = _THROUGH + _BEHIND


def run(rig: Rig, result: Result, tell: Tell, places: int = PLACES, repeats: int = REPEATS) -> None:
    """Fill the result. The mount's take-up is to be off. Raises NotMeasurable, SpotLost, CameraError, MountError."""
    log = Log(rig, result)
    for number, axis in enumerate(rig.axes):
        lost: dict[int, list[list[float]]] = {1: [], -1: []}
        rig.step(axis, -_LEG // 2 - _SPACING * (places // 2))
        for at in range(places):
            if at:
                rig.step(axis, _SPACING)
            lost[1].append([])
            lost[-1].append([])
            rig.step(axis, -_LEG)  # so that the first leg begins with a reversal
            for repeat in range(repeats):
                tell((number + (at + repeat / repeats) / places) / len(rig.axes), f"{axis}: reversals, place {at + 1}")
                for way in (1, -1):
                    lost[way][at].append(_leg(rig, log, axis, way))
        rig.step(axis, _LEG // 2 - _SPACING * (places // 2))
        _add(result, axis, lost, rig.step_us(axis))
    tell(1.0, "")


def _leg(rig: Rig, log: Log, axis: str, way: int) -> float:
    """The steps that a reversal to direction `way` has lost."""
    at, _ = along(series(rig, log, axis, _LEG, way))
    step = (at[-1] - at[_THROUGH]) / _BEHIND
    if step < 3 * log.error_px:
        raise NotMeasurable(f"{axis}: steps behind the gap did not move the spot: look at motor and coupler")
    lost = _THROUGH - float(at[_THROUGH] - at[0]) / step
    if lost > _THROUGH - 0.5:
        raise NotMeasurable(f"{axis}: the backlash is larger than {_THROUGH} steps: make the step (pulse_us) longer")
    return lost


def _add(result: Result, axis: str, lost: dict[int, list[list[float]]], step_us: int) -> None:
    both: list[Estimate] = []
    for way, name in ((1, "positive"), (-1, "negative")):
        every = [value for at in lost[way] for value in at]
        both.append(mean(every, "steps"))
        result.estimates[f"{axis}.to_{name}"] = both[-1]
        result.estimates[f"{axis}.to_{name}.repeatability"] = spread(every, "steps")
        points = [(float(at), value, 0.0) for at, values in enumerate(lost[way], 1) for value in values]
        result.series.append(Series(f"{axis}: steps lost in a turn to {name}", "place", "steps", points, joined=False))
    total = combined(both) if abs(both[0].value - both[1].value) < 2 * sum(b.error for b in both) else _middle(both)
    result.estimates[f"{axis}.backlash"] = total
    result.estimates[f"{axis}.take_up"] = total.scaled(step_us, "us")
    by_place = np.array([[np.mean(values) for values in lost[way]] for way in (1, -1)])
    result.remarks.append(
        f"{axis}: the means of the {by_place.shape[1]} places lie within {np.ptp(by_place, axis=1).max():.2f} steps"
    )


def _middle(both: list[Estimate]) -> Estimate:
    """The mean of two values that differ: its error covers both."""
    return Estimate(
        (both[0].value + both[1].value) / 2,
        max(abs(both[0].value - both[1].value) / 4, both[0].error, both[1].error),
        "steps",
        both[0].count + both[1].count,
    )
