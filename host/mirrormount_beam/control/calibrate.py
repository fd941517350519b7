"""Measures the response of a table: each actuator both ways by whole steps, its gap, and the curve of short pulses.

By sight: a run begins when the spot has begun to move, and turns back before the spot leaves a picture.
"""

import datetime
import math
from collections.abc import Mapping

import numpy as np

from mirrormount_beam.control.backlash import Gap, Width
from mirrormount_beam.control.controller import Mover, SpotLostMoving
from mirrormount_beam.control.events import CALIBRATING, Listen, Progress, StateChanged, silent
from mirrormount_beam.control.interfaces import LoopTable
from mirrormount_beam.control.promise import promise_of
from mirrormount_beam.control.response import WAYS, Curve, Matrix, Response, Vector, belongs_to
from mirrormount_beam.errors import NotControllable, SpotLost
from mirrormount_beam.observe import Observation, Observer
from mirrormount_beam.spot.find import NoSpotReason

FRAMES = 2  # Images of an observation between two steps.
# So long the spots are observed at rest; images that are so far apart tell the drift.
_AT_REST_S, _DRIFT_S = 10.0, 0.5
_LEAST_DRIFT_UM2_S = 0.5
# lengths of pulses in parts of a step, and how many of each: the sum is some steps
_CURVE = ((0.025, 10), (0.04, 8), (0.065, 6), (0.12, 5), (0.25, 3), (0.5, 2))
RUN = 6  # So many steps measure one column of the response.
LEAD = 5  # The spot must have begun to move after so many steps.
_REVERSALS = 3  # So many reversals of each direction measure the gaps.
_EDGE_PX = 40.0  # The spot stays so far from the picture's edges.
_ALONG_PX = 3.0  # A spot that comes nearer to an edge by less than this goes along it.
_AT_EDGE = (NoSpotReason.EDGE, NoSpotReason.REGION, NoSpotReason.MASK, NoSpotReason.NOTHING)
_STEP_SCATTER = 0.03  # The least scatter of a pulse, relative to its way: a few pulses may happen to be alike.
_MOVED = 0.15  # The screw follows if the spot moves by this part of a step's way.
_ROOM_UM = 2000.0  # Larger errors are made smaller before the calibration: the spot needs room.
# This part of such an error is corrected at a time, and at most so often: few steps were measured by then.
_CENTRED, _CENTRINGS = 0.8, 4
_UNITS = 0.7, 1.3  # A step may have become shorter or longer by these factors since the response was measured.
# The scatter of a gap, relative to its width: before reversals have shown it, and the least one afterwards.
_GAP_SPREAD, _LEAST_SPREAD = 0.03, 0.01


class AtEdge(Exception):
    """The spot has left a picture, or nearly. Never leaves a calibration."""


def check_controllable(table: LoopTable) -> None:
    """Raises NotControllable if these cameras cannot tell what these actuators do."""
    actuators, seen = len(table.actuators), 2 * len(table.cameras)
    if actuators > seen:
        raise NotControllable(
            f"{actuators} axes move the beam in {actuators} ways, and {len(table.cameras)} camera sees {seen} of them:"
            " add a camera at another distance, or give one mount"
        )
    if actuators < seen:
        raise NotControllable(
            f"{actuators} axes cannot keep {len(table.cameras)} spots at their targets: give one camera, or two mounts"
        )


