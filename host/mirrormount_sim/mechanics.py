"""The mechanics of a virtual mount: the motor at its bridge, the actuators, and the encoders on them.

profiles.py has what differs between mounts: `smooth`, `rough` and `hardware` are the same equations with other numbers.
The gap is the play of the gears and that of the coupler; the gearbox's output shaft is between the two.
The motion between two changes of the drive is solved in closed form, so there is no time step to choose.
Units: seconds; revolutions of the gearbox's output shaft, also for the motor in front of it. Voltages, currents and
torques of the motor are shares of those at full duty and nominal supply with the rotor stalled.

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

from mirrormount_sim.profiles import (
    DETENTS_REV,
    GAP_REV,
    GEAR_SHARE,
    GEARS,
    PITCH_MM,
    SMOOTH,
    SWITCH_REV,
    TRAVEL_REV,
    Profile,
)

_TOUCHES = 1e-9  # of half a gap: rounding, by which a shaft in contact may seem to be apart
_MOST_SIGMA = 3.0  # of a pulse's scatter: a pulse of normal length never turns the shaft backwards
_KICK_S = 3e-3  # a pulse that is longer lifts the rotor over half a detent before it ends (at full torque: 3 to 4 ms)


# ---- the motor at its bridge


class Pwm(NamedTuple):
    """How the bridge makes a duty: slow decay short-circuits the motor in the pauses, fast decay opens the bridge."""

    hz: int = 0
    slow: bool = True


def mean_current(duty: float, emf: float, pwm: Pwm, electrical_s: float) -> float:
    """The motor's mean current over a period of the PWM, for an emf that is the same share of the full voltage.

    Slow decay, a full duty, or a motor without inductance: duty less emf. Fast decay: the diodes return the current to
    the supply, against its voltage, until there is none left; that costs torque the more, the shorter the period is
    beside electrical_s.
    """
    if pwm.slow or not pwm.hz or not electrical_s or duty >= 1:
        return duty - emf
    period = 1 / (pwm.hz * electrical_s)
    on = duty * period
    reached = (1 - emf) * -math.expm1(-on)
    falls = min(period - on, math.log1p(max(0.0, reached) / (1 + emf)))
    return ((1 - emf) * on - (1 + emf) * falls) / period


# ---- the actuator


@dataclass
class Drivetrain:
    """One motor with gearbox, gap and screw. Constants first, then the state."""

    lever_mm: float
    gap_rev: float = GAP_REV
    pitch_mm: float = PITCH_MM
    noise: float = SMOOTH.pulse_noise  # relative spread of the speed from pulse to pulse
    travel_rev: float = TRAVEL_REV
    profile: Profile = SMOOTH
    phase_rad: float = 0.0  # of the periodic error, with the screw at 0
    gap_phase_rad: float = 0.0  # of the gap's wave
    chance: int = 0  # by which the places where the tip slips differ from train to train
    shaft_rev: float = 0.0
    screw_rev: float = 0.0
    rev_s: float = 0.0
    pwm: Pwm = field(default=Pwm(), repr=False)  # of the drive that there is
    pull: float = field(default=1.0, repr=False)  # this pulse's share of the noise
    friction: float = field(default=0.0, repr=False)  # this pulse's, a share of the stalled torque
    lacking: float = field(default=0.0, repr=False)  # the voltage that motors which started at once take from this one
    late_rev: float = field(default=0.0, repr=False)  # the screw's turn that creep has followed
    tip_rev: float = field(default=0.0, repr=False)  # the screw's turn that its sticking tip has followed
    slips: int = field(default=0, repr=False)  # of the tip so far
    twist_rad: float = field(default=0.0, repr=False)  # of the motors' plate, while this motor drives
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

    def __post_init__(self) -> None:
        profile = self.profile
        self.friction = profile.friction_v / profile.volts
        self._cogging = profile.cogging_v / profile.volts
        self._ideal_rev_s = profile.speed_rev_s / (1 - self.friction)  # without friction

    @classmethod
    def new(cls, lever_mm: float, profile: Profile, noise: np.random.Generator) -> "Drivetrain":
        """A drivetrain whose places nobody knows, where the profile says so, are drawn from noise."""
        train = cls(lever_mm, noise=profile.pulse_noise, profile=profile)
        if profile.periodic:
            train.phase_rad = float(noise.uniform(0, 2 * math.pi))
        if profile.loose_start:
            train.shaft_rev = train.gap_rev * float(noise.uniform(-0.5, 0.5))
            train.output_rev = train.shaft_rev * (1 - GEAR_SHARE)
        if profile.gap_wave:
            train.gap_phase_rad = float(noise.uniform(0, 2 * math.pi))
        if profile.stick_um:
            train.chance = int(noise.integers(1 << 62))
        return train

    def begin(self, drive: float, noise: np.random.Generator, others: float = 0.0) -> None:
        """A drive begins: draw what differs from pulse to pulse. others: the current that other motors draw now."""
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
        if profile.friction_spread:
            z = min(max(float(noise.standard_normal()), -_MOST_SIGMA), _MOST_SIGMA)
            self.friction = profile.friction_v / profile.volts * (1 + profile.friction_spread * z)
        self.lacking = profile.sag * others
        if profile.gap_spread or profile.gap_wave:
            deviation = math.sqrt(2) * profile.gap_spread * float(noise.standard_normal())
            self._new_contact(drive, deviation + profile.gap_wave * self._wave())

    def _wave(self) -> float:
        return math.sin(2 * math.pi * self.screw_rev + self.gap_phase_rad)

    @property
    def current(self) -> float:
        """What a motor at full duty draws at this speed."""
        return max(0.0, 1 - abs(self.rev_s) / self._ideal_rev_s)

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
            self._under_drive(dt, drive)
        elif self.rev_s:
            self._coasting(dt)
        self.twist_rad = math.copysign(self.profile.twist_urad * 1e-6, drive) if drive else 0.0
        self._slip()
        if self.profile.creep:
            # exact for a screw at rest; in a motion, which is short beside creep_s, its mean place counts
            mean = (screw + self.screw_rev) / 2
            self.late_rev = mean + (self.late_rev - mean) * math.exp(-whole / self.profile.creep_s)

    def _under_drive(self, dt: float, drive: float) -> None:
        while dt > 0 and (self.rev_s or self._starts(drive)):
            way = 1.0 if (self.rev_s or drive) > 0 else -1.0
            target, time_s = self._steady(drive, way)
            after = math.inf
            if self.rev_s and way * target < 0:
                # it comes to rest on the way, and may turn round: the gap must see the farthest point
                after = time_s * math.log((self.rev_s - target) / -target)
            self._driven(min(dt, after), target, time_s)
            if after <= dt:
                self.rev_s = 0.0
                self._rest()
            dt -= after

    def _starts(self, drive: float) -> bool:
        """True if the motor starts from rest: a period of the PWM that is short for the rotor counts by its mean."""
        duty = abs(drive)
        kicks = self.pwm.hz and duty / self.pwm.hz > _KICK_S
        torque = 1.0 if kicks else mean_current(duty, 0.0, self.pwm, self.profile.electrical_s)
        return bool(drive) and torque * self.profile.supply > self.friction + self._cogging

    def _steady(self, drive: float, way: float) -> tuple[float, float]:
        """The speed that a motor comes to which turns that way, and its time constant.

        The line of torque over speed goes through the torque at rest, and the speed at which friction takes it all.
        """
        profile, duty = self.profile, drive * way
        linear = duty * profile.supply - self.friction
        stalled = linear
        if duty > 0:
            stalled = profile.supply * mean_current(duty, 0.0, self.pwm, profile.electrical_s) - self.friction
        share = self._balanced(duty) if 0 < stalled != linear else stalled
        target = way * share * self._ideal_rev_s * self.pull
        if drive < 0:
            target *= 1 - profile.negative_slower
        return target, profile.spin_up_s * (share / stalled if stalled > 0 else 1.0)

    def _balanced(self, duty: float) -> float:
        """The emf at which the current's torque is the friction, by bisection."""
        supply, low, high = self.profile.supply, 0.0, self.profile.supply
        for _ in range(30):
            emf = (low + high) / 2
            torque = supply * mean_current(duty, emf / supply, self.pwm, self.profile.electrical_s)
            low, high = (emf, high) if torque > self.friction else (low, emf)
        return low

    def _driven(self, dt: float, target: float, time_s: float) -> None:
        ratio = dt / time_s
        fade = math.exp(-ratio)
        excess = self.rev_s - target
        lacking = self.lacking * target
        self.rev_s = target + (excess - lacking * ratio) * fade
        self.lacking *= fade
        self.pulse_s += dt
        self.turn(target * dt + excess * time_s * (1 - fade) - lacking * time_s * (1 - fade * (1 + ratio)))

    def _coasting(self, dt: float) -> None:
        way, speed = math.copysign(1.0, self.rev_s), abs(self.rev_s)
        viscous_s = self.profile.coast_s
        floor = self._braking * viscous_s
        rest = self.coast_s
        t = min(dt, rest)
        fade = math.exp(-t / viscous_s)
        self.rev_s = 0.0 if t == rest else way * ((speed + floor) * fade - floor)
        self.turn(way * ((speed + floor) * viscous_s * (1 - fade) - floor * t))
        if not self.rev_s:
            self._rest()

    @property
    def _braking(self) -> float:
        """What dry friction takes from the speed in a second."""
        return self.profile.coast_rev_s2 + self.friction * self._ideal_rev_s / self.profile.spin_up_s

    def _rest(self) -> None:
        """The rotor has come to rest: its magnets pull it towards a detent, as far as they overcome the friction."""
        if self._cogging <= self.friction:
            return
        place = self.shaft_rev * DETENTS_REV
        off = place - round(place)
        held = math.asin(self.friction / self._cogging) / (2 * math.pi)
        if abs(off) > held:
            self.turn((math.copysign(held, off) - off) / DETENTS_REV)

    def turn(self, rev: float) -> None:
        """The motor has turned so far."""
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
        self._slip()
        self._follow()

    def _slip(self) -> None:
        """The screw's tip sticks to the mirror's plate until it lags by a threshold, and then follows at once."""
        if not self.profile.stick_um:
            self.tip_rev = self.screw_rev
            return
        # A function of the number of slips, so that a copy of a train slips where the train itself will.
        most = 2 * self.profile.stick_um * 1e-3 / self.pitch_mm / 2**64
        while abs(lag := self.screw_rev - self.tip_rev) > (threshold := most * _scrambled(self.chance + self.slips)):
            self.tip_rev += math.copysign(threshold, lag)
            self.slips += 1

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
        viscous_s = self.profile.coast_s
        return viscous_s * math.log(1 + abs(self.rev_s) / (self._braking * viscous_s))

    def is_still(self, drive: float | None) -> bool:
        """True if nothing moves, as long as the drive is this one."""
        return not self.rev_s and not self.hand_s and not drive

    def far_from_switch(self, us: int) -> bool:
        """True if no switch can be reached within us microseconds, however it is driven."""
        fastest = 1.1 + _MOST_SIGMA * (self.noise + self.profile.short_noise)
        reach = fastest * max(1.0, self.profile.supply) * self._ideal_rev_s * us * 1e-6
        return abs(abs(self.screw_rev) - SWITCH_REV) > reach

    @property
    def mirror_rad(self) -> float:
        """The angle by which the screw has turned the mirror, in radians."""
        profile = self.profile
        tip = self.tip_rev if profile.stick_um else self.screw_rev
        rev = tip - profile.creep * (tip - self.late_rev)
        if profile.periodic:
            turn = 2 * math.pi
            rev += profile.periodic / turn * (math.sin(turn * rev + self.phase_rad) - math.sin(self.phase_rad))
        return rev * self.pitch_mm / self.lever_mm + self.twist_rad


