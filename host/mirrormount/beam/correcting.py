"""One correction: pulses, a look, and what both teach of the spots, the gaps and the response.

A shaft in its gap is turned by what is surely free, and then by no more than the spots are meant to move, until they
are seen to move: so a reversal never throws the beam.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mirrormount.beam import events
from mirrormount.beam.choosing import LEAST_STEPS, Choice, Prices, choose
from mirrormount.beam.events import Corrected, Listen, ResponseChanged
from mirrormount.beam.gap import Gap
from mirrormount.beam.looking import Look, Looker, Vector
from mirrormount.beam.loop_table import LoopTable
from mirrormount.beam.mover import Mover
from mirrormount.beam.response import Matrix, Response
from mirrormount.beam.tracker import Tracker

_SURE_SIGMAS = 3.0  # beyond the gap, from which on the screw certainly follows
_SEEN_SIGMAS = 2.5  # of a motion that counts as seen
_SEEN_PART = 0.15  # and of the way that was driven
_GAIN = 0.9  # of a correction of a step and more: its scatter is not to change the direction
_APART = 0.3  # cosine of the motions of two actuators that may creep at once
_JUMP_SIGMAS = 8.0  # of the gap: a wish beyond that and beyond Creep.jump_steps is driven at once
_STUCK_STEPS = 2.5  # driven beyond the gap without any motion: the axis does not move


@dataclass(frozen=True)
class Creep:
    """How a gap is crossed. Motions of the spots in um (root of the sum of squares).

    mean_um, most_um: by the take-up, on average and hardly ever. least_um, largest_um: by a pulse of the creep.
    jump_steps: a correction by more is made at once, and the next one corrects what the gap's scatter made of it.
    """

    mean_um: float = 4.0
    most_um: float = 40.0
    least_um: float = 15.0
    largest_um: float = 25.0
    jump_steps: float = 0.4


SOFTLY = Creep()  # in a hold: no excursion
QUICKLY = Creep(mean_um=12.0, most_um=100.0, least_um=20.0, largest_um=60.0, jump_steps=0.2)  # in an alignment


@dataclass(eq=False)
class Driven:
    """One actuator in one correction. wished, drove: steps; expected: of the screw, ± sigma. creeps: not sure."""

    i: int
    way: int
    wished: float
    drove: float
    scatter: float
    expected: float
    sigma: float
    creeps: bool
    in_gap: bool


@dataclass(eq=False)
class Outcome:
    """What came of a correction. helped: None if it cannot be told; stuck: actuators that do not move any more."""

    driven: list[Driven]
    expected_um: Vector
    changed_um: Vector
    met: list[int] = field(default_factory=list)
    stuck: list[int] = field(default_factory=list)

    @property
    def helped(self) -> float | None:
        """The part of the expected change that came, if all that moved was in contact."""
        size = float(self.expected_um @ self.expected_um)
        if not size or any(each.creeps for each in self.driven):
            return None
        return float(self.changed_um @ self.expected_um) / size


class Corrector:
    """Corrections of one table by one response.

    number: of corrections so far. One that crosses a gap is one, whatever further pulses the creep takes: creeps.
    """

    def __init__(
        self, table: LoopTable, response: Response, gaps: Sequence[Gap], looker: Looker, mover: Mover, listen: Listen
    ) -> None:
        self.table, self.response, self.gaps = table, response, gaps
        self.looker, self.mover = looker, mover
        self.tracker = Tracker(response.noise_um)
        self.number = self.creeps = 0
        self.creep = SOFTLY
        self._listen = listen
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
            steps = self._alone(in_gap, prices, weight)
        travels: dict[int, float] = {}
        purposes: dict[int, str] = {}
        before: dict[int, tuple[float, float]] = {}
        for i in np.flatnonzero(np.abs(steps) >= LEAST_STEPS):
            wished = abs(float(steps[i])) * (_GAIN if abs(steps[i]) > 1 else 1.0)
            travels[int(i)], purposes[int(i)] = _way(steps[i]) * wished, events.CORRECT
        for i, creep in self._creeps(in_gap, choice.steps).items():
            way = _way(choice.steps[i])
            size = float(np.linalg.norm(self.response.column(i, way)))
            free = self.gaps[i].free(way, self.creep.mean_um / size, self.creep.most_um / size)
            if free + creep >= LEAST_STEPS:
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
        for i in sorted(left, key=lambda i: -abs(steps[i]) * self._size(i, steps)):
            column = self.response.column(i, _way(steps[i])) / self._size(i, steps)
            if all(abs(float(column @ other)) < _APART for other in chosen):
                chosen.append(column)
                size = self._size(i, steps)
                creeps[i] = min(max(abs(float(steps[i])), self.creep.least_um / size), self.creep.largest_um / size)
        return creeps

    def _size(self, i: int, steps: Vector) -> float:
        """The change of the spots by a step, um (root of the sum of squares)."""
        return float(np.linalg.norm(self.response.column(i, _way(steps[i]))))

    def learn(self, driven: list[Driven], look: Look, frames: int) -> Outcome:
        """Take the first look after the pulses, and learn from it."""
        tracker = self.tracker
        tracker.pass_to(look.time_s)
        n = len(tracker.mean)
        before = tracker.mean.copy()
        expected, unsure = np.zeros(n), np.zeros((n, n))
        for each in driven:
            if not each.creeps:
                column = self._column(each)
                expected += column * each.expected
                unsure += np.outer(column, column) * each.sigma**2
        tracker.moved(expected, unsure)
        outcome = Outcome(driven, expected, look.errors_um - before)
        self._learn_gaps(driven, look, frames, outcome)
        for each in driven:
            if each.creeps:
                column = self._column(each)
                tracker.moved(np.zeros(n), np.outer(column, column) * each.drove**2)
        tracker.see(look.errors_um, frames)
        self._seen_s = look.time_s
        if self.looker.free_um is not None:
            self.looker.free_um = self.looker.free_um + (tracker.mean - before)
        if not any(each.in_gap for each in driven):
            self._refine(driven, outcome, frames)
        self._tell(driven, before, outcome, look)
        return outcome

    def _column(self, each: Driven) -> Vector:
        """The change of the errors for a step of the screw in its way."""
        return self.response.column(each.i, each.way) * each.way

    def _learn_gaps(self, driven: list[Driven], look: Look, frames: int, outcome: Outcome) -> None:
        """How far each screw that was in its gap has moved, by generalised least squares."""
        doubtful = [each for each in driven if each.in_gap]
        for each in driven:
            if not each.in_gap:
                self.gaps[each.i].followed(each.way)
                self._stuck[each.i] = 0.0
        if not doubtful:
            return
        nu, s = self.tracker.innovation(look.errors_um, frames)
        columns = np.array([self._column(each) for each in doubtful]).T
        inverse = np.linalg.inv(s)
        normal = columns.T @ inverse @ columns + np.diag([1e-6] * len(doubtful))
        ways = np.linalg.solve(normal, columns.T @ inverse @ nu)
        sigmas = np.sqrt(np.diag(np.linalg.inv(normal)))
        for each, way, sigma in zip(doubtful, ways, sigmas, strict=True):
            moved = each.expected + float(way)
            gap = self.gaps[each.i]
            if not each.creeps or moved > max(_SEEN_SIGMAS * float(sigma), _SEEN_PART * min(each.wished, each.drove)):
                gap.met(each.way, each.drove, max(0.0, moved))
                outcome.met.append(each.i)
                self._stuck[each.i] = 0.0
                continue
            gap.drove(each.way, each.drove, each.scatter)
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
                tuple(names[each.i] for each in driven if each.in_gap),
            )
        )
        matrix = tuple(_floats(row) for row in self.response.matrices[1])
        self._listen(ResponseChanged(look.time_s, matrix, self.response.change))


def _way(steps: float) -> int:
    return 1 if steps > 0 else -1


def _floats(vector: Vector) -> tuple[float, ...]:
    return tuple(float(value) for value in vector)
