"""What one correction drives and what came of it; how a gap is crossed.

Which actuators correct an error, and by how much: the ones whose moves save more than they cost. Pure; numpy.

Every set of actuators is tried. A set's steps are the damped least squares (A. N. Tikhonov, 1963); the sum of squares
that is left, and a price for each pulse and for each gap that has to be crossed, are its cost. So an error within the
noise is not corrected (the dead band), a reversal is made only where it pays (the hysteresis), and a mount that
corrects an error nearly does so alone.

Moves several actuators at once, in steps of travel, and watches the spot meanwhile. Imports looking, response.

One correction: pulses, a look, and what both teach of the spots, the gaps and the response.

A shaft in its gap is turned by what is surely free, and then by no more than the spots are meant to move, until they
are seen to move: so a reversal never throws the beam.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mirrormount.beam.control import events
from mirrormount.beam.control.backlash import Gap, Moved
from mirrormount.beam.control.events import CORRECT, MEASURE, Corrected, Listen, Pulsed, ResponseChanged
from mirrormount.beam.control.interfaces import Actuator, LoopTable
from mirrormount.beam.control.kalman import Tracker
from mirrormount.beam.control.response import Matrix, Response
from mirrormount.beam.looking import Look, Looker, Misses, Vector


@dataclass(frozen=True)
class Creep:
    """How a gap is crossed. Motions of the spots in um (root of the sum of squares).

    mean_um, most_um: by the take-up, on average and hardly ever. least_um, largest_um: by a pulse of the creep.
    jump_steps: a correction by more is made at once, and the next one corrects what the gap's scatter made of it.
    """

    mean_um: float = 5.0
    most_um: float = 45.0
    least_um: float = 15.0
    largest_um: float = 23.0
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
    """What came of a correction. helped: None if it cannot be told; doubted: actuators
    that are in their gaps after all; stuck: actuators that do not move any more."""

    driven: list[Driven]
    expected_um: Vector
    changed_um: Vector
    met: list[int] = field(default_factory=list)
    stuck: list[int] = field(default_factory=list)
    doubted: list[int] = field(default_factory=list)

    @property
    def helped(self) -> float | None:
        """The part of the expected change that came, if all that moved was in contact."""
        size = float(self.expected_um @ self.expected_um)
        if not size or self.doubted or any(each.in_gap for each in self.driven):
            return None
        return float(self.changed_um @ self.expected_um) / size


TIKHONOV = 0.03  # of the largest singular value
MOST_STEPS = 15.0  # of one actuator in one correction
LEAST_STEPS = 0.003  # a smaller wish is none


@dataclass(frozen=True)
class Prices:
    """What a move must save at least, in um² of the sum of squares: a pulse, and crossing a whole gap."""

    pulse_um2: float
    gap_um2: float


@dataclass(frozen=True, eq=False)
class Choice:
    """Steps of the screws for each actuator (0: it rests), and the errors that are left by them, um."""

    steps: Vector
    left_um: Vector

    def __bool__(self) -> bool:
        """True if something is to be moved."""
        return bool(np.any(self.steps))


def choose(
    errors_um: Vector,
    response: Response,
    gaps: Sequence[Gap],
    prices: Prices,
    weight: Matrix,
    *,
    among: Sequence[int] | None = None,
    contact_only: bool = False,
) -> Choice:
    """The best correction. weight: of the sum of squares, (errors, errors).

    among: actuators that may move (default: all). contact_only: none that would have to cross its gap.
    """
    allowed = range(response.actuators) if among is None else among
    n = response.actuators
    best, least = np.zeros(n), float(errors_um @ weight @ errors_um)
    top = float(np.linalg.norm(response.matrices[1], 2))
    damping = (TIKHONOV * top) ** 2
    for size in range(1, len(allowed) + 1):
        for chosen in itertools.combinations(allowed, size):
            steps = _least_squares(errors_um, response, chosen, damping, weight)
            if np.any(np.abs(steps[list(chosen)]) < LEAST_STEPS):
                continue
            if contact_only and not all(gaps[i].in_contact(1 if steps[i] > 0 else -1) for i in chosen):
                continue
            left = errors_um + response.effect(steps)
            cost = float(left @ weight @ left) + _price(steps, chosen, gaps, prices)
            if cost < least:
                best, least = steps, cost
    return Choice(best, errors_um + response.effect(best))


def needed_steps(errors_um: Vector, response: Response) -> Vector:
    """The steps of all actuators that an error needs, undamped and not bounded."""
    return np.asarray(np.linalg.lstsq(response.matrices[1], -errors_um, rcond=None)[0], dtype=np.float64)


def _price(steps: Vector, chosen: Sequence[int], gaps: Sequence[Gap], prices: Prices) -> float:
    price = 0.0
    for i in chosen:
        way = 1 if steps[i] > 0 else -1
        gap = gaps[i]
        price += prices.pulse_um2 + prices.gap_um2 * min(1.0, gap.slack(way)[0] / max(gap.widths[way].mean, 1e-6))
    return price


def _least_squares(
    errors_um: Vector, response: Response, chosen: Sequence[int], damping: float, weight: Matrix
) -> Vector:
    """Damped steps of the chosen actuators; the columns are those of the ways that come out."""
    steps = np.zeros(response.actuators)
    picked = list(chosen)
    signs = np.ones(response.actuators)
    for _ in range(3):
        columns = response.columns(signs)[:, picked]
        left = columns.T @ weight @ columns + damping * np.eye(len(picked))
        steps[picked] = np.linalg.solve(left, -columns.T @ weight @ errors_um)
        if np.array_equal(np.sign(steps[picked]), signs[picked]):
            break
        signs[picked] = np.where(steps[picked] < 0, -1.0, 1.0)
    largest = float(np.max(np.abs(steps)))
    return steps * min(1.0, MOST_STEPS / largest) if largest and math.isfinite(largest) else np.zeros_like(steps)


SHORTEST_US = 5000  # of a pulse: a shorter one of a rough motor moves nothing at times
_POLL_S, _SOON_S = 0.03, 0.01
_REST_S = 0.05  # of a pulse, after it
_LONG_US = 100_000  # the spot is watched during longer motions


class SpotLostMoving(Exception):
    """The spot was lost during a motion, and the motors were stopped. Never leaves the loop."""


class Mover:
    """Moves the actuators of a table. actions, reversals: counted since the beginning."""

    def __init__(self, table: LoopTable, looker: Looker, listen: Listen) -> None:
        self.table = table
        self.actions = self.reversals = 0
        self.motor_s = 0.0
        self._looker = looker
        self._listen = listen
        self._ways = [0] * len(table.actuators)

    def travel(
        self, response: Response, travels: Mapping[int, float], purposes: Mapping[int, str] | None = None
    ) -> dict[int, tuple[float, float]]:
        """Turn shafts by steps (signed), all at once. Returns for each the way that is expected, and its scatter.

        A way of less than the shortest pulse's is made longer: that is in what is returned. Raises as Actuator does,
        and SpotLostMoving.
        """
        whole: dict[int, int] = {}
        parts: dict[int, int] = {}
        made: dict[int, tuple[float, float]] = {}
        for i, steps in travels.items():
            way = 1 if steps > 0 else -1
            n = int(abs(steps))
            rest = abs(steps) - n
            us = response.pulse_us(i, way, rest, SHORTEST_US) if rest > 0 else 0
            if n and us <= SHORTEST_US:
                us = 0
            if n:
                whole[i] = way * n
            if us:
                parts[i] = way * us
            part = response.pulse_steps(i, way, us) if us else 0.0
            scatter = math.hypot(math.sqrt(n) * response.scatter(self.table.actuators[i].step_us), 0.0)
            scatter = math.hypot(scatter, part * response.scatter(us)) if us else scatter
            made[i] = way * (n + part), scatter
            length = way * (n * self.table.actuators[i].step_us + us)
            self._tell(i, length, (purposes or {}).get(i, CORRECT))
        self.steps(whole)
        self.pulses(parts)
        self._looker.moved()
        return made

    def measure(self, steps: Mapping[int, int]) -> None:
        """Whole steps for a calibration."""
        for i, n in steps.items():
            self._tell(i, n * self.table.actuators[i].step_us, MEASURE)
        self.steps(steps)
        self._looker.moved()

    def measure_pulses(self, us: Mapping[int, int]) -> None:
        """One pulse each for a calibration."""
        for i, length in us.items():
            self._tell(i, length, MEASURE)
        self.pulses(us)
        self._looker.moved()

    def steps(self, steps: Mapping[int, int]) -> None:
        """Whole steps, all at once, to their end."""
        self._run({i: n for i, n in steps.items() if n}, lambda a, n: a.step(n), max_us=_LONG_US + 1)

    def pulses(self, us: Mapping[int, int]) -> None:
        """One pulse each, all at once, to their end."""
        longest = max((abs(length) for length in us.values()), default=0)
        self._run(us, lambda a, length: a.pulse(length), max_us=longest)

    def _run(self, amounts: Mapping[int, int], begin: Callable[[Actuator, int], None], *, max_us: int) -> None:
        """Begin, and wait for the end; however it ends early, all motors are off."""
        if not amounts:
            return
        moving = [self.table.actuators[i] for i in amounts]
        misses = Misses()
        try:
            for i, amount in amounts.items():
                begin(self.table.actuators[i], amount)
            if max_us <= _LONG_US:
                self.table.sleep(max_us * 1e-6 + _REST_S)
            while moving := [actuator for actuator in moving if actuator.is_moving()]:
                if max_us <= _LONG_US:
                    self.table.sleep(_SOON_S)
                    continue
                before_s = self.table.now_s()
                if misses.too_many(self._looker.glance()):
                    raise SpotLostMoving
                self.table.sleep(_POLL_S - (self.table.now_s() - before_s))
        except BaseException:
            try:
                self.table.stop()
            finally:
                self._looker.moved()
            raise

    def _tell(self, i: int, us: int, purpose: str) -> None:
        way = 1 if us > 0 else -1
        self.actions += 1
        if self._ways[i] == -way:
            self.reversals += 1
        self._ways[i] = way
        self.motor_s += abs(us) * 1e-6
        self._listen(Pulsed(self.table.now_s(), self.table.actuators[i].name, us, purpose))


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
