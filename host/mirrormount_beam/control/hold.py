"""Aligns the beam, and keeps it at its targets for as long as one likes; and what a run comes to.

Between two observations at rest PERIOD_S pass; after a pulse the loop observes at once. What it does about an error,
and when it does nothing, plan_correction() of controller.py decides.
"""

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from mirrormount.errors import MountError
from mirrormount.markup import html_table
from mirrormount_beam.control.backlash import Gap
from mirrormount_beam.control.controller import QUICKLY, Prices
from mirrormount_beam.control.events import (
    ALIGNING,
    CORRECTING,
    CREEPING,
    ENDED,
    HOLDING,
    STOPPED,
    WAITING,
    Estimated,
    Event,
    InterlockCleared,
    InterlockTripped,
    Listen,
    StateChanged,
    silent,
)
from mirrormount_beam.control.interfaces import LoopTable
from mirrormount_beam.control.interlocks import JUMPED, NO_HELP, WORSE, Guard, Tripped
from mirrormount_beam.control.response import Matrix, Response, Vector, check_belongs
from mirrormount_beam.observe import angle_urad, in_pairs
from mirrormount_beam.runlog import ErrorStatistics, LatestErrors, Rms

if TYPE_CHECKING:
    from mirrormount_beam.table import TargetCamera

WITHIN_UM = 15.0  # The goal of an alignment: along x and y on every camera.
MOST_CORRECTIONS = 30  # Screws that stick and slip need up to 20.
_MOST_CREEPS = 160
_DECIDING_FRAMES = 6  # Images of the observations by which an alignment decides.
# of WITHIN_UM, at which it ends, up to so many corrections; the rest is for noise and the beam's tremble
_AIMS = ((15, 0.6), (math.inf, 0.85))
# So many corrections by a true calibration leave at most this part of the first error, if that is not so small (of
# WITHIN_UM) that one slip of a screw is as large.
_JUDGED_CORRECTIONS, _HELPED, _LARGE = 10, 0.5, 20.0
_ALIGN_PRICES, _AT_ANY_PRICE = Prices(pulse_um2=9.0, gap_um2=80.0), Prices(pulse_um2=0.0, gap_um2=0.0, scatter=0.0)
PERIOD_S = 0.4  # The time between two observations at rest.
MOST_UM = 120.0  # The goal of a hold: the largest error on any camera, and the rms of the beam's angle,
RMS_URAD = 9.0  # which is this where no calibration has promised another one.
_TRUE_TIMES = 1.5  # A promise is true to this factor: so much more than it is the goal.
_HOLD_PRICES = Prices(pulse_um2=50.0, gap_um2=150.0)
_PLACE_WEIGHT = 0.5  # The weight of the square of each camera's error.
# The weight of the square of the cameras' difference. It is larger, because to keep the position costs more
# reversals.
_ANGLE_WEIGHT = 3.0
_MOST_STEPS = 8.0  # A hold corrects no error that takes more steps of an axis: neither a drift nor a bump is so large.
_FIRST_FRAMES = 4  # Images of the first observation, and of one after an interlock.
_RETRY_S = 0.5  # The time between two observations while an interlock is tripped.
_BACK_UM = 300.0  # A spot that comes back may be so far from where it was ...
# So many minutes are compared with the promise, and may be so many times as bad.
_JUDGED_MINUTES, _WORSE_TIMES = 10, 2.0
_BACK_SIGMAS = 5.0  # ... and so many standard deviations of its drift meanwhile.


# ---- the summary of a run


