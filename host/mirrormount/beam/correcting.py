"""One correction: pulses, a look, and what both teach of the spots, the gaps and the response.

A shaft in its gap is turned by what is surely free, and then by no more than the spots are meant to move, until they
are seen to move: so a reversal never throws the beam.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mirrormount.beam import events
from mirrormount.beam.choosing import LEAST_STEPS, Choice, Prices, choose
from mirrormount.beam.contact import Moved
from mirrormount.beam.driven import SOFTLY, Driven, Outcome
from mirrormount.beam.events import Corrected, Listen, ResponseChanged
from mirrormount.beam.gap import Gap
from mirrormount.beam.looking import Look, Looker, Vector
from mirrormount.beam.loop_table import LoopTable
from mirrormount.beam.mover import Mover
from mirrormount.beam.response import Matrix, Response
from mirrormount.beam.tracker import Tracker

_SURE_SIGMAS = 3.0  # beyond the gap, from which on the screw certainly follows
_GAIN = 0.9  # of a correction of a step and more: its scatter is not to change the direction
_APART = 0.3  # cosine of the motions of two actuators that may creep at once
_JUMP_SIGMAS = 8.0  # of the gap: a wish beyond that and beyond Creep.jump_steps is driven at once
_PLAUSIBLE = (0.4, 2.0)  # part of an expected change that teaches something of the response
_CREEP_PART = 0.15  # of the present error, by a pulse of a creep: what is far off need not creep softly
_LEAST_FREE = 0.02  # steps of a gap that are driven ahead of a creep
_UNSEEN = 0.9  # chance of a contact at most, where nothing was seen
_STUCK_STEPS = 2.5  # driven beyond the gap without any motion: the axis does not move


class Corrector:
    """Corrections of one table by one response.

    number: of corrections so far. One that crosses a gap is one, whatever further pulses the creep takes: creeps.
    bound: makes steps smaller that are chosen here, as those of a choice were made.
    """

    def __init__(
        self, table: LoopTable, response: Response, gaps: Sequence[Gap], looker: Looker, mover: Mover, listen: Listen
    ) -> None:
        self.table, self.response, self.gaps = table, response, gaps
        self.looker, self.mover = looker, mover
        self.tracker = Tracker(response.noise_um)
        self.number = self.creeps = 0
        self.creep = SOFTLY
        self.bound: Callable[[Vector], Vector] = lambda steps: steps
        self._listen = listen
        self._ways = [0] * response.actuators  # of the last correction of each actuator
        self._stuck = [0.0] * response.actuators
        self._moved_at_s = -math.inf
        self._crossing: set[tuple[int, int]] = set()
        self._seen_s = -math.inf
        looker.free_um = np.zeros(2 * len(table.eyes))

    def see(self, look: Look, frames: int) -> None:
        """A look at rest."""
        self.tracker.pass_to(look.time_s)
        rested_s = look.time_s - self._seen_s if self._seen_s > self._moved_at_s else 0.0
        self.tracker.see(look.errors_um, frames, rested_s)
        self._seen_s = look.time_s

    def drive(self, choice: Choice, prices: Prices, weight: Matrix) -> list[Driven]:
        """Give the pulses of a choice. Raises as Mover.travel().

        While a chosen shaft is in its gap, it is brought to its end first: one of them creeps, the others are turned by
        what is surely free. What is in contact corrects alone meanwhile.
        """
        steps = choice.steps
        in_gap = [i for i, gap in enumerate(self.gaps) if steps[i] and not gap.in_contact(_way(steps[i]))]
        if in_gap:
            steps = self.bound(self._alone(in_gap, prices, weight))
        travels: dict[int, float] = {}
        purposes: dict[int, str] = {}
        before: dict[int, tuple[float, float]] = {}
        for i in np.flatnonzero(np.abs(steps) >= LEAST_STEPS):
            wished = abs(float(steps[i])) * (_GAIN if abs(steps[i]) > 1 else 1.0)
            travels[int(i)], purposes[int(i)] = _way(steps[i]) * wished, events.CORRECT
        for i, creep in self._creeps(in_gap, choice.steps).items():
            way = _way(choice.steps[i])
            size = float(np.linalg.norm(self.response.column(i, way)))
            scatter = self.response.scatter(self.table.actuators[i].step_us)
            free = self.gaps[i].free(way, self.creep.mean_um / size, self.creep.most_um / size, scatter)
            if creep or free >= _LEAST_FREE:
                travels[i] = way * (free + creep)
                purposes[i] = events.TAKE_UP if free > creep else events.CREEP
        for i, steps_i in travels.items():
            before[i] = self.gaps[i].slack(_way(steps_i))
        self._moved_at_s = self.table.now_s()
        try:
            made = self.mover.travel(self.response, travels, purposes)
        except BaseException:
            for i in travels:
                self.gaps[i].forget()
            raise
        finally:
            self._moved_at_s = self.table.now_s()
        driven = []
        for i, (signed, scatter) in made.items():
            way, drove = (1 if signed > 0 else -1), abs(signed)
            mean, sigma = before[i]
            unsure = math.hypot(sigma, scatter)
            sure = drove - mean > _SURE_SIGMAS * unsure or mean <= 0
            expected = max(0.0, drove - mean) if sure else 0.0
            wished = abs(float(choice.steps[i]))
            driven.append(Driven(i, way, wished, drove, scatter, expected, unsure, not sure, mean > 0))
        return driven

    def _alone(self, in_gap: Sequence[int], prices: Prices, weight: Matrix) -> Vector:
        """The best correction by the actuators that are in contact."""
        errors = self.tracker.mean
        rest = [i for i in range(self.response.actuators) if i not in in_gap]
        return choose(errors, self.response, self.gaps, prices, weight, among=rest, contact_only=True).steps

    def _creeps(self, in_gap: Sequence[int], steps: Vector) -> dict[int, float]:
        """How far each screw in its gap may be moved beyond what is free: one creeps in each direction of the spots.

        A wish of many times the gap's uncertainty is driven at once.
        """
        creeps: dict[int, float] = dict.fromkeys(in_gap, 0.0)
        for i in in_gap:
            way = _way(steps[i])
            wished = abs(float(steps[i]))
            if wished > max(_JUMP_SIGMAS * self.gaps[i].slack(way)[1], self.creep.jump_steps):
                creeps[i] = wished * _GAIN
        left = [i for i in in_gap if not creeps[i]]
        chosen: list[Vector] = []
        largest_um = max(self.creep.largest_um, _CREEP_PART * float(np.linalg.norm(self.tracker.mean)))
        for i in sorted(left, key=lambda i: -abs(steps[i]) * self._size(i, steps)):
            column = self.response.column(i, _way(steps[i])) / self._size(i, steps)
            if all(abs(float(column @ other)) < _APART for other in chosen):
                chosen.append(column)
                size = self._size(i, steps)
                creeps[i] = min(max(abs(float(steps[i])), self.creep.least_um / size), largest_um / size)
        return creeps

    def _size(self, i: int, steps: Vector) -> float:
        """The change of the spots by a step, um (root of the sum of squares)."""
        return float(np.linalg.norm(self.response.column(i, _way(steps[i]))))

    def learn(self, driven: list[Driven], look: Look, frames: int) -> Outcome:
        """Take the first look after the pulses, and learn from it."""
        tracker = self.tracker
        tracker.pass_to(look.time_s)
        before = tracker.mean.copy()
        columns = [self._column(each) for each in driven]
        expected = sum((c * each.expected for c, each in zip(columns, driven, strict=True)), 0 * before)
        outcome = Outcome(driven, expected, look.errors_um - before)
        motions = self._learn_gaps(driven, columns, look, frames, outcome)
        moved, unsure = 0 * before, np.zeros((len(before), len(before)))
        for column, motion in zip(columns, motions, strict=True):
            moved += column * motion.mean
            unsure += np.outer(column, column) * motion.variance
        tracker.moved(moved, unsure)
        nu, s = tracker.innovation(look.errors_um, frames)
        by_motion = moved + unsure @ np.linalg.solve(s, nu)  # the rest is drift and noise
        tracker.see(look.errors_um, frames)
        self._seen_s = look.time_s
        if self.looker.free_um is not None:
            self.looker.free_um = self.looker.free_um + by_motion
        helped = outcome.helped
        if helped is not None and _PLAUSIBLE[0] < helped < _PLAUSIBLE[1]:
            self._refine(driven, outcome, frames)
        self._tell(driven, before, outcome, look)
        return outcome

    def unseen(self, driven: list[Driven]) -> None:
        """There is no look after the pulses: what is known of them is what was foreseen. No contact comes of that."""
        for each in driven:
            gap, column = self.gaps[each.i], self._column(each)
            foreseen = gap.pulse(each.way, each.drove, each.scatter).foreseen()
            self.tracker.moved(column * foreseen.mean, np.outer(column, column) * foreseen.variance)
            follows = foreseen.follows if gap.in_contact(each.way) else min(foreseen.follows, _UNSEEN)
            gap.moved(each.way, each.drove, each.scatter, replace(foreseen, follows=follows))

    def _column(self, each: Driven) -> Vector:
        """The change of the errors for a step of the screw in its way."""
        return self.response.column(each.i, each.way) * each.way

    def _learn_gaps(
        self, driven: list[Driven], columns: list[Vector], look: Look, frames: int, outcome: Outcome
    ) -> list[Moved]:
        """How far each screw has moved, and whether it follows: of each by what the others leave to explain."""
        pulses = [self.gaps[each.i].pulse(each.way, each.drove, each.scatter) for each in driven]
        motions = [pulse.foreseen() for pulse in pulses]
        innovation, covariance = self.tracker.innovation(look.errors_um, frames)
        for k in sorted(range(len(driven)), key=lambda k: driven[k].in_gap):
            others = [(columns[m], motions[m]) for m in range(len(driven)) if m != k]
            nu = innovation - sum((column * motion.mean for column, motion in others), 0 * innovation)
            s = covariance + sum((np.outer(c, c) * motion.variance for c, motion in others), 0 * covariance)
            weights = np.linalg.solve(s, columns[k])
            size = float(columns[k] @ weights)
            motions[k] = pulses[k].seen(float(weights @ nu) / size, size**-0.5)
        for each, motion in zip(driven, motions, strict=True):
            self._take(each, motion, outcome)
        return motions

    def _take(self, each: Driven, motion: Moved, outcome: Outcome) -> None:
        """What is known of a motion now, for the gap; and whether the axis moves at all."""
        gap = self.gaps[each.i]
        was = gap.in_contact(each.way)
        if gap.moved(each.way, each.drove, each.scatter, motion):
            outcome.met.append(each.i)
        if was and not gap.in_contact(each.way):
            outcome.doubted.append(each.i)
        if motion.follows > 0.5:
            self._stuck[each.i] = 0.0
            return
        same = self._stuck[each.i] * each.way >= 0
        self._stuck[each.i] = each.way * each.drove + (self._stuck[each.i] if same else 0.0)
        if abs(self._stuck[each.i]) > gap.widths[each.way].mean + _STUCK_STEPS:
            outcome.stuck.append(each.i)

    def _refine(self, driven: list[Driven], outcome: Outcome, frames: int) -> None:
        steps = np.zeros(self.response.actuators)
        for each in driven:
            steps[each.i] = each.way * each.expected
        noise = math.sqrt(float(np.mean(np.diag(self.tracker.noise))) / frames)
        self.response.refine(steps, outcome.changed_um, noise)
        if len(driven) == 1 and driven[0].drove < 1:
            ratio = outcome.helped
            size = float(np.linalg.norm(outcome.expected_um))
            if ratio is not None and size > noise:
                weight = size**2 / (size**2 + 4 * noise**2)
                self.response.refine_short(driven[0].i, driven[0].way, ratio, weight)

    def _goes_on(self, driven: list[Driven]) -> bool:
        """True if a gap is being crossed since before: what is done meanwhile belongs to that correction."""
        crossing = {(each.i, each.way) for each in driven if each.in_gap}
        before, self._crossing = self._crossing, crossing
        return bool(crossing & before)

    def _tell(self, driven: list[Driven], before: Vector, outcome: Outcome, look: Look) -> None:
        if self._goes_on(driven):
            self.creeps += 1
        else:
            self.number += 1
        names = [actuator.name for actuator in self.table.actuators]
        self._listen(
            Corrected(
                look.time_s,
                self.number,
                {names[each.i]: each.way * each.drove for each in driven},
                _floats(before),
                _floats(before + outcome.expected_um),
                _floats(self.tracker.mean),
                tuple(names[each.i] for each in driven if each.way == -self._ways[each.i]),
            )
        )
        for each in driven:
            self._ways[each.i] = each.way
        matrix = tuple(_floats(row) for row in self.response.matrices[1])
        self._listen(ResponseChanged(look.time_s, matrix, self.response.change))


def _way(steps: float) -> int:
    return 1 if steps > 0 else -1


def _floats(vector: Vector) -> tuple[float, ...]:
    return tuple(float(value) for value in vector)
