"""Maximises a signal by the axes of one or two mounts: the power of a fibre or behind a pinhole, by any function.

    found = maximise(table, read_power)  # a LoopTable, and a function that returns a float

What is known of a motor that a program sees no position of: it has a gap, its pulses scatter, and its screw sticks. So
nothing here counts on a position. All is done by sweeps: an axis is driven in one direction in short pulses, and after
each the signal is read. A sweep ends when the signal has fallen to a part of the best that this sweep has seen: the
maximum has been passed, and light cannot be lost by much. To return, the axis turns back: within its gap the signal
stays, then it rises, and the axis stops when the signal is what it was at the maximum, wherever that is by count.

The two mounts of a beam walk do nearly the same to the angle at the fibre, so the signal has a ridge: along it both
move against each other, and the signal changes little. A sweep along it lets the two axes take turns. Each is driven
over its maximum, which moves the other one off it, in a direction that the other goes on in: no gap is crossed, and the
maxima that are passed are the ridge's height. It ends as a sweep of one axis does.
"""

import contextlib
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from mirrormount.errors import MountError
from mirrormount.markup import html_table
from mirrormount_beam.control.controller import Mover
from mirrormount_beam.control.events import ALIGNING, ENDED, Listen, SignalRead, StateChanged, silent
from mirrormount_beam.control.interfaces import LoopTable
from mirrormount_beam.control.response import SHORTEST_US
from mirrormount_beam.errors import SignalDark, SignalNotANumber, SignalSaturated

LIMIT_STEPS = 40.0  # 15 mrad of the virtual mounts' beam: farther, a beam of a millimetre misses a collimator for sure
FALL = 0.2  # of the best of a sweep: beyond what the laser's drift does, and the light that was there is not lost
NEAR = 0.01  # of a maximum, which one axis may leave: four then leave less than the 5 % that count as coupled
_BACK = 5 * NEAR  # the fall that ends a sweep back to a known maximum, once it is near
_LOST = 2 * FALL  # the same while it is not near: it lies this way, so that a smaller fall is drift
_PRECISION, _COARSE = NEAR / 2, 3 * NEAR  # of a mean near the best of a sweep, and elsewhere
_LEAST, _MOST = 4, 64  # readings of a mean
_SURE = 3.0  # standard deviations: what differs by less does not differ
_FIRST_US = 2 * SHORTEST_US  # of the first pulses
_FAST = 0.5  # a pulse that changes the signal by more was too long
_SLOW = 5  # pulses that change it by less than FALL / 2 together are too short
_GAP_PART = 0.75  # of the last gap is crossed at once: the rest is its scatter, and what was driven until it was seen
_GAP_STEPS = 4.0  # no gap is wider (1.7 in the paper's mount): an axis whose signal stays for so long has no effect
_DARK = 30  # means in a row that are not above 0: the light has gone. A way back through a gap takes fewer
_ROUNDS, _TURNS, _POLISHES = 6, 4, 4  # at most: over all axes; to stop at a maximum; of single axes after a round


@dataclass(frozen=True, slots=True)
class Reading:
    """A mean and its standard error."""

    value: float
    error: float

    def above(self, other: "Reading") -> bool:
        """True if it is larger beyond the noise of both."""
        return self.value - other.value > _SURE * math.hypot(self.error, other.error)


@dataclass(slots=True)
class Sweep:
    """What a sweep has seen. rose: the best was not at its begin. stayed: the signal has not changed at all.

    bounded: it came to the limit of an axis. stops: it is to stop at a known maximum.
    """

    begin: Reading
    best: Reading
    last: Reading
    rose: bool = False
    stayed: bool = True
    bounded: bool = False
    stops: bool = False
    fall: float = FALL
    beside: list[float] = field(default_factory=lambda: [0.0, 0.0])  # the signal before and after the best

    def height(self) -> Reading:
        """The maximum between the pulses: that of a Gaussian through the best and the two beside it."""
        if min(*self.beside, self.best.value) <= 0:
            return self.best
        low, high = (math.log(each / self.best.value) for each in self.beside)
        if low + high >= 0:
            return self.best
        rise = (high - low) ** 2 / (-8 * (low + high))
        return Reading(self.best.value * math.exp(min(rise, NEAR * 5)), self.best.error)

    def led(self) -> bool:
        """True if it went over a maximum. Down a ridge the signal hardly rises before it falls."""
        return self.best.value > (1 + self.fall / 3) * self.begin.value