class Calibration:
    """One run of the measurement. gaps: where the shafts are in their gaps at its end."""

    def __init__(self, table: LoopTable, listen: Listen = silent) -> None:
        check_controllable(table)
        self.table = table
        self.observer = Observer(table, listen)
        self.mover = Mover(table, self.observer, listen)
        self.gaps: list[Gap] = []
        self._listen = listen
        self._steps: list[dict[int, list[Vector]]] = []
        self._widths: list[dict[int, list[tuple[int, Vector]]]] = []
        self._way = [0] * len(table.actuators)
        self._out = 0

    def run(self) -> Response:
        """Measure. Motors are off at the end, however it comes.

        Raises NotControllable, SpotLost (with the reason), and as Actuator does.
        """
        self._listen(StateChanged(self.table.now_s(), CALIBRATING, "each axis both ways, then short pulses"))
        try:
            return self._run()
        except SpotLostMoving as e:
            raise SpotLost("the spot was lost during a motion; the motors were stopped") from e
        finally:
            self.table.stop()

    def _run(self) -> Response:
        n = len(self.table.actuators)
        noise, drift, frame_s = self._at_rest()
        for i in range(n):
            self._tell(0.05 + 0.5 * i / n, f"{self.table.actuators[i].name}: steps")
            self._measure_steps(i)
        matrices, errors = self._matrices()
        self._check_rank(matrices)
        widths = [self._width_of(i, matrices) for i in range(n)]
        self._centre(matrices, widths)
        self._tell(0.55, "gaps")
        self._measure_gaps(matrices, widths)
        self.gaps = [Gap(each) for each in widths]
        for gap, way in zip(self.gaps, self._way, strict=True):
            gap.followed(way)
        curve = self._curve(matrices, noise)
        self._tell(1.0, "what this table will hold")
        response = Response(
            matrices,
            errors,
            curve,
            widths,
            noise,
            drift,
            belongs_to(self.table),
            datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        )
        response.promise = promise_of(response, self.table.cameras, frame_s)
        return response

    def _tell(self, done: float, what: str) -> None:
        """How far it is."""
        self._listen(Progress(self.table.now_s(), done, what))

    def _observe(self, frames: int = FRAMES) -> Observation:
        """All spots. Raises AtEdge, SpotLost."""
        seen = self.observer.observe(frames)
        if not seen:
            fault = seen.faults[0]
            if fault.kind == "spot" and fault.reason in _AT_EDGE:
                raise AtEdge(str(fault))
            raise SpotLost(str(fault))
        return seen

    def _seen(self, frames: int = FRAMES) -> Observation:
        """All spots, where they have no reason to be at an edge. Raises SpotLost."""
        try:
            return self._observe(frames)
        except AtEdge as e:
            raise SpotLost(str(e)) from None

    def _at_rest(self) -> tuple[Matrix, Matrix, float]:
        """The covariance of an image's errors, that of the drift (um² a second), and the time between two images.

        By differences of successive images, where what drifts falls out, and of images that are further apart.
        """
        self._tell(0.0, "noise and drift of the spots")
        seen = [self._seen(1)]
        while seen[-1].time_s < seen[0].time_s + _AT_REST_S:
            seen.append(self._seen(1))
        places = np.array([each.errors_um for each in seen])
        frame_s = (seen[-1].time_s - seen[0].time_s) / (len(seen) - 1)
        apart = max(2, round(_DRIFT_S / frame_s))
        at_once, later = (d.T @ d / len(d) for d in (places[n:] - places[:-n] for n in (1, apart)))
        noise = at_once / 2 + np.diag(np.full(len(at_once), 0.3**2))
        return noise, _isotropic((later - at_once) / ((apart - 1) * frame_s)), frame_s

    # ---- whole steps

    def _measure_steps(self, i: int) -> None:
        """Runs in both ways; the first one again if the picture's edge cut it short, and back if it went out."""
        self._out = 0  # the way in which the spot has left a picture: there a single image may show it again
        self._steps.append({1: [], -1: []})
        self._widths.append({1: [], -1: []})
        for way in (1, -1, 1, -1):
            if len(self._steps[i][way]) < RUN // 2 or self._out == -way:
                self._run_steps(i, way)
        if any(len(self._steps[i][way]) < 1 for way in WAYS):
            raise NotControllable(f"{self.table.actuators[i].name}: the spot leaves the picture at the first step")

    def _run_steps(self, i: int, way: int) -> None:
        """By single steps: through the gap, then RUN steps. Ends early at the edge."""
        try:
            before = self._observe()
        except AtEdge:
            before = None
        moved = np.zeros(2 * len(self.table.cameras))
        for lead in range(1, LEAD + 1):
            after = self._step(i, way)
            if after is None:
                if before is None or self._out == -way:
                    before = None
                    continue  # it is outside, and this may be the way back
                self._way[i] = self._out = way  # it went out, so it moved: the other way leads back
                return
            if before is None:
                before = after
                break
            moved = after.errors_um - before.errors_um
            if float(np.linalg.norm(moved)) > self._moved_um(i):
                if self._way[i] == -way:
                    self._widths[i][way].append((lead, moved))
                before = after
                break
            before = after
        else:
            if before is None:
                raise SpotLost(f"{self.table.actuators[i].name}: the spot left the picture and did not come back")
            raise NotControllable(
                f"{self.table.actuators[i].name}: {LEAD} steps did not move the spot: look at motor, supply and coupler"
            )
        self._way[i], self._out = way, 0
        step = moved
        while len(self._steps[i][way]) < RUN:
            if self._near_edge(before, step):
                return
            after = self._step(i, way)
            if after is None:
                self._out = way
                return
            step = after.errors_um - before.errors_um
            self._steps[i][way].append(step)
            before = after

    def _step(self, i: int, way: int) -> Observation | None:
        """One step and an observation; None if the spot is not seen then."""
        try:
            self.mover.measure({i: way})
        except SpotLostMoving:
            return None
        try:
            return self._observe()
        except AtEdge:
            return None

    def _moved_um(self, i: int) -> float:
        """A change of the errors that is a motion."""
        known = [step for way in WAYS for step in self._steps[i][way]]
        size = float(np.mean([np.linalg.norm(step) for step in known])) if known else 0.0
        return max(60.0, _MOVED * size)

    def _near_edge(self, seen: Observation, step: Vector) -> bool:
        """True if another such step would bring a spot nearer to an edge than it may."""
        now, then = self._margins_px(seen.errors_um), self._margins_px(seen.errors_um + step)
        return any(after < min(_EDGE_PX, before - _ALONG_PX) for before, after in zip(now, then, strict=True))

    def _margins_px(self, errors_um: Vector) -> list[float]:
        """For each picture, the distance of a spot with these errors from the nearest edge."""
        margins = []
        for camera, (right, up) in zip(self.table.cameras, errors_um.reshape(-1, 2), strict=True):
            x, y = camera.target_px[0] + right / camera.um_per_px[0], camera.target_px[1] - up / camera.um_per_px[1]
            margins.append(min(x, camera.size.width - 1 - x, y, camera.size.height - 1 - y))
        return margins

    def _matrices(self) -> tuple[dict[int, Matrix], dict[int, Matrix]]:
        matrices, errors = {}, {}
        for way in WAYS:
            columns, sigmas = [], []
            for each in self._steps:
                steps = np.array(each[way]) * way
                columns.append(steps.mean(axis=0))
                n = len(steps)
                scatter = steps.std(axis=0, ddof=1) if n > 1 else np.abs(steps[0]) * 0.1
                sigmas.append(scatter / math.sqrt(n))
            matrices[way], errors[way] = np.array(columns).T, np.array(sigmas).T
        return matrices, errors

    def _check_rank(self, matrices: Mapping[int, Matrix]) -> None:
        """Raises NotControllable if two actuators do the same."""
        for way in WAYS:
            s = np.linalg.svd(matrices[way], compute_uv=False)
            if s[-1] < 0.01 * s[0]:
                raise NotControllable(
                    "two axes move all spots alike: the cameras stand at nearly the same distance, or one mount is"
                    " wired twice"
                )

    def _width_of(self, i: int, matrices: Mapping[int, Matrix]) -> dict[int, Width]:
        """The gap's width by the reversals between the runs: steps less those that the screw followed."""
        found: dict[int, Width] = {}
        for way in WAYS:
            column = matrices[way][:, i] * way
            samples = [
                lead - min(1.0, float(moved @ column / (column @ column))) for lead, moved in self._widths[i][way]
            ]
            if samples:
                mean = float(np.mean(samples))
                found[way] = Width(mean, max(_GAP_SPREAD * mean, 0.02), len(samples))
        if not found:
            found[1] = Width(LEAD / 2, LEAD / 4, 0)
        for way in WAYS:
            other = found.get(-way)
            if way not in found and other is not None:  # the same turn of the shaft, in the steps of this way
                sizes = {w: float(np.linalg.norm(matrices[w][:, i])) for w in WAYS}
                ratio = sizes[-way] / sizes[way]
                found[way] = Width(ratio * other.mean, 1.5 * ratio * other.spread, 0)
        return found

    def _measure_gaps(self, matrices: Mapping[int, Matrix], widths: list[dict[int, Width]]) -> None:
        """Reversals of both axes of a mount at once, each by a step more than the gap; the widths learn from them.

        One step more shows how far a step moves the spots here: a screw's pitch is not even along its turn.
        """
        n = len(self.table.actuators)
        gaps: dict[tuple[int, int], Vector] = {}
        for first in range(0, n, 2):
            pair = [i for i in (first, first + 1) if i < n]
            moved: dict[tuple[int, int], list[tuple[int, float, float]]] = {}
            for _ in range(2 * _REVERSALS):
                before = self._seen()
                steps = {i: -self._way[i] * round(widths[i][-self._way[i]].mean + 1.0) for i in pair}
                self.mover.measure(steps)
                after = self._seen()
                columns = np.array([matrices[-self._way[i]][:, i] * -self._way[i] for i in pair]).T
                self.mover.measure({i: -self._way[i] for i in pair})
                changes = after.errors_um - before.errors_um, self._seen().errors_um - after.errors_um
                ways, *_ = np.linalg.lstsq(columns, np.array(changes).T, rcond=None)
                for i, (way, unit) in zip(pair, ways, strict=True):
                    self._way[i] = -self._way[i]
                    moved.setdefault((i, self._way[i]), []).append((abs(steps[i]), float(way), float(unit)))
            for key, found in moved.items():
                driven, way, unit = np.array(found).T
                gaps[key] = driven - way / np.clip(unit.mean(), *_UNITS)
        parts = np.concatenate([(found - found.mean()) / found.mean() for found in gaps.values()])
        free = len(parts) - len(gaps)  # all gaps together: three samples of one say little of its spread
        spread = max(math.sqrt(float(parts @ parts) / free), _LEAST_SPREAD)
        for (i, way), found in gaps.items():
            mean = float(found.mean())
            widths[i][way] = Width(mean, spread * mean, len(found))

    def _centre(self, matrices: Mapping[int, Matrix], widths: list[dict[int, Width]]) -> None:
        """Bring far spots towards the targets, so that what comes has room in the pictures."""
        for _ in range(_CENTRINGS):
            seen = self._seen()
            if seen.worst_um < _ROOM_UM:
                return
            steps = np.linalg.lstsq(matrices[1], -_CENTRED * seen.errors_um, rcond=None)[0]
            whole = {i: round(float(step)) for i, step in enumerate(steps) if abs(step) >= 1}
            for i, n in whole.items():
                way = 1 if n > 0 else -1
                if way != self._way[i]:
                    whole[i] += way * round(widths[i][way].mean + 0.5)
                    self._way[i] = way
            self.mover.measure(whole)

    # ---- short pulses

    def _curve(self, matrices: Mapping[int, Matrix], noise: Matrix) -> Curve:
        """Pulses of each length on both axes of a mount at once, in the ways of their last contact."""
        n = len(self.table.actuators)
        ways: list[list[Vector]] = [[] for _ in _CURVE]  # for each length and actuator, those of its pulses
        unsure: list[list[float]] = [[] for _ in _CURVE]  # the variance of one way by the images' noise
        for first in range(0, n, 2):
            pair = [i for i in (first, first + 1) if i < n]
            inverse = np.linalg.pinv(np.array([matrices[self._way[i]][:, i] * self._way[i] for i in pair]).T)
            by_noise = np.diag(inverse @ (2 * noise / FRAMES) @ inverse.T)
            for k, (part, count) in enumerate(_CURVE):
                done = 0.65 + 0.35 * (first + 2 * k / len(_CURVE)) / n
                self._tell(done, f"pulses of {part:g} of a step")
                ways[k] += list(inverse @ self._pulses(pair, part, count).T)
                unsure[k] += list(by_noise)
        step_us = float(np.mean([actuator.step_us for actuator in self.table.actuators]))
        us = [part * step_us for part, _ in _CURVE]
        means = np.array([[each.mean() for each in found] for found in ways])
        variances = [
            float(np.mean([each.var(ddof=1) for each in found])) - float(np.mean(by_noise))
            for found, by_noise in zip(ways, unsure, strict=True)
        ]
        errors = means.std(axis=1, ddof=1) / math.sqrt(n) if n > 1 else np.full(len(us), math.nan)
        return _monotone(us, list(means.mean(axis=1)), [*variances, self._step_variance()], list(errors), step_us)

    def _pulses(self, pair: list[int], part: float, count: int) -> Matrix:
        """What each of so many pulses of all actuators of the pair changes the errors by, (count, errors), um."""
        places = [self._seen(FRAMES).errors_um]
        for _ in range(count):
            self.mover.measure_pulses({i: self._way[i] * round(self.table.actuators[i].step_us * part) for i in pair})
            places.append(self._seen(FRAMES).errors_um)
        return np.diff(np.array(places), axis=0)

    def _step_variance(self) -> float:
        """Of the way of a step, in squares of steps: of all actuators and ways together."""
        squares = free = 0.0
        for each in self._steps:
            for way in WAYS:
                steps = np.array(each[way])
                column = steps.mean(axis=0)
                off = steps @ column / float(column @ column) - 1
                squares, free = squares + float(off @ off), free + len(steps) - 1
        return squares / free if free else _STEP_SCATTER**2