@dataclass
class Summary:
    """Of one run of a loop. Lengths in um on the cameras' planes, angles in urad of the beam.

    promise: what the calibration says that this table holds.
    """

    cameras: "Sequence[TargetCamera]"
    promise: Rms | None = None
    corrections: int = 0
    actions: int = 0
    reversals: int = 0
    motor_s: float = 0.0
    seconds: float = 0.0
    interlocks: list[InterlockTripped] = field(default_factory=list)
    reached: bool = False
    last_um: Vector | None = None
    max_um: float = 0.0
    held: ErrorStatistics = field(default_factory=ErrorStatistics)

    def add(self, time_s: float, errors_um: Vector) -> Estimated:
        """The errors from now on."""
        errors = {camera.name: pair for camera, pair in zip(self.cameras, in_pairs(errors_um), strict=True)}
        estimate = Estimated(time_s, errors, angle_urad(self.cameras, errors_um))
        self.held.take(estimate)
        self.last_um = errors_um.copy()
        self.max_um = max(self.max_um, float(np.max(np.abs(errors_um))))
        return estimate

    def pause(self) -> None:
        """Nothing is known of the spots until the next add()."""
        self.held.pause()

    @property
    def rms_um(self) -> Vector | None:
        """Root mean square of each error over time; the last errors of a run too short for that."""
        rms = [um for sums in self.held.errors_um.values() for um in sums.rms]
        return np.array(rms) if np.isfinite(rms).all() and rms else self.last_um

    @property
    def rms_urad(self) -> float | None:
        """Root mean square of the beam's angle, of x or y, whichever is larger; None where no distance is known."""
        worst = max(self.held.angle_urad.rms)
        return self.last_urad if math.isnan(worst) else worst

    @property
    def last_urad(self) -> float | None:
        """The beam's angle at the end, of x or y, whichever is larger; None where no distance is known."""
        angle = None if self.last_um is None else angle_urad(self.cameras, self.last_um)
        return None if angle is None else max(map(abs, angle))

    def _repr_html_(self) -> str:
        at_end = {} if self.last_um is None else _by_camera(self.cameras, self.last_um)
        rows: list[tuple[object, object]] = [("goal", "reached" if self.reached else "NOT reached")]
        rows += [(f"{camera}, at the end, um", f"{um['x']:+.1f}, {um['y']:+.1f}") for camera, um in at_end.items()]
        if self.rms_urad is not None:
            rows.append(("rms of the beam's angle over time, urad", f"{self.rms_urad:.1f}"))
        rows += [("largest error over time, um", f"{self.max_um:.1f}"), ("corrections", self.corrections)]
        rows += [("pulses, reversals", f"{self.actions}, {self.reversals}"), ("seconds", f"{self.seconds:.0f}")]
        rows += [(f"interlock {each.number}, {each.name}", f"{each.cause}; {each.remedy}") for each in self.interlocks]
        return html_table(("loop", ""), rows)

    def to_json(self, *, final: bool) -> dict[str, Any]:
        """Plain data. final: what is left at the end (an alignment), else over time (a hold)."""
        residual = self.last_um if final else self.rms_um
        urad = self.last_urad if final else self.rms_urad
        rounded = None if urad is None else round(urad, 3)
        return {
            "reached": self.reached,
            "corrections": self.corrections,
            "residual_um": {} if residual is None else _by_camera(self.cameras, residual),
            "rms_urad": rounded,
            "promised_urad": self.promise and self.promise.urad and round(self.promise.urad, 3),
            "max_um": round(
                float(np.max(np.abs(self.last_um))) if final and self.last_um is not None else self.max_um, 2
            ),
            "actions": self.actions,
            "reversals": self.reversals,
            "motor_s": round(self.motor_s, 3),
            "seconds": round(self.seconds, 3),
            "interlocks": [
                {"time_s": round(trip.time_s, 3), "number": trip.number, "name": trip.name, "cause": trip.cause}
                for trip in self.interlocks
            ],
        }


def _in_words(rms: Rms) -> str:
    return f"{rms.um:.0f} um rms" if rms.urad is None else f"{rms.urad:.1f} urad rms"


def _by_camera(cameras: "Sequence[TargetCamera]", errors_um: Vector) -> dict[str, dict[str, float]]:
    pairs = in_pairs(errors_um)
    return {camera.name: {"x": round(x, 2), "y": round(y, 2)} for camera, (x, y) in zip(cameras, pairs, strict=True)}


# ---- align


def align(
    table: LoopTable,
    response: Response,
    gaps: Sequence[Gap] | None = None,
    listen: Listen = silent,
    *,
    within_um: float = WITHIN_UM,
    most: int = MOST_CORRECTIONS,
    cancelled: Callable[[], bool] = lambda: False,
) -> Summary:
    """Align. Motors are off at the end. reached of what is returned tells whether the goal was met.

    An interlock that trips ends it: it is in `interlocks`. Raises ResponseOfOther.
    """
    check_belongs(response, table)
    summary = Summary(table.cameras)

    def told(event: Event) -> None:
        if isinstance(event, InterlockTripped):
            summary.interlocks.append(event)
        listen(event)

    guard = Guard(table, response, gaps, told)
    guard.controller.creep = QUICKLY
    begin_s = table.now_s()
    weight = np.eye(len(response.noise_um))
    told(StateChanged(begin_s, ALIGNING, f"until all spots are within {within_um:g} um of their targets"))
    why, begun_um = "", 0.0
    try:
        while True:
            seen = guard.observe(_DECIDING_FRAMES)
            summary.add(seen.time_s, seen.errors_um)
            begun_um = begun_um or seen.worst_um
            if seen.worst_um <= _aim(guard.controller.number) * within_um or cancelled():
                break
            number = guard.controller.number
            if number >= most or guard.controller.creeps > _MOST_CREEPS:
                why = f"{number} corrections were not enough"
                unhelped_um = _HELPED * max(begun_um, _LARGE * within_um)
                if number >= _JUDGED_CORRECTIONS and seen.worst_um > unhelped_um:
                    raise Tripped(NO_HELP, f"{why}: of {begun_um:.0f} um, {seen.worst_um:.0f} um are left")
                break
            prices = _ALIGN_PRICES
            plan = guard.controller.plan(prices, weight)
            if not plan:
                prices = _AT_ANY_PRICE
                plan = guard.controller.plan(prices, weight)
            if not plan:
                break
            guard.correct(plan, prices, weight, frames=2)
        summary.reached = summary.last_um is not None and float(np.max(np.abs(summary.last_um))) <= within_um
    except Tripped as tripped:
        told(tripped.event(table.now_s()))
        told(StateChanged(table.now_s(), STOPPED, tripped.detail))
        why = tripped.detail
    finally:
        guard.motors_off()
        mover = guard.controller.mover
        summary.corrections = guard.controller.number
        summary.actions, summary.reversals = mover.actions, mover.reversals
        summary.motor_s, summary.seconds = mover.motor_s, table.now_s() - begin_s
    told(StateChanged(table.now_s(), ENDED, why))
    return summary


