"""Interlocks: what makes the loop switch all motors off. Each is declared once; docs/hold.md has the table of them.

Guard observes and corrects for a loop, and trips an interlock when anything is wrong.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from mirrormount.errors import MountError, NotInControl
from mirrormount_beam.control.backlash import Gap
from mirrormount_beam.control.controller import Controller, Outcome, Plan, Prices, SpotLostMoving, needed_steps
from mirrormount_beam.control.events import InterlockTripped, Listen, silent
from mirrormount_beam.control.interfaces import LoopTable
from mirrormount_beam.control.kalman import Tracker
from mirrormount_beam.control.response import Matrix, Response, Vector
from mirrormount_beam.observe import Fault, Observation
from mirrormount_beam.spot.find import NoSpotReason


@dataclass(frozen=True, slots=True)
class Interlock:
    """cause, remedy: in words. clears_itself: the loop goes on when the cause has gone and the spot is where it was."""

    number: int
    name: str
    cause: str
    remedy: str
    clears_itself: bool


NO_SPOT = Interlock(
    1,
    "no spot",
    "two frames in a row of a camera show no spot, or five none that is clear",
    "look for something in the beam, or switch on the laser; a lost beam is found by `mirrormount scan find`",
    True,
)
UNCLEAR = Interlock(
    2,
    "spot not clear",
    "the spot is saturated, or a second one is nearly as bright",
    "a shorter exposure, or cover the reflection",
    True,
)
JUMPED = Interlock(
    3,
    "spot jumped",
    "the spot is further off than one correction brings it, or is not back where it was when it was lost",
    "look at what was moved; then tell the loop to go on, or align anew",
    False,
)
NO_HELP = Interlock(
    4,
    "corrections do not help",
    "three corrections in a row made the error larger, or did not do what the calibration says",
    "calibrate anew: a camera was turned, mounts or wires were exchanged, or the supply has changed",
    False,
)
STUCK = Interlock(
    5,
    "axis does not move",
    "an axis was driven beyond its gap and the spot did not move: it is at its end, or motor or coupler is loose",
    "turn the screw back by hand to the middle of its way and align anew; look at the coupler",
    False,
)
CAMERA_GONE = Interlock(
    6, "camera gone", "a camera was unplugged or delivers no frames", "plug it in; the loop tries every second", True
)
CAMERA_REPEATS = Interlock(
    7,
    "camera repeats",
    "a camera returns one and the same picture",
    "unplug the camera and plug it in; end programs that show its picture",
    True,
)
TOO_OLD = Interlock(
    8,
    "frames too old",
    "a camera's frames are older than the loop may use",
    "end what keeps the computer busy; a shorter exposure",
    True,
)
BOARD = Interlock(
    9,
    "board",
    "a board refused a pulse, ended it early, or does not answer",
    "what the line says (docs/errors.md); then tell the loop to go on",
    False,
)
CONTROL = Interlock(
    10,
    "somebody took over",
    "a person took control of a mount, or pressed STOP",
    "when the person has finished, tell the loop to go on",
    False,
)
WORSE = Interlock(
    11,
    "holds worse than it promised",
    "the rms of ten minutes is more than twice what the calibration promised",
    "look at couplers, screws and the supply; calibrate anew, which tells what the table holds now",
    False,
)
INTERLOCKS = (NO_SPOT, UNCLEAR, JUMPED, NO_HELP, STUCK, CAMERA_GONE, CAMERA_REPEATS, TOO_OLD, BOARD, CONTROL, WORSE)

_OF_FAULTS = {"gone": CAMERA_GONE, "repeats": CAMERA_REPEATS, "old": TOO_OLD}
BAD = 3  # Stop all motors after so many corrections in a row that did not help.
# After so many corrections and pulses of creeps, an error beyond _FAR_UM must have become smaller by the factor
# _NEARER.
TRIES = 80
_FAR_UM, _NEARER = 120.0, 0.7  # Only an error beyond _FAR_UM is checked in this way.
_HELPED = 0.2  # A correction helped if the error became smaller by at least this part of what was expected.
_TOLD_SIGMAS = 4.0  # A change of the error counts if it is larger than so many standard deviations of the noise.
# An error has grown if it is larger by _GREW_PART of itself, or by _WRONG_PART of the correction if that is less.
_GREW_PART, _WRONG_PART = 0.2, 0.3
# A gap may make the error larger by so much, and by this part of the size of the correction.
_THROWN_UM, _THROWN_PART = 300.0, 0.3
# A saved calibration may move a spot by so much on any camera, until an actuator has shown that it is still true.
_TRIAL_UM = 500.0
# An actuator has shown it with a motion of at least _SHOWN_UM whose error is at most _SHOWN_PART of the motion.
_SHOWN_UM, _SHOWN_PART = 100.0, 0.25


class Tripped(Exception):
    """An interlock has tripped. detail: what was seen. Never leaves the loop."""

    def __init__(self, interlock: Interlock, detail: str) -> None:
        super().__init__(detail)
        self.interlock = interlock
        self.detail = detail

    def event(self, time_s: float) -> InterlockTripped:
        """What is told of it."""
        lock = self.interlock
        return InterlockTripped(time_s, lock.number, lock.name, self.detail, lock.remedy, lock.clears_itself)


def of_fault(fault: Fault) -> Tripped:
    """The interlock that a camera's fault trips."""
    if fault.kind == "spot":
        unclear = fault.reason in (NoSpotReason.SATURATED, NoSpotReason.SPLIT)
        return Tripped(UNCLEAR if unclear else NO_SPOT, str(fault))
    return Tripped(_OF_FAULTS[fault.kind], str(fault))