@dataclass
class Maximum:
    """What maximise() has done. Signals in the source's unit. ways: for each axis, the net way in steps, by its drive.

    reached: at the end the signal was within 4 % of the best seen, the last round had gained little, and no axis had
    come to its limit (bounded: those that had).
    """

    begin: float = math.nan
    best: float = -math.inf
    end: float = math.nan
    ways: dict[str, float] = field(default_factory=dict)
    pulses: int = 0
    seconds: float = 0.0
    reached: bool = False
    bounded: list[str] = field(default_factory=list)

    def _repr_html_(self) -> str:
        goal = "reached" if self.reached else "NOT reached"
        signals = [(name, f"{getattr(self, name):.4g}") for name in ("begin", "best", "end")]
        ways = [(f"way of {name}, steps", f"{way:+.2f}") for name, way in self.ways.items()]
        limits = [("at the limit", ", ".join(self.bounded))] if self.bounded else []
        counts = [("pulses", self.pulses), ("seconds", f"{self.seconds:.0f}")]
        return html_table(("signal", ""), [("maximum", goal), *signals, *ways, *limits, *counts])

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {"reached": self.reached, "begin": self.begin, "best": self.best, "end": self.end} | {
            "ways": {name: round(way, 2) for name, way in self.ways.items()},
            "pulses": self.pulses,
            "seconds": round(self.seconds, 3),
            "bounded": self.bounded,
        }


def maximise(
    table: LoopTable,
    read: Callable[[], float],
    listen: Listen = silent,
    *,
    axes: Sequence[str] = (),
    limit_steps: float = LIMIT_STEPS,
    full_scale: float = math.inf,
    found: Maximum | None = None,
) -> Maximum:
    """Maximise what read() returns. Motors are off at the end, however it comes.

    read: returns one reading; it may take its time, which is the table's. axes: names of actuators; none: all.
    limit_steps: no axis is driven further from where it begins. full_scale: what read() returns when it is saturated.
    found: is filled while it goes on, for whoever wants to know after an error.
    Raises SignalNotANumber, SignalSaturated, SignalDark (the axes change nothing), what read() raises, MountError.
    """
    found = found or Maximum()
    begin_s = table.now_s()
    work = _Maximising(table, read, listen, found, axes, limit_steps, full_scale)
    listen(StateChanged(begin_s, ALIGNING, "until the signal is at its maximum"))
    try:
        work.run()
    except BaseException:
        with contextlib.suppress(MountError):  # what comes first is told
            table.stop()
        raise
    finally:
        found.seconds = table.now_s() - begin_s
    table.stop()
    listen(StateChanged(table.now_s(), ENDED, ""))
    return found


def _change(a: Reading, b: Reading) -> float:
    return abs(a.value - b.value) / max(abs(a.value), abs(b.value), 1e-300)


Step = Callable[[int, Sweep], Reading | None]  # goes one way (1, -1) by a little; None: it cannot


