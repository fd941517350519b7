"""The mechanics of a virtual mount: its profile, the actuators, and the encoders on them.

`smooth` is kind and gives the paper's figures; `rough` is a mount of hobby parts. Every number of `rough` is assumed: a
trial on paper-size models found its results insensitive to them. docs/virtual-board.md has both in one table.

The gap is the play of the gears and that of the coupler; the gearbox's output shaft is between the two.
The motion between two changes of the drive is solved in closed form, so there is no time step to choose.
Units: seconds; revolutions of the gearbox's output shaft, also for the motor in front of it.

Encoders tell the board each change at its true microsecond.
motor: a magnetic disc with two Hall sensors on the motor's rear shaft, before the gears, wires A and B in quadrature.
shaft: an AS5600 with a magnet on the gearbox's output shaft, on an I2C bus: 12 bits, absolute within a turn.
Both are functions of the actuator's angles alone; a fault changes what the wires carry, not the motion.
"""

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

# ---- the profile of a mount


@dataclass(frozen=True)
class Profile:
    """What differs between kind and real mechanics. Fractions are of 1, times in seconds."""

    name: str
    pulse_noise: float  # relative spread of the speed from pulse to pulse, one standard deviation
    short_noise: float = 0.0  # further spread of a pulse of length 0 ...
    short_s: float = 0.02  # ... which fades with the pulse's length T as exp(-T / short_s)
    breakaway_s: float = 0.0  # from the begin of a drive at rest to the first motion: mean ...
    breakaway_spread_s: float = 0.0  # ... and standard deviation
    negative_slower: float = 0.0  # how much slower the negative direction is
    periodic: float = 0.0  # amplitude of the mirror's speed over one turn of the screw
    gap_spread: float = 0.0  # relative spread of the gap from reversal to reversal
    loose_start: bool = False  # the shaft starts anywhere in the gap, not in its middle
    creep: float = 0.0  # share of a motion that comes later ...
    creep_s: float = 1.0  # ... with this time constant
    supply: float = 1.0  # the motors' voltage, of the nominal one: the speed is proportional to it

    def warped(self, screw_rev: float, phase_rad: float) -> float:
        """The turn, in revolutions, to which the mirror has followed a screw with a periodic error."""
        if not self.periodic:
            return screw_rev
        turn = 2 * math.pi
        wave = math.sin(turn * screw_rev + phase_rad) - math.sin(phase_rad)
        return screw_rev + self.periodic / turn * wave


SMOOTH = Profile("smooth", pulse_noise=0.005)  # assumed
ROUGH = Profile(
    "rough",
    pulse_noise=0.05,
    short_noise=0.25,
    breakaway_s=3e-3,
    breakaway_spread_s=1.5e-3,
    negative_slower=0.15,
    periodic=0.10,
    gap_spread=0.03,
    loose_start=True,
    creep=0.01,
    creep_s=15.0,
)
PROFILES = {profile.name: profile for profile in (SMOOTH, ROUGH)}


# The paper gives none of these. A profile has what differs between mounts.
SPEED_REV_S = 0.125  # a 1000:1 gearmotor of 14 rpm at 6 V, with what the bridge leaves of 5 V
SPIN_UP_S = 0.02  # time constant of a motor under drive; assumed
COAST_S = 0.02  # time constant of viscous friction without drive; assumed
COAST_REV_S2 = 5.0  # deceleration by dry friction without drive; assumed
PITCH_MM = 25.4 / 80  # a fine adjustment screw of 80 threads an inch; assumed
GAP_REV = 0.03481  # play between shaft and screw: fitted, with the levers of bench.py, to step and backlash
GEAR_SHARE = 0.4  # of that gap is in the gears, 5 degrees; the rest is in the coupler; assumed
TRAVEL_REV = 12.0  # hard ends of the screw either way; assumed
SWITCH_REV = 1.5  # where the optional switches sit, either way; about 64 steps
_TOUCHES = 1e-9  # of half a gap: rounding, by which a shaft in contact may seem to be apart
_MOST_SIGMA = 3.0  # of a pulse's scatter: a pulse of normal length never turns the shaft backwards


# ---- the actuator


