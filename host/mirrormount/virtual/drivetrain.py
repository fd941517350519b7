"""One actuator of a mount: motor, gearbox, gap, screw, and the angle by which it turns the mirror.

The gap is the play of the gears and that of the coupler; the gearbox's output shaft is between the two.
The motion between two changes of the drive is solved in closed form, so there is no time step to choose.
Units: seconds; revolutions of the gearbox's output shaft, also for the motor in front of it.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from mirrormount.virtual.profile import SMOOTH, Profile

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
