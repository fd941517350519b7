"""What a run comes to: the residuals as the cameras saw them, and what was done. Imports looking.

Means are those of over_time.py.

Brings the beam to its targets: corrections by the response until all spots are near enough. Imports guard.

Keeps the beam at its targets for as long as one likes. Imports guard, gates, summary.

Between two looks at rest PERIOD_S pass; after a pulse the loop looks at once. What it does about an error, and when it
does nothing, choosing.py decides.
"""

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mirrormount.beam.control.backlash import Gap
from mirrormount.beam.control.controller import QUICKLY, Prices
from mirrormount.beam.control.events import (
    ALIGNING,
    CORRECTING,
    CREEPING,
    ENDED,
    HOLDING,
    STOPPED,
    WAITING,
    Estimated,
    Event,
    GateClosed,
    GateOpened,
    Listen,
    StateChanged,
    silent,
)
from mirrormount.beam.control.interfaces import Eye, LoopTable
from mirrormount.beam.control.interlocks import JUMPED, NO_HELP, Closed, Guard
from mirrormount.beam.control.response import Matrix, Response, check_belongs
from mirrormount.beam.looking import Vector, angle_urad, in_pairs
from mirrormount.beam.over_time import OverTime
from mirrormount.common.errors import MountError


@dataclass
class Summary:
    """Of one run of a loop. Lengths in um on the cameras' planes, angles in urad of the beam."""

    eyes: Sequence[Eye]
    corrections: int = 0
    actions: int = 0
    reversals: int = 0
    motor_s: float = 0.0
    seconds: float = 0.0
    gates: list[GateClosed] = field(default_factory=list)
    reached: bool = False
    last_um: Vector | None = None
    max_um: float = 0.0
    held: OverTime = field(default_factory=OverTime)

    def add(self, time_s: float, errors_um: Vector) -> Estimated:
        """The errors from now on."""
        errors = {eye.name: pair for eye, pair in zip(self.eyes, in_pairs(errors_um), strict=True)}
        estimate = Estimated(time_s, errors, angle_urad(self.eyes, errors_um))
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
        angle = None if self.last_um is None else angle_urad(self.eyes, self.last_um)
        return None if angle is None else max(map(abs, angle))

    def to_json(self, *, final: bool) -> dict[str, Any]:
        """Plain data. final: what is left at the end (an alignment), else over time (a hold)."""
        residual = self.last_um if final else self.rms_um
        urad = self.last_urad if final else self.rms_urad
        rounded = None if urad is None else round(urad, 3)
        return {
            "reached": self.reached,
            "corrections": self.corrections,
            "residual_um": {} if residual is None else _by_camera(self.eyes, residual),
            "rms_urad": rounded,
            "max_um": round(
                float(np.max(np.abs(self.last_um))) if final and self.last_um is not None else self.max_um, 2
            ),
            "actions": self.actions,
            "reversals": self.reversals,
            "motor_s": round(self.motor_s, 3),
            "seconds": round(self.seconds, 3),
            "gates": [
                {"time_s": round(g.time_s, 3), "number": g.number, "name": g.name, "cause": g.cause} for g in self.gates
            ],
        }


def _by_camera(eyes: Sequence[Eye], errors_um: Vector) -> dict[str, dict[str, float]]:
    pairs = in_pairs(errors_um)
    return {eye.name: {"x": round(x, 2), "y": round(y, 2)} for eye, (x, y) in zip(eyes, pairs, strict=True)}


