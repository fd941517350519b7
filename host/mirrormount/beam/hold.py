"""Keeps the beam at its targets for as long as one likes. Imports guard, gates, summary.

Between two looks at rest PERIOD_S pass; after a pulse the loop looks at once. What it does about an error, and when it
does nothing, choosing.py decides.
"""

import threading
from collections.abc import Callable, Sequence

import numpy as np

from mirrormount.beam.choosing import Prices
from mirrormount.beam.events import (
    CORRECTING,
    CREEPING,
    ENDED,
    HOLDING,
    STOPPED,
    WAITING,
    Event,
    GateClosed,
    GateOpened,
    Listen,
    StateChanged,
    silent,
)
from mirrormount.beam.gap import Gap
from mirrormount.beam.gates import JUMPED, Closed
from mirrormount.beam.guard import Guard
from mirrormount.beam.looking import Vector
from mirrormount.beam.loop_table import LoopTable
from mirrormount.beam.response import Matrix, Response, check_belongs
from mirrormount.beam.summary import Summary
from mirrormount.common.errors import MountError

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