def mirror_angles(yaw: Drivetrain, pitch: Drivetrain) -> tuple[float, float]:
    """Yaw and pitch of a mirror that two actuators turn, in radians: each has a part of the other's."""
    x, y, cross = yaw.mirror_rad, pitch.mirror_rad, yaw.profile.cross
    return x + cross * y, y + cross * x


def _scrambled(n: int) -> int:
    """64 bits that look random (the finalizer of splitmix64; Steele, Lea, Flood, OOPSLA 2014)."""
    n = (n * 0x9E3779B97F4A7C15) & 0xFFFFFFFFFFFFFFFF
    n = ((n ^ n >> 30) * 0xBF58476D1CE4E5B9) & 0xFFFFFFFFFFFFFFFF
    n = ((n ^ n >> 27) * 0x94D049BB133111EB) & 0xFFFFFFFFFFFFFFFF
    return n ^ n >> 31


# ---- encoders

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
        lead = self._lead or copied(self._train)
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


def copied(train: Drivetrain) -> Drivetrain:
    """The same state; dataclasses.replace() would take four times as long."""
    copy = object.__new__(Drivetrain)
    copy.__dict__.update(train.__dict__)
    return copy


def _after(train: Drivetrain, us: float, drive: float | None) -> Drivetrain:
    copy = copied(train)
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