@dataclass(slots=True)
class _Shaft:
    """Of one axis. us: length of its pulses now; mark, count: the signal where they last changed or it did, and how
    many have come since. way: of the last one. tried: in which a maximum is sought first. at_us: net drive.

    since_us, before, follows: since its last reversal: its drive, the signal then, and whether that has changed since.
    gaps_us: what the last three reversals took.
    """

    us: int = _FIRST_US
    way: int = 0
    tried: int = 1
    at_us: int = 0
    since_us: int = 0
    before: Reading = Reading(0.0, 0.0)
    follows: bool = False
    gaps_us: list[int] = field(default_factory=list)
    count: int = 0
    mark: Reading | None = None

    def gap_us(self) -> int:
        """The median of the last three reversals, the larger one of two: drift may look like a contact."""
        return sorted(self.gaps_us)[len(self.gaps_us) // 2] if self.gaps_us else 0


class _Maximising:
    def __init__(
        self,
        table: LoopTable,
        read: Callable[[], float],
        listen: Listen,
        found: Maximum,
        axes: Sequence[str],
        limit_steps: float,
        full_scale: float,
    ) -> None:
        self.table, self.read, self.listen, self.found = table, read, listen, found
        names = [actuator.name for actuator in table.actuators]
        self.axes = [i for i, name in enumerate(names) if not axes or name in axes]
        self.names = names
        self.step_us = [actuator.step_us for actuator in table.actuators]
        self.limit_us = [limit_steps * us for us in self.step_us]
        self.full_scale = full_scale
        self.mover = Mover(table, None, listen)
        self.shafts = [_Shaft() for _ in names]
        self.now = Reading(math.nan, 0.0)
        self.sense: dict[tuple[int, int], int] = {}  # 1: the same way of both axes goes along the ridge; -1: opposite
        self.fall = FALL
        self.last = -1  # the axis that was driven last
        self._full = self._dark = 0  # readings at the end of the range, means not above 0, in a row
        self._scatter = 0.0  # square of the readings' relative standard deviation

    def run(self) -> None:
        """All rounds. Fills found."""
        found = self.found
        found.begin = self.look().value
        self.check_light(1)
        pairs = self.pairs()
        alone = [j for j in self.axes if j not in [i for i, _ in pairs]]  # the first mount is moved along ridges only
        gained = True
        for number in range(_ROUNDS):
            before = found.best
            self.fall = FALL if gained else FALL / 2  # near the maximum drift does less
            if not number or not pairs:
                answers = [self.axis_to_top(j) for j in alone]
                if not number and not any(answers):
                    raise SignalDark(f"the signal stays at {self.now.value:.4g}, whichever axis is driven")
            for pair in pairs:
                self.ridge(*pair)
            gained = found.best > (1 + 2 * FALL) * before
            self.fall = FALL / 3
            for j in itertools.islice(itertools.cycle(alone), _POLISHES):
                if gained or self.left() < 2 * NEAR or found.bounded:
                    break
                self.axis_to_top(j)
            self.check_light(1)
            # the next round will gain less than this one has
            grew = found.best / before - 1
            found.reached = not found.bounded and self.left() < (4 if grew < 2 * NEAR else 2) * NEAR
            if found.bounded or (found.reached and grew < FALL / 2):
                break

    def check_light(self, most: int) -> None:
        """Raises SignalDark if so many means in a row are not above 0 beyond their noise: no light, or dBm."""
        if self._dark >= most:
            value, error = self.now.value, self.now.error
            raise SignalDark(f"the signal is {value:.3g} with an error of {error:.1g}, which is not above 0")

    def left(self) -> float:
        """The part of the best that is not there now."""
        return 1 - self.now.value / self.found.best

    def pairs(self) -> list[tuple[int, int]]:
        """Axes of one direction of two mounts, in the order of the beam."""
        words = [name.rpartition(".")[2] for name in self.names]
        return [(i, j) for i in self.axes for j in self.axes if i < j and words[i] == words[j]]

    # ---- one pulse, one mean

    def look(self, near: float = 0.0) -> Reading:
        """The mean of as many readings as it needs: few, unless it is nearly as large as `near`.

        Raises SignalNotANumber, SignalSaturated.
        """
        values: list[float] = []
        while True:
            value = float(self.read())
            if not math.isfinite(value):
                raise SignalNotANumber(f"the signal is {value}, no number")
            self._full = self._full + 1 if value >= self.full_scale else 0
            if self._full >= _MOST:
                raise SignalSaturated(f"{_MOST} readings in a row are at the end of the range, {self.full_scale:g}")
            values.append(value)
            count = len(values)
            if count < _LEAST:
                continue
            mean = math.fsum(values) / count
            scatter = math.fsum((each - mean) ** 2 for each in values) / (count - 1)
            if self._scatter:  # a few do not tell it alone; from mean to mean it is the same part of the signal
                scatter += (self._scatter * mean**2 - scatter) * _MOST / (_MOST + count)
            error = math.sqrt(scatter / count)
            fine = mean >= (1 - FALL / 2) * near
            if count >= _MOST or error <= (_PRECISION if fine else _COARSE) * abs(mean):
                break
        self._scatter = scatter / mean**2 if mean else 0.0
        self.now = Reading(mean, error)
        self.found.best, self.found.end = max(self.found.best, mean), mean
        self.listen(SignalRead(self.table.now_s(), mean, error))
        self._dark = 0 if self.now.above(Reading(0.0, 0.0)) else self._dark + 1
        self.check_light(_DARK)
        return self.now

    def pulse(self, i: int, way: int, sweep: Sweep) -> Reading | None:
        """One pulse of an axis for a sweep, and a mean. None where it would go beyond the limit.

        The first one after a reversal is longer: it crosses most of the gap, as wide as it was last time. The next one
        is longer where the signal rises slowly, but not within the gap, where only the laser's drift is seen.
        """
        shaft = self.shafts[i]
        us = shaft.us
        if shaft.way != way:
            us = max(us, min(round(_GAP_PART * shaft.gap_us()), 2_000_000))
            shaft.since_us, shaft.before, shaft.follows = 0, self.now, False
            shaft.count, shaft.mark = 0, None
        if abs(shaft.at_us + way * us) > self.limit_us[i]:
            if self.names[i] not in self.found.bounded:
                self.found.bounded.append(self.names[i])
            return None
        shaft.way, self.last = way, i
        shaft.at_us += way * us
        shaft.since_us += us
        self.found.ways[self.names[i]] = shaft.at_us / self.step_us[i]
        self.found.pulses += 1
        self.mover.measure_pulses({i: way * us})
        before, after = self.now, self.look(sweep.best.value)
        if not shaft.follows and _change(shaft.before, after) > self.fall:
            shaft.follows = True
            shaft.gaps_us = [*shaft.gaps_us[-2:], shaft.since_us]
        if _change(before, after) > _FAST:
            shaft.us = max(SHORTEST_US, shaft.us // 2)
        elif shaft.mark is None or not shaft.follows or _change(shaft.mark, after) > FALL / 2:
            shaft.count, shaft.mark = 0, after
        elif shaft.count >= _SLOW:
            shaft.us = min(self.step_us[i], shaft.us * 2)
            shaft.count, shaft.mark = 0, after
        shaft.count += 1
        return after

    # ---- sweeps

    def sweep(
        self, step: Step, way: int, begin: Reading, known: float = 0.0, left: float = 0.0, most_s: float = math.inf
    ) -> Sweep:
        """Go one way until the maximum is passed, or the signal stays for most_s of drive, or at a limit.

        known: a maximum that lies in this way; before the signal is near it, a fall is the laser's drift. left: stop
        where only this part of it is left (0: do not stop there); then a smaller fall tells that it was passed.
        """
        seen = Sweep(begin, begin, begin, stops=left > 0, fall=self.fall)
        begin_s = self.mover.motor_s
        until = (1 - left) * known if left else math.inf
        while True:
            reading = step(way, seen)
            if reading is None:
                seen.bounded = True
                break
            before, seen.last = seen.last, reading
            if before is seen.best:
                seen.beside[1] = reading.value
            if reading.value > seen.best.value:
                seen.best, seen.beside = reading, [before.value, 0.0]
            seen.stayed &= _change(begin, reading) < self.fall / 2 or not (reading.above(begin) or begin.above(reading))
            seen.rose |= seen.best.value > (1 + self.fall) * begin.value and seen.best.above(begin)
            fall = min(_BACK, self.fall) if left else self.fall
            if seen.best.value < (1 - self.fall) * known:
                fall = _LOST
            fell = reading.value < (1 - fall) * seen.best.value and seen.best.above(reading)
            if reading.value >= until or (fell and self.shafts[self.last].follows):
                break
            if seen.stayed and self.mover.motor_s - begin_s > most_s:
                break
        return seen

    def to_top(self, step: Step, way: int, begin: Reading, near: float, most_s: float = math.inf) -> int:
        """Find the maximum along one way and its opposite, and stop there, but for a part `near`.

        begin: the signal, or a ridge's height, at the begin. Returns the way it lay in; 0: the signal stays.
        """
        seen = self.sweep(step, way, begin, most_s=most_s)
        if not (rose := seen.rose):
            first, way = seen, -way
            seen = self.sweep(step, way, first.last, first.best.value, most_s=most_s)
            if first.stayed and seen.stayed:
                return 0
            if not (rose := seen.rose) and first.best.value > seen.best.value:
                seen.best = first.best
        found = way
        for turn in range(1, _TURNS + 1):
            left = turn * near if rose else FALL / 2
            if seen.last.value >= (1 - left) * seen.best.value or (seen.bounded and (turn > 1 or not rose)):
                break  # a limit is in the way to the maximum: the other way only loses light
            way = -way
            seen = self.sweep(step, way, seen.last, seen.best.value, left, most_s)
        return found

    def axis_to_top(self, i: int) -> bool:
        """As to_top(), of one axis. False: it changes nothing."""
        shaft = self.shafts[i]

        def step(way: int, sweep: Sweep) -> Reading | None:
            if sweep.last is sweep.begin and sweep.stops:  # a way back is made in shorter pulses
                shaft.us = max(SHORTEST_US, shaft.us // 2)
            return self.pulse(i, way, sweep)

        found = self.to_top(step, shaft.tried, self.now, NEAR, _GAP_STEPS * self.step_us[i] * 1e-6)
        shaft.tried = found or shaft.tried
        return found != 0

    def over(self, i: int, way: int, fall: float = FALL) -> Sweep:
        """A sweep of one axis, within one along a ridge. The smaller its fall, the shorter its way along the ridge."""
        before, self.fall = self.fall, fall
        most_s = _GAP_STEPS * self.step_us[i] * 1e-6
        seen = self.sweep(lambda w, seen: self.pulse(i, w, seen), way, self.now, most_s=most_s)
        self.fall = before
        return seen

    def ridge(self, i: int, j: int) -> None:
        """The maximum along the ridge of two axes that do nearly the same, and that of j."""

        def step(way: int, sweep: Sweep) -> Reading | None:
            """Each axis goes over its maximum once. The height of the ridge there."""
            ways = {j: way, i: self.sense[i, j] * way}
            # the other one than before; after a reversal the same one, which has gone over its maximum
            first, second = (j, i) if (self.last == i) == (self.shafts[i].way == ways[i]) else (i, j)
            fall = FALL / 3 if sweep.stops else FALL
            sweeps = self.over(first, ways[first], fall), self.over(second, ways[second], fall)
            if any(each.bounded for each in sweeps) or all(each.stayed for each in sweeps):
                return None
            if not any(each.led() for each in sweeps):
                self.sense[i, j] *= -1  # neither has led over a maximum
            return max((each.height() for each in sweeps), key=lambda reading: reading.value)

        height = self.now
        if (i, j) not in self.sense:
            self.over(j, 1)
            self.sense[i, j] = 1 if self.over(i, 1).led() else -1
        self.to_top(step, 1, height, NEAR)
        shaft = self.shafts[j]
        shaft.tried = shaft.way if self.last == i else -shaft.way  # back from where the last one has gone over the top
        self.axis_to_top(j)