def _aim(corrections: int) -> float:
    """What is near enough after so many: between two corrections the laser drifts, so more of them need not help."""
    return next(aim for most, aim in _AIMS if corrections < most)


# ---- hold


def angle_weight(cameras: int) -> Matrix:
    """The weight of the squares: each error, and with two cameras their difference, which is the beam's angle."""
    weight = np.eye(2 * cameras)
    if cameras > 1:
        weight *= _PLACE_WEIGHT
        for axis in (0, 1):
            v = np.zeros(2 * cameras)
            v[axis], v[2 * (cameras - 1) + axis] = -1.0, 1.0
            weight += _ANGLE_WEIGHT * np.outer(v, v)
    return weight


class Hold:
    """The loop. run() in one thread; stop() and go_on() from any.

    response: each correction refines it; whoever keeps it saves it after run(). Raises ResponseOfOther.
    """

    def __init__(
        self,
        table: LoopTable,
        response: Response,
        gaps: Sequence[Gap] | None = None,
        listen: Listen = silent,
        *,
        period_s: float = PERIOD_S,
        rms_urad: float | None = None,
        most_um: float = MOST_UM,
    ) -> None:
        check_belongs(response, table)
        self.table, self.response = table, response
        self.summary = Summary(table.cameras, response.promise)
        self._latest = LatestErrors(_JUDGED_MINUTES)
        self.guard = Guard(table, response, gaps, self._tell)
        promised = response.promise and response.promise.urad
        self.rms_urad = rms_urad or (_TRUE_TIMES * promised if promised else RMS_URAD)
        self.period_s, self.most_um = period_s, most_um
        self._listen = listen
        self._ending = threading.Event()
        self._going_on = threading.Event()
        self._state = ("", "")
        self._weight = angle_weight(len(table.cameras))

    def stop(self) -> None:
        """End the loop soon; motors are off then."""
        self._ending.set()

    def go_on(self) -> None:
        """A person tells a loop that stands still to go on."""
        self._going_on.set()

    def run(self, seconds: float | None = None, ended: Callable[[], bool] = lambda: False) -> Summary:
        """Hold for so long (None: until stop()). Motors are off at the end, however it comes.

        With a time, an interlock that only a person clears ends the loop: it is in the summary.
        """
        begin_s = self.table.now_s()
        end_s = None if seconds is None else begin_s + seconds
        self._state_is(HOLDING, "observes first; nothing was moved yet")
        try:
            frames = _FIRST_FRAMES
            while not self._over(end_s) and not ended():
                try:
                    self._cycle(frames)
                    frames = 1
                except Tripped as tripped:
                    self.summary.pause()
                    self._latest.pause()
                    self._tell(tripped.event(self.table.now_s()))
                    if not self._wait(tripped, end_s, seconds is not None):
                        break
                    frames = _FIRST_FRAMES
        finally:
            try:
                self.guard.motors_off()
            finally:
                self._finish(begin_s)
        self._state_is(ENDED, "")
        return self.summary

    def _over(self, end_s: float | None) -> bool:
        return self._ending.is_set() or (end_s is not None and self.table.now_s() >= end_s)

    def _cycle(self, frames: int) -> None:
        """An observation, the corrections that follow from it, and the wait for the next observation."""
        begin_s = self.table.now_s()
        self.guard.observe(frames)
        self._add()
        plan = self.guard.controller.plan(_HOLD_PRICES, self._weight)
        while plan and not self._ending.is_set():
            self.guard.check_reach(_MOST_STEPS)
            outcome = self.guard.correct(plan, _HOLD_PRICES, self._weight, frames=1)
            if any(each.in_gap for each in outcome.drives):
                self._state_is(CREEPING, "a reversal: until the cameras see the spot move")
            else:
                self._state_is(CORRECTING, "")
            self._add()
            plan = self.guard.controller.plan(_HOLD_PRICES, self._weight)
            if self.table.now_s() - begin_s > 10 * self.period_s:
                break  # an observation at rest now and then, which also asks whether the loop is to end
        if not plan:
            sigma = float(np.max(self.guard.tracker.sigma_um))
            self._state_is(HOLDING, f"a correction would cost more than it saves (places are known to {sigma:.0f} um)")
        self.table.sleep(max(0.0, self.period_s - (self.table.now_s() - begin_s)))

    def _add(self) -> None:
        estimate = self.summary.add(self.table.now_s(), self.guard.tracker.mean)
        self._latest.take(estimate)
        self._tell(estimate)
        rms, promise = self._latest.rms, self.response.promise
        if rms and promise and rms.times(promise) > _WORSE_TIMES:
            self._latest = LatestErrors(_JUDGED_MINUTES)
            self.guard.trip(
                Tripped(WORSE, f"in {_JUDGED_MINUTES} minutes {_in_words(rms)}; promised were {_in_words(promise)}")
            )

    def _wait(self, tripped: Tripped, end_s: float | None, timed: bool) -> bool:
        """An interlock has tripped. True: it is cleared, by itself or by go_on(); False: the loop ends."""
        self._going_on.clear()
        was = self.guard.tracker.mean.copy() if self.guard.tracker.seen else None  # then it is where it was found
        since_s = self.table.now_s()
        clears = tripped.interlock.clears_itself
        self._state_is(WAITING if clears else STOPPED, tripped.detail)
        while not self._over(end_s):
            if self._going_on.is_set():
                self._going_on.clear()
                if self._take_control() and self._sees():
                    break
            elif clears:
                if self._sees():
                    if was is None or self._is_back(was, since_s):
                        break
                    clears = False
                    tripped = Tripped(JUMPED, f"the spot is back, {self._off_mm(was):.2f} mm from where it was")
                    self._tell(tripped.event(self.table.now_s()))
                    self._state_is(STOPPED, tripped.detail)
            elif timed:
                return False
            self.table.sleep(_RETRY_S)
        else:
            return False
        self.guard.start_anew(moved_by_others=not tripped.interlock.clears_itself)
        self._tell(InterlockCleared(self.table.now_s(), tripped.interlock.number, tripped.interlock.name))
        return True

    def _take_control(self) -> bool:
        try:
            self.table.take_control()
            check_belongs(self.response, self.table)  # another board may have been plugged in
        except MountError as e:
            self._state_is(STOPPED, str(e))
            return False
        return True

    def _sees(self) -> bool:
        """True if all spots are seen; the tracker knows their places then."""
        if self.table.taken_over:
            return False
        return bool(self.guard.controller.observe(2, anew=True))

    def _is_back(self, was: Vector, since_s: float) -> bool:
        """True if the spots are where they were, but for their drift."""
        drift = float(np.max(np.diag(self.guard.tracker.drift))) * (self.table.now_s() - since_s)
        return self._off_mm(was) * 1000 <= _BACK_UM + _BACK_SIGMAS * drift**0.5

    def _off_mm(self, was: Vector) -> float:
        return float(np.max(np.abs(self.guard.tracker.mean - was))) / 1000

    def _finish(self, begin_s: float) -> None:
        summary, mover = self.summary, self.guard.controller.mover
        summary.corrections = self.guard.controller.number
        summary.actions, summary.reversals, summary.motor_s = mover.actions, mover.reversals, mover.motor_s
        summary.seconds = self.table.now_s() - begin_s
        rms = summary.rms_urad
        tripped = bool(summary.interlocks) and self._state[0] in (WAITING, STOPPED)
        summary.reached = (
            not tripped
            and summary.last_um is not None
            and summary.max_um <= self.most_um
            and (rms is None or rms <= self.rms_urad)
        )

    def _tell(self, event: Event) -> None:
        if isinstance(event, InterlockTripped):
            self.summary.interlocks.append(event)
        self._listen(event)

    def _state_is(self, state: str, why: str) -> None:
        if self._state[0] != state or (state in (WAITING, STOPPED) and self._state[1] != why):
            self._state = state, why
            self._tell(StateChanged(self.table.now_s(), state, why))
