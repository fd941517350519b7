"""Looks and short pulses of a calibration: what is at a picture's edge, the noise, and the curve of short pulses."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mirrormount.beam.events import Listen, Progress
from mirrormount.beam.looking import Fault, Look, Looker
from mirrormount.beam.loop_table import LoopTable
from mirrormount.beam.mover import Mover
from mirrormount.beam.response import Curve, Matrix
from mirrormount.common.beam_errors import SpotLost

FRAMES = 2  # of a look between steps
_QUIET = 24  # looks at rest, for the noise
# lengths of pulses in parts of a step, and how many of each: the sum is some steps
_CURVE = ((0.025, 10), (0.04, 8), (0.065, 6), (0.12, 5), (0.25, 3), (0.5, 2))


class AtEdge(Exception):
    """The spot has left a picture, or nearly. Never leaves a calibration."""


class Measuring:
    """Looks at a table and moves it, for a calibration."""

    def __init__(self, table: LoopTable, listen: Listen) -> None:
        self.table, self.listen = table, listen
        self.looker = Looker(table, listen)
        self.mover = Mover(table, self.looker, listen)

    def tell(self, done: float, what: str) -> None:
        """How far it is."""
        self.listen(Progress(self.table.now_s(), done, what))

    def look(self, frames: int = FRAMES) -> Look:
        """All spots. Raises AtEdge, SpotLost."""
        look = self.looker.look(frames)
        if not look:
            _give_up(look.faults[0])
        return look

    def seen(self, frames: int = FRAMES) -> Look:
        """A look where the spots have no reason to be at an edge. Raises SpotLost."""
        try:
            return self.look(frames)
        except AtEdge as e:
            raise SpotLost(str(e)) from None

    def noise(self) -> Matrix:
        """The covariance of a frame's errors, by differences of successive frames: what drifts falls out."""
        self.tell(0.0, "noise of the spots")
        places = np.array([self.seen(1).errors_um for _ in range(_QUIET)])
        d = np.diff(places, axis=0)
        own = np.diag(np.full(d.shape[1], 0.3**2))
        return d.T @ d / (2 * len(d)) + own


def _give_up(fault: Fault) -> None:
    if fault.kind == "spot" and fault.reason is not None and fault.reason.name in ("EDGE", "NOTHING"):
        raise AtEdge(fault.text)
    raise SpotLost(fault.text)


def measure_curve(eyes: Measuring, ways: Sequence[int], matrices: Mapping[int, Matrix]) -> Curve:
    """Pulses of each length on both axes of a mount at once, in the ways of their last contact."""
    n = len(eyes.table.actuators)
    shares: list[list[float]] = [[] for _ in _CURVE]
    for first in range(0, n, 2):
        pair = [i for i in (first, first + 1) if i < n]
        for k, (part, count) in enumerate(_CURVE):
            done = 0.65 + 0.35 * (first + 2 * k / len(_CURVE)) / n
            eyes.tell(done, f"pulses of {part:g} of a step")
            shares[k] += _pulses(eyes, ways, pair, part, count, matrices)
    us = [part * float(np.mean([a.step_us for a in eyes.table.actuators])) for part, _ in _CURVE]
    steps = [float(np.mean(each)) for each in shares]
    errors = [float(np.std(each, ddof=1)) / math.sqrt(len(each)) if len(each) > 1 else math.nan for each in shares]
    return _monotone(us, steps, errors, float(np.mean([a.step_us for a in eyes.table.actuators])))


def _pulses(
    eyes: Measuring, ways: Sequence[int], pair: list[int], part: float, count: int, matrices: Mapping[int, Matrix]
) -> list[float]:
    """The mean way of a pulse of each actuator of the pair, in steps."""
    before = eyes.seen(2 * FRAMES)
    for _ in range(count):
        eyes.mover.measure_pulses({i: ways[i] * round(eyes.table.actuators[i].step_us * part) for i in pair})
    after = eyes.seen(2 * FRAMES)
    columns = np.array([matrices[ways[i]][:, i] * ways[i] for i in pair]).T
    driven, *_ = np.linalg.lstsq(columns, after.errors_um - before.errors_um, rcond=None)
    return [float(way) / count for way in driven]


def _monotone(us: list[float], steps: list[float], errors: list[float], step_us: float) -> Curve:
    """A rising curve that ends in a step: a way that is not above noise or the one before is put between its next."""
    us, steps, errors = [*us, step_us], [*steps, 1.0], [*errors, 0.0]
    for k in range(len(us) - 2, -1, -1):
        most = steps[k + 1] * 0.95 * us[k] / us[k + 1]  # a motor that spins up covers less than in proportion
        least = steps[k + 1] * (us[k] / us[k + 1]) ** 3
        steps[k] = min(max(steps[k], least), most)
    return Curve(tuple(us), tuple(steps), tuple(errors))