def _isotropic(covariance: Matrix) -> Matrix:
    """A covariance of all errors that is the same along x and y: ten seconds tell little of each. Positive definite."""
    cameras = (covariance[0::2, 0::2] + covariance[1::2, 1::2]) / 2
    values, vectors = np.linalg.eigh(cameras)
    return np.asarray(
        np.kron((vectors * np.maximum(values, _LEAST_DRIFT_UM2_S)) @ vectors.T, np.eye(2)), dtype=np.float64
    )


def _monotone(
    us: list[float], steps: list[float], variances: list[float], errors: list[float], step_us: float
) -> Curve:
    """A rising curve that ends in a step: a way that is not above noise or the one before is put between its next."""
    us, steps, errors = [*us, step_us], [*steps, 1.0], [*errors, 0.0]
    for k in range(len(us) - 2, -1, -1):
        # A motor that spins up covers less than in proportion; one that coasts, more.
        least, most = (steps[k + 1] * (us[k] / us[k + 1]) ** power for power in (3.0, 0.5))
        steps[k] = min(max(steps[k], least), most)
    scatter = [max(math.sqrt(max(v, 0.0)), _STEP_SCATTER * way) for v, way in zip(variances, steps, strict=True)]
    return Curve(tuple(us), tuple(steps), tuple(scatter), tuple(errors))