class Guard:
    """One table with its response. gaps: where the shafts are, if that is known: then the response was just measured.

    Otherwise corrections are small until each actuator has done what the response says: cables, mounts or cameras may
    have been exchanged since. All motors are off before any Tripped is raised.
    """

    def __init__(
        self, table: LoopTable, response: Response, gaps: Sequence[Gap] | None = None, listen: Listen = silent
    ) -> None:
        self.table, self.response = table, response
        self._proven = [gaps is not None] * response.actuators
        gaps = [Gap(widths) for widths in response.widths] if gaps is None else gaps
        self.controller = Controller(table, response, gaps, listen, self._on_trial)
        self._bad = self._tries = 0
        self._far = math.inf
        self._tripped = False

    @property
    def tracker(self) -> Tracker:
        """Where the spots are."""
        return self.controller.tracker

    def observe(self, frames: int) -> Observation:
        """All spots, at rest. Raises Tripped."""
        self._check_control()
        seen = self.controller.observe(frames)
        if not seen:
            self.trip(of_fault(seen.faults[0]))
        return seen

    def check_reach(self, most_steps: float) -> None:
        """Raises Tripped if an axis would have to move by more."""
        steps = needed_steps(self.tracker.mean, self.response)
        if float(np.max(np.abs(steps))) > most_steps:
            um = float(np.max(np.abs(self.tracker.mean)))
            self.trip(Tripped(JUMPED, f"the spot is {um / 1000:.2f} mm off: more than {most_steps:g} steps of an axis"))

    def correct(self, plan: Plan, prices: Prices, weight: Matrix, frames: int) -> Outcome:
        """Give the pulses of a plan, observe, learn. Raises Tripped."""
        self._check_control()
        before = self.tracker.mean.copy()
        try:
            outcome = self.controller.correct(plan, prices, weight, frames)
        except SpotLostMoving:
            self.trip(Tripped(NO_SPOT, "the spot was lost during a motion"))
        except MountError as e:
            interlock = CONTROL if isinstance(e, NotInControl) else BOARD
            self.trip(self._out_of_control() or Tripped(interlock, str(e)))
        if outcome.fault:
            self.trip(of_fault(outcome.fault))
        if outcome.stuck:
            names = ", ".join(self.table.actuators[i].name for i in outcome.stuck)
            self.trip(Tripped(STUCK, f"{names}: the motor turned, and the spot did not move"))
        self._prove(outcome)
        self._judge(outcome, before)
        return outcome

    def start_anew(self, *, moved_by_others: bool) -> None:
        """After an interlock: no correction counts as bad any more. moved_by_others: nothing is known of the shafts."""
        self._bad = self._tries = 0
        self._far = math.inf
        self._tripped = False
        if moved_by_others:
            self._proven = [False] * len(self._proven)
            for gap in self.controller.gaps:
                gap.forget()

    def motors_off(self) -> None:
        """At the end. Raises MountError if a board does not confirm it, unless a tripped interlock has said why."""
        try:
            self.table.stop()
        except MountError:
            if not self._tripped:
                raise

    def _on_trial(self, steps: Vector) -> Vector:
        """The steps, all made smaller if one that has not shown yet what it does would move a spot far."""
        effects = [self._effect_um(i, float(steps[i])) for i, proven in enumerate(self._proven) if not proven]
        largest = max((float(np.max(np.abs(each))) for each in effects), default=0.0)
        return steps * (_TRIAL_UM / largest) if largest > _TRIAL_UM else steps

    def _prove(self, outcome: Outcome) -> None:
        """Actuators that were in contact and moved the spots as expected are trusted from now on."""
        wrong = float(np.linalg.norm(outcome.changed_um - outcome.expected_um))
        for each in outcome.drives:
            size = float(np.linalg.norm(self._effect_um(each.i, each.way * each.expected)))
            if size > _SHOWN_UM and wrong < _SHOWN_PART * size:
                self._proven[each.i] = True

    def _effect_um(self, actuator: int, steps: float) -> Vector:
        return self.response.column(actuator, 1 if steps > 0 else -1) * steps

    def _judge(self, outcome: Outcome, before: Vector) -> None:
        """Three corrections that do not do what was expected, or after which the error is larger, are the last.

        After one that made it larger by more than gaps explain, the next ones are small.
        """
        wished = outcome.planned_um
        noise = _TOLD_SIGMAS * math.sqrt(float(np.trace(self.response.noise_um + self.tracker.covariance)))
        expected = float(np.linalg.norm(outcome.expected_um))
        size, after = float(np.linalg.norm(before)), float(np.linalg.norm(before + outcome.changed_um))
        helped = outcome.helped
        grew = after > size + max(noise, min(_GREW_PART * size, _WRONG_PART * wished))
        if (helped is not None and expected > noise and helped < _HELPED) or grew:
            self._bad += 1
        elif after < size + noise or (helped is not None and expected > noise):
            self._bad = 0
        if after > size + _THROWN_UM + _THROWN_PART * wished:  # by a bump, or by what the response does not say
            self._proven = [False] * len(self._proven)
        if after < max(_FAR_UM, _NEARER * self._far):
            self._far, self._tries = after, 0
        self._tries += 1
        if self._tries >= TRIES:
            self.trip(Tripped(NO_HELP, f"{TRIES} pulses, and the error of {after:.0f} um did not become smaller"))
        if self._bad >= BAD:
            self.trip(Tripped(NO_HELP, f"{BAD} corrections in a row: the error went from {size:.0f} to {after:.0f} um"))

    def _check_control(self) -> None:
        if tripped := self._out_of_control():
            self.trip(tripped)

    def _out_of_control(self) -> Tripped | None:
        """Why the loop has no control any more. A board that went ends control, too: nobody took it then."""
        if lost := self.table.lost_board:
            return Tripped(BOARD, lost)
        taken = self.table.taken_over
        return Tripped(CONTROL, taken) if taken else None

    def trip(self, tripped: Tripped) -> NoReturn:
        """All motors off, and raise it; a board that has gone is off by its keep-alive."""
        self._tripped = True
        try:
            self.table.stop()
        except MountError as e:
            if str(e) not in tripped.detail:
                tripped = Tripped(tripped.interlock, f"{tripped.detail} ({e})")
        raise tripped
