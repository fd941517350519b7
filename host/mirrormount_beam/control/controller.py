"""One correction of the loop: plan it, drive it, observe the spots, and learn from what was seen.

Plan: which actuators correct an error, and by how much, are those whose moves save more than they cost. Every set of
actuators is tried. A set's steps are the damped least squares (A. N. Tikhonov, 1963); the sum of squares that is left,
and a price for each pulse and for each gap that has to be crossed, are its cost. So an error within the noise is not
corrected (the dead band), a reversal is made only where it pays (the hysteresis), and a mount that corrects an error
nearly does so alone.

Drive: a shaft in its gap is turned by what is surely free, and then by no more than the spots are meant to move, until
they are seen to move: so a reversal never throws the beam.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mirrormount_beam.control.backlash import Gap, ScrewMotion
from mirrormount_beam.control.events import CORRECT, CREEP, MEASURE, TAKE_UP, Corrected, Listen, Pulsed, ResponseChanged
from mirrormount_beam.control.interfaces import Actuator, LoopTable
from mirrormount_beam.control.kalman import Tracker
from mirrormount_beam.control.response import Matrix, Response, Travel, Vector
from mirrormount_beam.observe import Fault, Misses, Observation, Observer

_TIKHONOV = 0.03  # The damping of the least squares, relative to the largest singular value of the response.
_MOST_STEPS = 15.0  # One correction moves an actuator by no more steps.
_LEAST_STEPS = 0.003  # A correction of fewer steps is not driven.
_POLL_S, _SOON_S = 0.03, 0.01
_REST_S = 0.05  # The motor rests so long after each pulse.
_LONG_US = 100_000  # The spot is watched during motions that are longer.
_SURE_SIGMAS = 3.0  # So many standard deviations beyond the gap the screw follows for certain.
# Drive this part of a correction of a step or more: then the scatter of steps does not overshoot the target.
_GAIN = 0.9
_APART = 0.3  # Two actuators creep at once only if the cosine between their motions is smaller.
# A correction larger than so many standard deviations of the gap, and than Creep.jump_steps, need not creep: drive it
# in one pulse.
_JUMP_SIGMAS = 8.0
# A correction teaches the response only if the seen change is within these parts of the expected one.
_PLAUSIBLE = (0.4, 2.0)
# A pulse of a creep may move a spot by this part of its present error: a spot that is far off need not creep softly.
_CREEP_PART = 0.15
_LEAST_FREE = 0.02  # If fewer steps of the gap are surely free, the creep begins at once.
_UNSEEN = 0.9  # A contact that was not seen is never taken for more probable.
_STUCK_STEPS = 2.5  # An axis that was driven so many steps beyond its gap without any motion is stuck.


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


SOFTLY = Creep()  # A hold makes no excursions.
# An alignment may make excursions.
QUICKLY = Creep(mean_um=12.0, most_um=100.0, least_um=20.0, largest_um=60.0, jump_steps=0.2)


@dataclass(eq=False)
class Drive:
    """What one actuator does in one correction.

    way: the sign of its steps. wished, drove: steps. expected: of the screw, in steps, ± sigma. creeps: it is not sure
    that the screw follows. in_gap: it was not in contact before.
    """

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
    """What came of a correction. planned_um: its size (root of the sum of squares). fault: of a camera that showed no
    spot after it; then nothing else is known. met: actuators that have met the screw; doubted: those that are in their
    gaps after all; stuck: those that do not move the spots any more.
    """

    drives: list[Drive]
    planned_um: float
    expected_um: Vector
    changed_um: Vector
    fault: Fault | None = None
    met: list[int] = field(default_factory=list)
    stuck: list[int] = field(default_factory=list)
    doubted: list[int] = field(default_factory=list)

    @property
    def helped(self) -> float | None:
        """The part of the expected change that came, if all that moved was in contact; None: it cannot be told."""
        size = float(self.expected_um @ self.expected_um)
        if not size or self.doubted or any(each.in_gap for each in self.drives):
            return None
        return float(self.changed_um @ self.expected_um) / size


class SpotLostMoving(Exception):
    """The spot was lost during a motion, and the motors were stopped. Never leaves the loop."""


# ---- plan


@dataclass(frozen=True)
class Prices:
    """What a move must save at least, in um² of the sum of squares: a pulse, and crossing a whole gap.

    scatter: this part of the variance of the pulses' ways counts, too. The next correction undoes some of what a pulse
    did too much, so it is not the whole.
    """

    pulse_um2: float
    gap_um2: float
    scatter: float = 0.5


@dataclass(frozen=True, eq=False)
class Plan:
    """Steps of the screws for each actuator; 0: it rests."""

    steps: Vector

    def __bool__(self) -> bool:
        """True if something is to be moved."""
        return bool(np.any(self.steps))


def plan_correction(
    errors_um: Vector,
    response: Response,
    gaps: Sequence[Gap],
    prices: Prices,
    weight: Matrix,
    *,
    among: Sequence[int] | None = None,
    contact_only: bool = False,
) -> Plan:
    """The best correction. weight: of the sum of squares, (errors, errors).

    among: actuators that may move (default: all). contact_only: none that would have to cross its gap.
    """
    allowed = range(response.actuators) if among is None else among
    n = response.actuators
    best, least = np.zeros(n), float(errors_um @ weight @ errors_um)
    top = float(np.linalg.norm(response.matrices[1], 2))
    damping = (_TIKHONOV * top) ** 2
    for size in range(1, len(allowed) + 1):
        for chosen in itertools.combinations(allowed, size):
            steps = _least_squares(errors_um, response, chosen, damping, weight)
            if np.any(np.abs(steps[list(chosen)]) < _LEAST_STEPS):
                continue
            if contact_only and not all(gaps[i].in_contact(1 if steps[i] > 0 else -1) for i in chosen):
                continue
            left, variance = _expected(errors_um, response, steps, chosen, weight)
            cost = left + prices.scatter * variance + _price(steps, chosen, gaps, prices)
            if cost < least:
                best, least = steps, cost
    return Plan(best)


def _expected(
    errors_um: Vector, response: Response, steps: Vector, chosen: Sequence[int], weight: Matrix
) -> tuple[float, float]:
    """The sum of squares that the mean ways of the pulses for these steps leave, and what their scatter adds."""
    left, variance = errors_um.copy(), 0.0
    for i in chosen:
        travel = response.travel(i, float(steps[i]))
        column = response.column(i, travel.way)
        left += column * travel.way * travel.steps
        variance += travel.scatter**2 * float(column @ weight @ column)
    return float(left @ weight @ left), variance


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
    return steps * min(1.0, _MOST_STEPS / largest) if largest and math.isfinite(largest) else np.zeros_like(steps)


# ---- drive


class Mover:
    """Moves the actuators of a table. actions, reversals: counted since the beginning. observer: None if no spot is
    to be seen."""

    def __init__(self, table: LoopTable, observer: Observer | None, listen: Listen) -> None:
        self.table = table
        self.actions = self.reversals = 0
        self.motor_s = 0.0
        self._observer = observer
        self._listen = listen
        self._ways = [0] * len(table.actuators)

    def travel(
        self, response: Response, travels: Mapping[int, float], purposes: Mapping[int, str] | None = None
    ) -> dict[int, Travel]:
        """Turn shafts by steps (signed), all at once. Returns what is expected of each.

        Raises as Actuator does, and SpotLostMoving.
        """
        made = {i: response.travel(i, steps) for i, steps in travels.items()}
        for i, travel in made.items():
            length = travel.way * (travel.whole * self.table.actuators[i].step_us + travel.us)
            self._tell(i, length, (purposes or {}).get(i, CORRECT))
        self.steps({i: travel.way * travel.whole for i, travel in made.items()})
        self.pulses({i: travel.way * travel.us for i, travel in made.items() if travel.us})
        self._moved()
        return made

    def measure(self, steps: Mapping[int, int]) -> None:
        """Whole steps for a calibration."""
        for i, n in steps.items():
            self._tell(i, n * self.table.actuators[i].step_us, MEASURE)
        self.steps(steps)
        self._moved()

    def measure_pulses(self, us: Mapping[int, int]) -> None:
        """One pulse each for a calibration."""
        for i, length in us.items():
            self._tell(i, length, MEASURE)
        self.pulses(us)
        self._moved()

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
                if self._observer and misses.too_many(self._observer.glance()):
                    raise SpotLostMoving
                self.table.sleep(_POLL_S - (self.table.now_s() - before_s))
        except BaseException:
            try:
                self.table.stop()
            finally:
                self._moved()
            raise

    def _moved(self) -> None:
        if self._observer:
            self._observer.moved()

    def _tell(self, i: int, us: int, purpose: str) -> None:
        way = 1 if us > 0 else -1
        self.actions += 1
        if self._ways[i] == -way:
            self.reversals += 1
        self._ways[i] = way
        self.motor_s += abs(us) * 1e-6
        self._listen(Pulsed(self.table.now_s(), self.table.actuators[i].name, us, purpose))


# ---- plan, drive, observe, learn


class Controller:
    """Corrections of one table by one response.

    number: of corrections so far. One that crosses a gap is one, whatever further pulses the creep takes: creeps.
    limit: makes steps smaller before they are driven.
    """

    def __init__(
        self,
        table: LoopTable,
        response: Response,
        gaps: Sequence[Gap],
        listen: Listen,
        limit: Callable[[Vector], Vector] = lambda steps: steps,
    ) -> None:
        self.table, self.response, self.gaps = table, response, gaps
        self.observer = Observer(table, listen)
        self.mover = Mover(table, self.observer, listen)
        self.tracker = Tracker(response.noise_um)
        self.number = self.creeps = 0
        self.creep = SOFTLY
        self._limit = limit
        self._listen = listen
        self._ways = [0] * response.actuators  # of the last correction of each actuator
        self._stuck = [0.0] * response.actuators
        self._moved_at_s = -math.inf
        self._crossing: set[tuple[int, int]] = set()
        self._seen_s = -math.inf
        self.observer.free_um = np.zeros(2 * len(table.cameras))

    def observe(self, frames: int, *, anew: bool = False) -> Observation:
        """Observe the spots at rest. anew: what was known of them before does not count."""
        seen = self.observer.observe(frames)
        if seen:
            if anew:
                self.tracker.lose()
            self.tracker.pass_to(seen.time_s)
            rested_s = seen.time_s - self._seen_s if self._seen_s > self._moved_at_s else 0.0
            self.tracker.see(seen.errors_um, frames, rested_s)
            self._seen_s = seen.time_s
        return seen

    def plan(self, prices: Prices, weight: Matrix) -> Plan:
        """What is to be done about the errors."""
        return plan_correction(self.tracker.mean, self.response, self.gaps, prices, weight)

    def correct(self, plan: Plan, prices: Prices, weight: Matrix, frames: int) -> Outcome:
        """Drive a plan, observe, learn. Raises as Mover.travel()."""
        steps = self._limit(plan.steps)
        drives = self._drive(steps, prices, weight)
        seen = self.observer.observe(frames)
        planned_um = float(np.linalg.norm(self.response.effect(steps)))
        if not seen:
            self._foresee(drives)
            nothing = np.zeros_like(self.tracker.mean)
            return Outcome(drives, planned_um, nothing, nothing, seen.faults[0])
        return self._learn(drives, planned_um, seen, frames)

    # ---- drive

    def _drive(self, planned: Vector, prices: Prices, weight: Matrix) -> list[Drive]:
        """Give the pulses of a plan's steps.

        While a shaft that is to move is in its gap, it is brought to its end first: one of them creeps, the others are
        turned by what is surely free. What is in contact corrects alone meanwhile.
        """
        steps = planned
        in_gap = [i for i, gap in enumerate(self.gaps) if steps[i] and not gap.in_contact(_way(steps[i]))]
        if in_gap:
            steps = self._limit(self._alone(in_gap, prices, weight))
        travels: dict[int, float] = {}
        purposes: dict[int, str] = {}
        before: dict[int, tuple[float, float]] = {}
        for i in np.flatnonzero(np.abs(steps) >= _LEAST_STEPS):
            wished = abs(float(steps[i])) * (_GAIN if abs(steps[i]) > 1 else 1.0)
            travels[int(i)], purposes[int(i)] = _way(steps[i]) * wished, CORRECT
        for i, creep in self._creeps(in_gap, planned).items():
            way = _way(planned[i])
            size = float(np.linalg.norm(self.response.column(i, way)))
            scatter = self.response.curve.scatter[-1]
            free = self.gaps[i].free(way, self.creep.mean_um / size, self.creep.most_um / size, scatter)
            if creep or free >= _LEAST_FREE:
                # What is free by a calibration that is not true is not free: wires may have been exchanged.
                whole = np.zeros_like(planned)
                whole[i] = way * (free + creep)
                travels[i] = float(self._limit(whole)[i])
                purposes[i] = TAKE_UP if free > creep else CREEP
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
        drives = []
        for i, travel in made.items():
            way, drove, scatter = travel.way, travel.steps, travel.scatter
            mean, sigma = before[i]
            unsure = math.hypot(sigma, scatter)
            sure = drove - mean > _SURE_SIGMAS * unsure or mean <= 0
            expected = max(0.0, drove - mean) if sure else 0.0
            wished = abs(float(planned[i]))
            drives.append(Drive(i, way, wished, drove, scatter, expected, unsure, not sure, mean > 0))
        return drives

    def _alone(self, in_gap: Sequence[int], prices: Prices, weight: Matrix) -> Vector:
        """The best correction by the actuators that are in contact."""
        errors = self.tracker.mean
        rest = [i for i in range(self.response.actuators) if i not in in_gap]
        return plan_correction(errors, self.response, self.gaps, prices, weight, among=rest, contact_only=True).steps

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

    # ---- learn

    def _learn(self, drives: list[Drive], planned_um: float, seen: Observation, frames: int) -> Outcome:
        """Take the first observation after the pulses, and learn from it."""
        tracker = self.tracker
        tracker.pass_to(seen.time_s)
        before = tracker.mean.copy()
        columns = [self._column(each) for each in drives]
        expected = sum((c * each.expected for c, each in zip(columns, drives, strict=True)), 0 * before)
        outcome = Outcome(drives, planned_um, expected, seen.errors_um - before)
        motions = self._learn_gaps(drives, columns, seen, frames, outcome)
        moved, unsure = 0 * before, np.zeros((len(before), len(before)))
        for column, motion in zip(columns, motions, strict=True):
            moved += column * motion.mean
            unsure += np.outer(column, column) * motion.variance
        tracker.moved(moved, unsure)
        nu, s = tracker.innovation(seen.errors_um, frames)
        by_motion = moved + unsure @ np.linalg.solve(s, nu)  # the rest is drift and noise
        tracker.see(seen.errors_um, frames)
        self._seen_s = seen.time_s
        if self.observer.free_um is not None:
            self.observer.free_um = self.observer.free_um + by_motion
        helped = outcome.helped
        if helped is not None and _PLAUSIBLE[0] < helped < _PLAUSIBLE[1]:
            self._refine(drives, outcome, frames)
        self._tell(drives, before, outcome, seen)
        return outcome

    def _foresee(self, drives: list[Drive]) -> None:
        """Nothing was seen after the pulses: what is known of them is what was foreseen. No contact comes of that."""
        for each in drives:
            gap, column = self.gaps[each.i], self._column(each)
            foreseen = gap.pulse(each.way, each.drove, each.scatter).foreseen()
            self.tracker.moved(column * foreseen.mean, np.outer(column, column) * foreseen.variance)
            follows = foreseen.follows if gap.in_contact(each.way) else min(foreseen.follows, _UNSEEN)
            gap.moved(each.way, each.drove, each.scatter, replace(foreseen, follows=follows))

    def _column(self, each: Drive) -> Vector:
        """The change of the errors for a step of the screw in its way."""
        return self.response.column(each.i, each.way) * each.way

    def _learn_gaps(
        self, drives: list[Drive], columns: list[Vector], seen: Observation, frames: int, outcome: Outcome
    ) -> list[ScrewMotion]:
        """How far each screw has moved, and whether it follows: of each by what the others leave to explain."""
        pulses = [self.gaps[each.i].pulse(each.way, each.drove, each.scatter) for each in drives]
        motions = [pulse.foreseen() for pulse in pulses]
        innovation, covariance = self.tracker.innovation(seen.errors_um, frames)
        for k in sorted(range(len(drives)), key=lambda k: drives[k].in_gap):
            others = [(columns[m], motions[m]) for m in range(len(drives)) if m != k]
            nu = innovation - sum((column * motion.mean for column, motion in others), 0 * innovation)
            s = covariance + sum((np.outer(c, c) * motion.variance for c, motion in others), 0 * covariance)
            weights = np.linalg.solve(s, columns[k])
            size = float(columns[k] @ weights)
            motions[k] = pulses[k].seen(float(weights @ nu) / size, size**-0.5)
        for each, motion in zip(drives, motions, strict=True):
            self._take(each, motion, outcome)
        return motions

    def _take(self, each: Drive, motion: ScrewMotion, outcome: Outcome) -> None:
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

    def _refine(self, drives: list[Drive], outcome: Outcome, frames: int) -> None:
        steps = np.zeros(self.response.actuators)
        for each in drives:
            steps[each.i] = each.way * each.expected
        noise = math.sqrt(float(np.mean(np.diag(self.tracker.noise))) / frames)
        self.response.refine(steps, outcome.changed_um, noise)
        if len(drives) == 1 and drives[0].drove < 1:
            ratio = outcome.helped
            size = float(np.linalg.norm(outcome.expected_um))
            if ratio is not None and size > noise:
                weight = size**2 / (size**2 + 4 * noise**2)
                self.response.refine_short(drives[0].i, drives[0].way, ratio, weight)

    def _goes_on(self, drives: list[Drive]) -> bool:
        """True if a gap is being crossed since before: what is done meanwhile belongs to that correction."""
        crossing = {(each.i, each.way) for each in drives if each.in_gap}
        before, self._crossing = self._crossing, crossing
        return bool(crossing & before)

    def _tell(self, drives: list[Drive], before: Vector, outcome: Outcome, seen: Observation) -> None:
        if self._goes_on(drives):
            self.creeps += 1
        else:
            self.number += 1
        names = [actuator.name for actuator in self.table.actuators]
        self._listen(
            Corrected(
                seen.time_s,
                self.number,
                {names[each.i]: each.way * each.drove for each in drives},
                _floats(before),
                _floats(before + outcome.expected_um),
                _floats(self.tracker.mean),
                tuple(names[each.i] for each in drives if each.way == -self._ways[each.i]),
            )
        )
        for each in drives:
            self._ways[each.i] = each.way
        matrix = tuple(_floats(row) for row in self.response.matrices[1])
        self._listen(ResponseChanged(seen.time_s, matrix, self.response.change))


def _way(steps: float) -> int:
    return 1 if steps > 0 else -1


def _floats(vector: Vector) -> tuple[float, ...]:
    return tuple(float(value) for value in vector)