WITHIN_UM = 15.0  # on every camera, along x and y
MOST_CORRECTIONS = 10
_MOST_CREEPS = 80
_FRAMES = 6  # of a look that decides
# of WITHIN_UM, at which it ends, up to so many corrections; the rest is for the look's noise and the beam's tremble
_AIMS = ((8, 0.6), (math.inf, 0.85))
_HELPED = 0.5  # of the first error: what corrections by a true calibration leave at most
_ALIGN_PRICES, _AT_ANY_PRICE = Prices(pulse_um2=9.0, gap_um2=80.0), Prices(pulse_um2=0.0, gap_um2=0.0)


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

    A gate that closes ends it: it is in `gates`. Raises ResponseOfOther.
    """
    check_belongs(response, table)
    summary = Summary(table.eyes)

    def told(event: Event) -> None:
        if isinstance(event, GateClosed):
            summary.gates.append(event)
        listen(event)

    guard = Guard(table, response, gaps, told)
    guard.corrector.creep = QUICKLY
    begin_s = table.now_s()
    weight = np.eye(len(response.noise_um))
    told(StateChanged(begin_s, ALIGNING, f"until all spots are within {within_um:g} um of their targets"))
    why, begun_um = "", 0.0
    try:
        while True:
            look = guard.look(_FRAMES)
            summary.add(look.time_s, look.errors_um)
            begun_um = begun_um or look.worst_um
            if look.worst_um <= _aim(guard.corrector.number) * within_um or cancelled():
                break
            if guard.corrector.number >= most or guard.corrector.creeps > _MOST_CREEPS:
                why = f"{guard.corrector.number} corrections were not enough"
                if guard.corrector.number >= MOST_CORRECTIONS and look.worst_um > _HELPED * begun_um:
                    raise Closed(NO_HELP, f"{why}: of {begun_um:.0f} um, {look.worst_um:.0f} um are left")
                break
            prices = _ALIGN_PRICES
            choice = guard.choose(prices, weight)
            if not choice and look.worst_um > within_um:
                prices = _AT_ANY_PRICE
                choice = guard.choose(prices, weight)
            if not choice:
                break
            guard.correct(choice, prices, weight, frames=2)
        summary.reached = summary.last_um is not None and float(np.max(np.abs(summary.last_um))) <= within_um
    except Closed as closed:
        told(closed.event(table.now_s()))
        told(StateChanged(table.now_s(), STOPPED, closed.detail))
        why = closed.detail
    finally:
        guard.motors_off()
        summary.corrections = guard.corrector.number
        summary.actions, summary.reversals = guard.mover.actions, guard.mover.reversals
        summary.motor_s, summary.seconds = guard.mover.motor_s, table.now_s() - begin_s
    told(StateChanged(table.now_s(), ENDED, why))
    return summary


def _aim(corrections: int) -> float:
    """What is near enough after so many: between two corrections the laser drifts, so more of them need not help."""
    return next(aim for most, aim in _AIMS if corrections < most)


PERIOD_S = 0.4  # between two looks at rest
RMS_URAD, MOST_UM = 9.0, 80.0  # the goal: rms of the beam's angle; no error beyond, on any camera
_PRICES = Prices(pulse_um2=50.0, gap_um2=150.0)
_PLACE_WEIGHT = 0.5  # of the square of each camera's error ...
_ANGLE_WEIGHT = 3.0  # ... beside that of the cameras' difference: a place that is kept costs reversals
_MOST_STEPS = 8.0  # of an axis: what is further off is no drift and no bump
_FIRST_FRAMES = 4  # of the first look, and of one after a gate
_RETRY_S = 0.5  # between two looks while a gate is closed
_BACK_UM = 300.0  # how far from where it was a spot may come back ...
_BACK_SIGMAS = 5.0  # ... beside its drift meanwhile


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
        rms_urad: float = RMS_URAD,
        most_um: float = MOST_UM,
    ) -> None:
        check_belongs(response, table)
        self.table, self.response = table, response
        self.summary = Summary(table.eyes)
        self.guard = Guard(table, response, gaps, self._tell)
        self.period_s, self.rms_urad, self.most_um = period_s, rms_urad, most_um
        self._listen = listen
        self._ending = threading.Event()
        self._going_on = threading.Event()
        self._state = ("", "")
        self._weight = angle_weight(len(table.eyes))

    def stop(self) -> None:
        """End the loop soon; motors are off then."""
        self._ending.set()

    def go_on(self) -> None:
        """A person tells a loop that stands still to go on."""
        self._going_on.set()

    def run(self, seconds: float | None = None, ended: Callable[[], bool] = lambda: False) -> Summary:
        """Hold for so long (None: until stop()). Motors are off at the end, however it comes.

        With a time, a gate that only a person opens ends the loop: it is in the summary.
        """
        begin_s = self.table.now_s()
        end_s = None if seconds is None else begin_s + seconds
        self._state_is(HOLDING, "looks first; nothing was moved yet")
        try:
            frames = _FIRST_FRAMES
            while not self._over(end_s) and not ended():
                try:
                    self._cycle(frames)
                    frames = 1
                except Closed as closed:
                    self.summary.pause()
                    self._tell(closed.event(self.table.now_s()))
                    if not self._wait(closed, end_s, seconds is not None):
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
        """A look, the corrections that follow from it, and the wait for the next look."""
        begin_s = self.table.now_s()
        self.guard.look(frames)
        self._add()
        choice = self.guard.choose(_PRICES, self._weight)
        while choice and not self._ending.is_set():
            self.guard.check_reach(_MOST_STEPS)
            outcome = self.guard.correct(choice, _PRICES, self._weight, frames=1)
            if any(each.in_gap for each in outcome.driven):
                self._state_is(CREEPING, "a reversal: until the cameras see the spot move")
            else:
                self._state_is(CORRECTING, "")
            self._add()
            choice = self.guard.choose(_PRICES, self._weight)
            if self.table.now_s() - begin_s > 10 * self.period_s:
                break  # a look at rest now and then, which also asks whether the loop is to end
        if not choice:
            sigma = float(np.max(self.guard.tracker.sigma_um))
            self._state_is(HOLDING, f"a correction would cost more than it saves (places are known to {sigma:.0f} um)")
        self.table.sleep(max(0.0, self.period_s - (self.table.now_s() - begin_s)))

    def _add(self) -> None:
        self._tell(self.summary.add(self.table.now_s(), self.guard.tracker.mean))

    def _wait(self, closed: Closed, end_s: float | None, timed: bool) -> bool:
        """A gate is closed. True: it has opened, by itself or by go_on(); False: the loop ends."""
        self._going_on.clear()
        was = self.guard.tracker.mean.copy() if self.guard.tracker.seen else None  # then it is where it was found
        since_s = self.table.now_s()
        opens = closed.gate.opens_itself
        self._state_is(WAITING if opens else STOPPED, closed.detail)
        while not self._over(end_s):
            if self._going_on.is_set():
                self._going_on.clear()
                if self._take_control() and self._sees():
                    break
            elif opens:
                if self._sees():
                    if was is None or self._is_back(was, since_s):
                        break
                    opens = False
                    closed = Closed(JUMPED, f"the spot is back, {self._off_mm(was):.2f} mm from where it was")
                    self._tell(closed.event(self.table.now_s()))
                    self._state_is(STOPPED, closed.detail)
            elif timed:
                return False
            self.table.sleep(_RETRY_S)
        else:
            return False
        self.guard.start_anew(moved_by_others=not closed.gate.opens_itself)
        self._tell(GateOpened(self.table.now_s(), closed.gate.number, closed.gate.name))
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
        look = self.guard.looker.look(2)
        if not look:
            return False
        self.guard.tracker.lose()
        self.guard.corrector.see(look, 2)
        return True

    def _is_back(self, was: Vector, since_s: float) -> bool:
        """True if the spots are where they were, but for their drift."""
        drift = float(np.max(np.diag(self.guard.tracker.drift))) * (self.table.now_s() - since_s)
        return self._off_mm(was) * 1000 <= _BACK_UM + _BACK_SIGMAS * drift**0.5

    def _off_mm(self, was: Vector) -> float:
        return float(np.max(np.abs(self.guard.tracker.mean - was))) / 1000

    def _finish(self, begin_s: float) -> None:
        summary, mover = self.summary, self.guard.mover
        summary.corrections = self.guard.corrector.number
        summary.actions, summary.reversals, summary.motor_s = mover.actions, mover.reversals, mover.motor_s
        summary.seconds = self.table.now_s() - begin_s
        rms = summary.rms_urad
        closed = bool(summary.gates) and self._state[0] in (WAITING, STOPPED)
        summary.reached = (
            not closed
            and summary.last_um is not None
            and summary.max_um <= self.most_um
            and (rms is None or rms <= self.rms_urad)
        )

    def _tell(self, event: Event) -> None:
        if isinstance(event, GateClosed):
            self.summary.gates.append(event)
        self._listen(event)

    def _state_is(self, state: str, why: str) -> None:
        if self._state[0] != state or (state in (WAITING, STOPPED) and self._state[1] != why):
            self._state = state, why
            self._tell(StateChanged(self.table.now_s(), state, why))
