"""Encoders of the bench: what they tell the board, each change at its true microsecond.

motor: a magnetic disc with two Hall sensors on the motor's rear shaft, before the gears, wires A and B in quadrature.
shaft: an AS5600 with a magnet on the gearbox's output shaft, on an I2C bus: 12 bits, absolute within a turn.
Both are functions of the drivetrain's angles alone; a fault changes what the wires carry, not the motion.
"""

import math
from bisect import bisect_right
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mirrormount.virtual.drivetrain import Drivetrain

GEARS = 986.41  # of the paper's motor, Pololu #1595
EDGES_A_TURN = 12  # of its rear shaft: a disc of six poles, two sensors
COUNTS_A_REV = {"motor": GEARS * EDGES_A_TURN, "shaft": 4096.0}
KINDS = tuple(COUNTS_A_REV)
OF_WIRES = ("lost", "swapped", "broken", "noise")  # faults of what the wires carry
FAULTS = (*OF_WIRES, "hand", "jammed")
LOST = 0.01  # of the edges
NOISE_HZ = 50.0  # spikes a second on the wires
SPIKE_US = 3
NOISE_BITS = 2  # of an angle of 4096: the most that it is off
NO_ANSWER = 0xFFFF  # of the I2C bus
_LOOK_US = 1000  # the motion is looked at so often; what happens in between is found by secants
_QUADRATURE = ((0, 0), (1, 0), (1, 1), (0, 1))  # A leads where the count rises

Wires = tuple[int, ...]  # the levels of A and B, or the angle that the bus tells


class Change(NamedTuple):
    """What the wires carry from a time on."""

    us: int
    counts: int
    wires: Wires


