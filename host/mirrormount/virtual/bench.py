"""The optical bench: motors, gearboxes, screws with a gap, a mirror, a screen. It sees pins only.

Axis 1 tilts the mirror (the spot goes up and down), axis 2 turns it (right and left). The
motions between two pin edges are solved in closed form, so there is no time step to choose.
Units: seconds inside, microseconds at the interface; revolutions of the gearbox's output shaft;
millimetres and milliradians on the screen.

"The paper" is Gopalakrishnan and Guehr, A low-cost mirror mount control system for optics
setups. What it does not give is marked as such and chosen so that what it measured comes out.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from mirrormount.virtual.wiring import DRIVES

SCREEN_MM = 7620.0  # the paper, section III: a screen 300 inches away
STEP_S = 0.2  # the paper, section III: one step is 0.2 s at full speed
STEP_X_MRAD = 0.43  # the paper, section III
STEP_Y_MRAD = 0.47  # the paper, section III
BACKLASH_X_MRAD = 0.64  # the paper, section III
BACKLASH_Y_MRAD = 0.70  # the paper, section III

# The rest is not in the paper.
SPEED_REV_S = 0.125  # a 1000:1 gearmotor of 14 rpm at 6 V, with what the bridge leaves of 5 V
SPIN_UP_S = 0.02  # time constant of a motor under drive; assumed
COAST_S = 0.02  # time constant of viscous friction without drive; assumed
COAST_REV_S2 = 5.0  # deceleration by dry friction without drive; assumed
PITCH_MM = 25.4 / 80  # a fine adjustment screw of 80 threads an inch; assumed
INCIDENCE = math.radians(45)  # a folding mirror
GAP_REV = 0.03481  # play between shaft and screw: fitted, with the levers, to step and backlash
LEVER_X_MM = 34.524  # screw to pivot, as seen by the yaw; fitted to STEP_X_MRAD
LEVER_Y_MM = 22.341  # as seen by the pitch; fitted to STEP_Y_MRAD
PULSE_NOISE = 0.005  # relative spread of the speed from pulse to pulse; assumed
TRAVEL_REV = 12.0  # hard ends of the screw either way; assumed
SWITCH_REV = 1.5  # where the optional switches sit, either way; about 64 steps


@dataclass
class Drivetrain:
    """One motor with gearbox, gap and screw. Constants first, then the state."""

    lever_mm: float
    gap_rev: float = GAP_REV
    pitch_mm: float = PITCH_MM
    speed_rev_s: float = SPEED_REV_S
    noise: float = PULSE_NOISE
    travel_rev: float = TRAVEL_REV
    shaft_rev: float = 0.0
    screw_rev: float = 0.0
    rev_s: float = 0.0
    pull: float = field(default=1.0, repr=False)  # this pulse's share of the noise

    def advance(self, dt: float, drive: float | None) -> None:
        """Move on by dt seconds; drive -1 ... 1 of full speed (0 brakes), None: coasting."""
        if drive is not None:
            target = drive * self.speed_rev_s * self.pull
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

    def _driven(self, dt: float, target: float) -> None:
        fade = math.exp(-dt / SPIN_UP_S)
        excess = self.rev_s - target
        self.rev_s = target + excess * fade
        self._turn(target * dt + excess * SPIN_UP_S * (1 - fade))

    def _coasting(self, dt: float) -> None:
        way, speed = math.copysign(1.0, self.rev_s), abs(self.rev_s)
        floor = COAST_REV_S2 * COAST_S
        rest = COAST_S * math.log(1 + speed / floor)
        t = min(dt, rest)
        fade = math.exp(-t / COAST_S)
        self.rev_s = 0.0 if t == rest else way * ((speed + floor) * fade - floor)
        self._turn(way * ((speed + floor) * COAST_S * (1 - fade) - floor * t))

    def _turn(self, rev: float) -> None:
        self.shaft_rev += rev
        half = self.gap_rev / 2
        # the screw follows the shaft with play, up to its hard ends; there the motor stalls
        screw = min(max(self.screw_rev, self.shaft_rev - half), self.shaft_rev + half)
        self.screw_rev = min(max(screw, -self.travel_rev), self.travel_rev)
        if screw != self.screw_rev:
            self.shaft_rev = self.screw_rev + math.copysign(half, screw)
            self.rev_s = 0.0

    def far_from_switch(self, us: int) -> bool:
        """True if no switch can be reached within us microseconds, however it is driven."""
        reach = 1.1 * self.speed_rev_s * us * 1e-6
        return abs(abs(self.screw_rev) - SWITCH_REV) > reach

    @property
    def mirror_rad(self) -> float:
        """The angle by which the screw has turned the mirror, in radians."""
        return self.screw_rev * self.pitch_mm / self.lever_mm


class Bench:
    """Both drivetrains, the mirror and the screen.

    edge() takes what the board's pins do; spot_mm() tells where the spot is. With switches=True
    normally closed switches sit at SWITCH_REV of either screw; otherwise nothing is connected.
    two_pwm: the H-bridge is a DRV8833, whose two inputs a motor carry the duty, instead of an
    SN754410 with an enable and two legs.
    """

    def __init__(self, *, switches: bool = False, two_pwm: bool = False, seed: int = 1) -> None:
        self.vertical = Drivetrain(LEVER_Y_MM)
        self.horizontal = Drivetrain(LEVER_X_MM)
        self.has_switches = switches
        self.broken: set[str] = set()  # switch wires that are cut; set from outside
        self._noise = np.random.default_rng(seed)
        self._duty = dict.fromkeys(DRIVES.values(), 0.0)
        self.two_pwm = two_pwm
        self._us = 0

    def edge(self, t_us: int, pin: str, duty: int) -> None:
        """Pin `pin` has the duty 0 ... 65535 from t_us on."""
        self.advance(t_us)
        before = self.drive(pin[:2])
        self._duty[pin] = duty / 65535
        if before is None and self.drive(pin[:2]) is not None:
            train = self._train(pin[:2])
            train.pull = 1 + train.noise * float(self._noise.standard_normal())

    def duties(self) -> dict[str, float]:
        """Duty of every drive pin, 0 ... 1."""
        return self._duty

    def drive(self, motor: str) -> float | None:
        """Drive of motor `m1` or `m2`: -1 ... 1, 0 short-circuited (brake), None coasting."""
        pos, neg, enable = (self._duty[f"{motor}_{leg}"] for leg in ("pos", "neg", "en"))
        if self.two_pwm:
            return pos - neg if pos or neg else None
        return (pos - neg) * enable if enable else None

    def advance(self, t_us: int) -> None:
        """Let everything move on to t_us."""
        if t_us > self._us:
            dt = (t_us - self._us) * 1e-6
            self.vertical.advance(dt, self.drive("m1"))
            self.horizontal.advance(dt, self.drive("m2"))
            self._us = t_us

    def spot_mm(self) -> tuple[float, float]:
        """The spot on the screen: (right, up) of where it is with both screws at zero, in mm.

        The mirror's normal is turned about the vertical and about the mirror's own horizontal,
        and the beam reflected from it: r = d - 2 (d.n) n.
        """
        s, c = math.sin(INCIDENCE), math.cos(INCIDENCE)
        beam = np.array([s, 0.0, -c])  # comes in at INCIDENCE to the normal, which is z
        yaw, pitch = self.horizontal.mirror_rad, self.vertical.mirror_rad
        normal = np.array([math.sin(yaw) * math.cos(pitch), math.sin(pitch), math.cos(yaw) * math.cos(pitch)])
        ray = beam - 2 * (beam @ normal) * normal
        ahead, right, up = np.array([s, 0, c]), np.array([c, 0, -s]), np.array([0, 1, 0])
        ray = ray / (ray @ ahead) * SCREEN_MM
        return float(ray @ right), float(ray @ up)

    def spot_mrad(self) -> tuple[float, float]:
        """The beam's angle (right, up) in mrad."""
        x, y = self.spot_mm()
        return math.atan2(x, SCREEN_MM) * 1e3, math.atan2(y, SCREEN_MM) * 1e3

    def switch_levels(self) -> dict[str, int]:
        """The level of every switch input that is connected: 0 closed, 1 open (at the end)."""
        if not self.has_switches:
            return {}
        return _levels(self.vertical, self.horizontal) | dict.fromkeys(self.broken, 1)

    def next_switch_us(self, horizon_us: int) -> int | None:
        """When, within horizon_us from now, a switch changes if no pin does; None if none will."""
        if not self.has_switches or all(
            train.far_from_switch(horizon_us) for train in (self.vertical, self.horizontal)
        ):
            return None
        now = self.switch_levels()
        low, high = 0, horizon_us
        if self._levels_after(high) == now:
            return None
        while high - low > 1:
            middle = (low + high) // 2
            if self._levels_after(middle) == now:
                low = middle
            else:
                high = middle
        return self._us + high

    def _train(self, motor: str) -> Drivetrain:
        return self.vertical if motor == "m1" else self.horizontal

    def _levels_after(self, us: int) -> dict[str, int]:
        vertical, horizontal = replace(self.vertical), replace(self.horizontal)
        vertical.advance(us * 1e-6, self.drive("m1"))
        horizontal.advance(us * 1e-6, self.drive("m2"))
        return _levels(vertical, horizontal) | dict.fromkeys(self.broken, 1)


def _levels(vertical: Drivetrain, horizontal: Drivetrain) -> dict[str, int]:
    return {
        "m1_sw_pos": int(vertical.screw_rev >= SWITCH_REV),
        "m1_sw_neg": int(vertical.screw_rev <= -SWITCH_REV),
        "m2_sw_pos": int(horizontal.screw_rev >= SWITCH_REV),
        "m2_sw_neg": int(horizontal.screw_rev <= -SWITCH_REV),
        "emergency_stop": 0,  # pressed: put it into Bench.broken
    }
