"""Which pulse makes a step of a wanted size: pulses of other lengths between steps, after the experiment `steps`.

A pulse and the step beside it are at nearly the same place of the screw, so their ratio does not have its periodic
error; their order changes from pair to pair. A motor that starts up covers less than in proportion, so a first length
is tried and corrected, until the size is met.
"""

import math
from collections.abc import Mapping

import numpy as np

from mirrormount.beam.estimate import Estimate, student
from mirrormount.beam.experiments.stepping import LEAD, Log, along
from mirrormount.beam.result import Result, Series, Tell
from mirrormount.beam.rig import Rig
from mirrormount.common.beam_errors import NotMeasurable

PAIRS = 16  # in each direction
LEAST_US, MOST_US = 200, 2_000_000  # of a pulse
WAYS = ((1, "positive"), (-1, "negative"))
_LEAST_PAIRS = 4
_TRIALS = 4
_SURE = 3.0  # standard errors
_NEAR = 0.03  # of the wanted size: from here on the curve is taken as straight


def run(rig: Rig, result: Result, tell: Tell, wanted_px: Mapping[str, float]) -> None:
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