@dataclass
class Drivetrain:
    """One motor with gearbox, gap and screw. Constants first, then the state."""

    lever_mm: float
    gap_rev: float = GAP_REV
    pitch_mm: float = PITCH_MM
    speed_rev_s: float = SPEED_REV_S
    noise: float = SMOOTH.pulse_noise  # relative spread of the speed from pulse to pulse
    travel_rev: float = TRAVEL_REV
    profile: Profile = SMOOTH
    phase_rad: float = 0.0  # of the periodic error, with the screw at 0
    shaft_rev: float = 0.0
    screw_rev: float = 0.0
    rev_s: float = 0.0
    pull: float = field(default=1.0, repr=False)  # this pulse's share of the noise
    late_rev: float = field(default=0.0, repr=False)  # the screw's turn that creep has followed
    held_s: float = field(default=0.0, repr=False)  # until this pulse breaks the motor away
    pulse_s: float = field(default=0.0, repr=False)  # this pulse's drive so far
    meant_rev: float = field(default=0.0, repr=False)  # this pulse's turn so far, without the scatter of short pulses
    made_rev: float = field(default=0.0, repr=False)  # with it
    short: float = field(default=0.0, repr=False)  # this pulse's scatter at length 0
    ahead: float = field(default=1.0, repr=False)  # the gap's half towards positive, of gap_rev / 2
    behind: float = field(default=1.0, repr=False)  # towards negative
    output_rev: float = field(default=0.0, repr=False)  # the gearbox's output shaft; shaft_rev is the motor's turn
    hand_rev_s: float = field(default=0.0, repr=False)  # a hand turns the screw's knob so fast ...
    hand_s: float = field(default=0.0, repr=False)  # ... for so long still
    jammed: bool = field(default=False, repr=False)  # the screw does not turn: a motor that drives it stalls

    @classmethod
    def new(cls, lever_mm: float, profile: Profile, noise: np.random.Generator) -> "Drivetrain":
        """A drivetrain whose places nobody knows, where the profile says so, are drawn from noise."""
        train = cls(lever_mm, noise=profile.pulse_noise, profile=profile)
        if profile.periodic:
            train.phase_rad = float(noise.uniform(0, 2 * math.pi))
        if profile.loose_start:
            train.shaft_rev = train.gap_rev * float(noise.uniform(-0.5, 0.5))
            train.output_rev = train.shaft_rev * (1 - GEAR_SHARE)
        return train

    def begin(self, drive: float, noise: np.random.Generator) -> None:
        """A drive begins: draw what differs from pulse to pulse."""
        z = float(noise.standard_normal())
        profile = self.profile
        if profile.short_noise:
            z = min(max(z, -_MOST_SIGMA), _MOST_SIGMA)
            self.short = z * profile.short_noise
            self.pulse_s = self.meant_rev = self.made_rev = 0.0
        self.pull = 1 + self.noise * z
        if profile.breakaway_s:
            held = abs(profile.breakaway_s + profile.breakaway_spread_s * float(noise.standard_normal()))
            self.held_s = held if not self.rev_s else 0.0
        if profile.gap_spread:
            self._new_contact(drive, math.sqrt(2) * profile.gap_spread * float(noise.standard_normal()))

    def _new_contact(self, drive: float, deviation: float) -> None:
        """Where the shaft will meet the screw, unless it does already. Each gap has two such contacts."""
        half = self.gap_rev / 2
        place = (self.shaft_rev - self.screw_rev) / half if half else 1.0
        if drive > 0 and place < self.ahead - _TOUCHES:
            self.ahead = max(1 + deviation, place)
        elif drive < 0 and -place < self.behind - _TOUCHES:
            self.behind = max(1 + deviation, -place)

    def advance(self, dt: float, drive: float | None) -> None:
        """Move on by dt seconds; drive -1 ... 1 of full speed (0 brakes), None: coasting."""
        screw, whole = self.screw_rev, dt
        if self.hand_s:
            self._by_hand(dt)
        if drive and self.held_s and not self.rev_s:
            held = min(dt, self.held_s)
            self.held_s -= held
            self.pulse_s += held
            dt -= held
        if drive is not None:
            target = drive * self.speed_rev_s * self.pull * self.profile.supply
            if drive < 0:
                target *= 1 - self.profile.negative_slower
            if self.rev_s * (target - self.rev_s) < 0 and self.rev_s * target <= 0:
                # it turns round (or comes to rest) on the way: the gap must see the farthest point
                turn = SPIN_UP_S * math.log((self.rev_s - target) / -target) if target else math.inf
                if turn < dt:
                    self._driven(turn, target)
                    self.rev_s = 0.0
                    dt -= turn
            self._driven(dt, target)
        elif self.rev_s:
            self._coasting(dt)
        if self.profile.creep:
            # exact for a screw at rest; in a motion, which is short beside creep_s, its mean place counts
            mean = (screw + self.screw_rev) / 2
            self.late_rev = mean + (self.late_rev - mean) * math.exp(-whole / self.profile.creep_s)

    def _driven(self, dt: float, target: float) -> None:
        fade = math.exp(-dt / SPIN_UP_S)
        excess = self.rev_s - target
        self.rev_s = target + excess * fade
        self.pulse_s += dt
        self._turn(target * dt + excess * SPIN_UP_S * (1 - fade))

    def _coasting(self, dt: float) -> None:
        way, speed = math.copysign(1.0, self.rev_s), abs(self.rev_s)
        floor = COAST_REV_S2 * COAST_S
        rest = self.coast_s
        t = min(dt, rest)
        fade = math.exp(-t / COAST_S)
        self.rev_s = 0.0 if t == rest else way * ((speed + floor) * fade - floor)
        self._turn(way * ((speed + floor) * COAST_S * (1 - fade) - floor * t))

    def _turn(self, rev: float) -> None:
        if self.short:
            # a pulse as a whole is scattered by its length: its turn so far is the function of its length so far
            self.meant_rev += rev
            made = self.meant_rev * (1 + self.short * math.exp(-self.pulse_s / self.profile.short_s))
            rev, self.made_rev = made - self.made_rev, made
        self.shaft_rev += rev
        half = self.gap_rev / 2
        # the screw follows the shaft with play, up to its hard ends; there the motor stalls
        before = self.screw_rev
        screw = min(max(before, self.shaft_rev - half * self.ahead), self.shaft_rev + half * self.behind)
        self.screw_rev = before if self.jammed else min(max(screw, -self.travel_rev), self.travel_rev)
        if screw != self.screw_rev:
            self.shaft_rev = self.screw_rev + (half * self.ahead if screw > self.screw_rev else -half * self.behind)
            self.rev_s = 0.0
        self._follow()

    def _follow(self) -> None:
        """The output shaft stays within the gears' play of the motor and within the coupler's of the screw."""
        gears = self.gap_rev / 2 * GEAR_SHARE
        coupler = self.gap_rev / 2 - gears
        output = min(max(self.output_rev, self.shaft_rev - gears * self.ahead), self.shaft_rev + gears * self.behind)
        self.output_rev = min(
            max(output, self.screw_rev - coupler * self.behind), self.screw_rev + coupler * self.ahead
        )

    def _by_hand(self, dt: float) -> None:
        """A hand turns the screw, and through both plays the motor behind it."""
        turned = min(dt, self.hand_s)
        self.hand_s -= turned
        screw = self.screw_rev + self.hand_rev_s * turned
        self.screw_rev = min(max(screw, -self.travel_rev), self.travel_rev)
        half = self.gap_rev / 2
        least, most = self.screw_rev - half * self.behind, self.screw_rev + half * self.ahead
        self.shaft_rev = min(max(self.shaft_rev, least), most)
        self._follow()

    @property
    def coast_s(self) -> float:
        """How long it turns on without a drive."""
        return COAST_S * math.log(1 + abs(self.rev_s) / (COAST_REV_S2 * COAST_S))

    def is_still(self, drive: float | None) -> bool:
        """True if nothing moves, as long as the drive is this one."""
        return not self.rev_s and not self.hand_s and not drive

    def far_from_switch(self, us: int) -> bool:
        """True if no switch can be reached within us microseconds, however it is driven."""
        fastest = 1.1 + _MOST_SIGMA * (self.noise + self.profile.short_noise)
        reach = fastest * max(1.0, self.profile.supply) * self.speed_rev_s * us * 1e-6
        return abs(abs(self.screw_rev) - SWITCH_REV) > reach

    @property
    def mirror_rad(self) -> float:
        """The angle by which the screw has turned the mirror, in radians."""
        screw = self.screw_rev - self.profile.creep * (self.screw_rev - self.late_rev)
        return self.profile.warped(screw, self.phase_rad) * self.pitch_mm / self.lever_mm


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


# ---- the encoder


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