class Encoder:
    """One encoder on a drivetrain. `faults` holds those that are ordered; Bench.disturb() sets them."""

    def __init__(self, train: Drivetrain, kind: str, us: int, noise: np.random.Generator) -> None:
        self.kind = kind
        self.faults: set[str] = set()
        self._train = train
        self._noise = noise
        self._start = float(noise.uniform(0, COUNTS_A_REV[kind]))  # nobody knows how the disc was put on
        self._us = us  # known up to here
        self._lead: Drivetrain | None = None  # the train at that time, if no drive changes; None: as it is
        self._next_spike_us = us
        self._changes = [Change(us, self.count(train), self._wires(self.count(train)))]

    def count(self, train: Drivetrain) -> int:
        """The count at the angles of a train, from an arbitrary zero."""
        return math.floor(self._position(train))

    @property
    def knows_us(self) -> int:
        """Up to when the changes are known, if no drive changes."""
        return self._us

    def at(self, us: int) -> Wires:
        """What the wires carry at that time."""
        return self._changes[max(0, bisect_right(self._changes, us, key=_time) - 1)].wires

    def between(self, after_us: int, until_us: int) -> list[Change]:
        """The changes after one time, up to another."""
        first = bisect_right(self._changes, after_us, key=_time)
        return self._changes[first : bisect_right(self._changes, until_us, key=_time)]

    def forget(self, before_us: int) -> None:
        """Changes before that time will not be asked for any more."""
        del self._changes[: max(0, bisect_right(self._changes, before_us, key=_time) - 1)]

    def cut(self, us: int) -> None:
        """At that time, which the train has reached, the drive changes or a fault begins: what was to come is void."""
        del self._changes[max(1, bisect_right(self._changes, us, key=_time)) :]
        self._lead, self._us = None, us
        if "noise" in self.faults:
            self.again()  # a spike may be cut off in its middle

    def again(self) -> None:
        """The wires carry from now on what the faults say."""
        self._next_spike_us = self._us
        self._add(self._us, self._changes[-1].counts, whole=True)

    def extend(self, until_us: int, drive: float | None) -> None:
        """Find the changes up to a time, with the drive that there is."""
        lead = self._lead or _copy(self._train)
        count = self.count(lead)
        if count != self._changes[-1].counts:  # a cut fell on the very microsecond of a change
            self._add(self._us, count)
        noise = "noise" in self.faults
        while self._us < until_us:
            if noise and self._us >= self._next_spike_us:
                self._spike()
            us = (min(until_us, self._next_spike_us) if noise else until_us) - self._us
            if not lead.is_still(drive):
                us = min(us, _LOOK_US)
                after = _after(lead, us, drive)
                if self.count(after) != self._changes[-1].counts:
                    self._find(lead, after, us, drive)
                lead = after
            self._us += us
        self._lead = lead

    def _position(self, train: Drivetrain) -> float:
        rev = train.shaft_rev if self.kind == "motor" else train.output_rev
        return rev * COUNTS_A_REV[self.kind] + self._start

    def _find(self, lead: Drivetrain, after: Drivetrain, us: int, drive: float | None) -> None:
        """The changes between two looks."""
        last, count = self.count(after), self._changes[-1].counts
        way = 1 if last > count else -1
        low, high = (0.0, self._position(lead)), (float(us), self._position(after))
        while count != last:
            edge = count + 1 if way > 0 else count  # the position at which the count changes
            low = _crossing(low, high, edge, lambda t: self._position(_after(lead, t, drive)))
            count += way
            self._add(self._us + round(low[0]), count)

    def _add(self, us: int, count: int, *, whole: bool = False) -> None:
        apart = "noise" in self.faults and not whole  # the end of a spike is an edge of its own
        us = max(us, self._changes[-1].us + apart)
        wires = self._wires(count)
        if "lost" in self.faults and self.kind == "motor" and not whole and self._noise.random() < LOST:
            wires = self._changes[-1].wires
        self._changes.append(Change(us, count, wires))

    def _wires(self, count: int) -> Wires:
        if self.kind == "shaft":
            if "broken" in self.faults:
                return (NO_ANSWER,)
            off = int(self._noise.integers(-NOISE_BITS, NOISE_BITS, endpoint=True)) if "noise" in self.faults else 0
            return ((-count if "swapped" in self.faults else count) + off & 4095,)
        if "broken" in self.faults:
            return (1, 1)  # both wires are off: pulled up
        a, b = _QUADRATURE[count & 3]
        return (b, a) if "swapped" in self.faults else (a, b)

    def _spike(self) -> None:
        """A short pulse on one wire, and the count is as it was; of an angle, another reading."""
        self._next_spike_us = self._us + 1 + round(float(self._noise.exponential(1e6 / NOISE_HZ)))
        us, (last_us, count, wires) = self._us, self._changes[-1]
        if self.kind == "shaft":
            self._add(us, count)
        elif last_us < us:
            self._changes.append(Change(us, count, (1 - wires[0], wires[1])))
            self._changes.append(Change(us + SPIKE_US, count, wires))


def _time(change: Change) -> int:
    return change.us


def _copy(train: Drivetrain) -> Drivetrain:
    """The same state; dataclasses.replace() would take four times as long."""
    copy = object.__new__(Drivetrain)
    copy.__dict__.update(train.__dict__)
    return copy


def _after(train: Drivetrain, us: float, drive: float | None) -> Drivetrain:
    copy = _copy(train)
    copy.advance(us * 1e-6, drive)
    return copy


def _crossing(
    low: tuple[float, float], high: tuple[float, float], edge: float, position: Callable[[float], float]
) -> tuple[float, float]:
    """When, in microseconds, a position passes the edge between two (time, position); to half a microsecond.

    Regula falsi, in the Illinois variant. Returns the point on high's side.
    """
    (t0, y0), (t1, y1) = (low[0], low[1] - edge), (high[0], high[1] - edge)
    side = 0
    while t1 - t0 > 0.5:
        t = t0 + (t1 - t0) * (y0 / (y0 - y1) if y0 != y1 else 0.5)
        t = min(max(t, t0 + 0.1), t1 - 0.1)
        y = position(t) - edge
        if (y < 0) == (y1 < 0):
            t1, y1 = t, y
            y0, side = (y0 / 2, 1) if side == 1 else (y0, 1)
        else:
            t0, y0 = t, y
            y1, side = (y1 / 2, -1) if side == -1 else (y1, -1)
    return t1, y1 + edge
