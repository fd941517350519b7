"""The optical bench of one board: an actuator for each motor, a mirror, a screen, and their wires. It sees pins only.

Axis 1 tilts the mirror (the spot goes up and down), axis 2 turns it (right and left); axes 3 and 4 do
the same to a second mirror (table.py has both). mechanics.py has the actuators.
Units: microseconds at the interface; millimetres and milliradians on the screen.

"The paper" is Gopalakrishnan and Guehr, A low-cost mirror mount control system for optics
setups. What it does not give is marked as such and chosen so that what it measured comes out.

The wires are the wiring table of docs/bring-up.md, written down here a second time on purpose: the
bench must not learn from the firmware what the firmware should have driven.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mirrormount_sim.mechanics import Drivetrain, Encoder, Pwm, copied, mirror_angles
from mirrormount_sim.profiles import SMOOTH, SWITCH_REV, Profile

DRIVES = {
    2: "m1_en",
    3: "m1_pos",
    4: "m1_neg",
    5: "m2_en",
    6: "m2_pos",
    7: "m2_neg",
}
MORE_DRIVES = {  # of a board with four axes
    16: "m3_en",
    17: "m3_pos",
    18: "m3_neg",
    19: "m4_en",
    20: "m4_pos",
    21: "m4_neg",
}
LED = 25
POWER = 28  # an analog input
SWITCHES = {
    10: "m1_sw_pos",
    11: "m1_sw_neg",
    12: "m2_sw_pos",
    13: "m2_sw_neg",
    14: "emergency_stop",
}
ENCODERS = {  # motor: A and B of a quadrature encoder, or SDA and SCL of one on the output shaft
    "m1": (8, 9),
    "m2": (26, 27),
}
BUS = 64  # a change of the angle on the bus whose SDA is GPIO n is told as one of wire 64 + n


def drives(axes: int) -> dict[int, str]:
    """The wires to the H-bridges of a board with two axes, or four."""
    return DRIVES | MORE_DRIVES if axes > 2 else DRIVES


SCREEN_MM = 7620.0  # the paper, section III: a screen 300 inches away
STEP_S = 0.2  # the paper, section III: one step is 0.2 s at full speed
STEP_X_MRAD = 0.43  # the paper, section III
STEP_Y_MRAD = 0.47  # the paper, section III
BACKLASH_X_MRAD = 0.64  # the paper, section III
BACKLASH_Y_MRAD = 0.70  # the paper, section III

# The rest is not in the paper; profiles.py has the motors' and the screws'.
INCIDENCE = math.radians(45)  # a folding mirror
# Equal levers would give steps in y of 0.71 of those in x, and the paper has 1.09: docs/mechanics.md, doubtful.
LEVER_X_MM = 34.524  # screw to pivot, as seen by the yaw; fitted to STEP_X_MRAD
LEVER_Y_MM = 22.341  # as seen by the pitch; fitted to STEP_Y_MRAD
HAND_REV, HAND_S = 0.05, 0.5  # how far and how long a hand turns a knob; assumed
_MEAN_OF = 10  # steps of a scale
REST_US = 2000  # a motion is at its end if no drive follows for so long: more than a period of the PWM


@dataclass(frozen=True)
class Order:
    """A fault to come: its name (of encoder.FAULTS), its motor, and when it begins."""

    name: str
    motor: str
    us: int = 0


class Bench:
    """The actuators, their mirror and the screen.

    edge() takes what the board's pins do; spot_mm() tells where the spot is. With switches=True
    normally closed switches sit at SWITCH_REV of either screw; otherwise nothing is connected.
    two_pwm: the H-bridge is a DRV8833, whose two inputs a motor carry the duty, instead of an
    SN754410 with an enable and two legs. axes: 2, or 4 with a second mirror.
    encoder: a kind of encoder.KINDS on each motor, or None. orders: faults that begin by themselves.
    If they are set, on_rest(us, motor, turns of each screw) is called REST_US after a motor has come to rest, and
    on_drive(…) when a drive of it begins after a pause.
    """

    def __init__(
        self,
        *,
        switches: bool = False,
        two_pwm: bool = False,
        seed: int = 1,
        profile: Profile = SMOOTH,
        axes: int = 2,
        encoder: str | None = None,
        orders: Sequence[Order] = (),
    ) -> None:
        self._noise = np.random.default_rng(seed)
        self.trains = {
            f"m{number}": Drivetrain.new(LEVER_Y_MM if number % 2 else LEVER_X_MM, profile, self._noise)
            for number in range(1, axes + 1)
        }
        self.vertical, self.horizontal = self.trains["m1"], self.trains["m2"]
        self.profile = profile
        self.wires = drives(axes)  # GPIO number to name
        self.has_switches = switches
        self.broken: set[str] = set()  # switch wires that are cut; set from outside
        self._duty = dict.fromkeys(self.wires.values(), 0.0)
        self._hz = dict.fromkeys(self.wires.values(), 0)
        self.two_pwm = two_pwm
        self.us = 0  # the time up to which everything has moved
        self.encoders: dict[str, Encoder] = {}
        if encoder is not None:
            sources = np.random.SeedSequence((seed, 0xE)).spawn(axes)
            for (motor, train), source in zip(self.trains.items(), sources, strict=True):
                self.encoders[motor] = Encoder(train, encoder, 0, np.random.default_rng(source))
        self._orders = sorted(orders, key=lambda order: order.us)
        self.on_rest: Callable[[int, str, dict[str, float]], None] | None = None
        self.on_drive: Callable[[int, str, dict[str, float]], None] | None = None
        self._moving: set[str] = set()
        self._rests: dict[str, tuple[int, dict[str, float]]] = {}  # which may still turn out to be a pause
        self._off_us: dict[str, int] = {}  # when each drive ended

    def edge(self, t_us: int, pin: str, duty: int, hz: int = 0) -> None:
        """Pin `pin` has the duty 0 ... 65535 from t_us on, by a PWM of so many Hz (0: not known)."""
        self.advance(t_us)
        motor = pin[:2]
        before = self.drive(motor)
        self._duty[pin] = duty / 65535
        self._hz[pin] = hz
        after = self.drive(motor)
        self.trains[motor].pwm = self.pwm(motor)
        if before is None and after is not None:
            self._begin(motor, after)
        if after != before and motor in self.encoders:
            self.encoders[motor].cut(self.us)
        if after and not before:
            self._resume(motor)
        elif before and not after:
            self._off_us[motor] = self.us

    def _begin(self, motor: str, drive: float) -> None:
        """A motor starts: what it draws, the others lack, and it lacks what they draw."""
        others = [train for name, train in self.trains.items() if name != motor and self.drive(name)]
        self.trains[motor].begin(drive, self._noise, sum(train.current for train in others))
        for train in others:
            train.lacking += self.profile.sag

    def duties(self) -> dict[str, float]:
        """Duty of every drive pin, 0 ... 1."""
        return self._duty

    def drive(self, motor: str) -> float | None:
        """Drive of motor `m1` or `m2`: -1 ... 1, 0 short-circuited (brake), None coasting."""
        pos, neg, enable = (self._duty[f"{motor}_{leg}"] for leg in ("pos", "neg", "en"))
        if self.two_pwm:
            return pos - neg if pos or neg else None
        return (pos - neg) * enable if enable else None

    def pwm(self, motor: str) -> Pwm:
        """How the bridge makes the duty of a motor, by the pin that has one: an enable in its pauses opens the bridge.

        So does a leg of a DRV8833 beside one that is low. A leg beside one that is high, or of an SN754410 that stays
        enabled, short-circuits the motor.
        """
        pins = [f"{motor}_{leg}" for leg in ("en", "pos", "neg")]
        parts = [pin for pin in pins if 0 < self._duty[pin] < 1]
        if not parts:
            return Pwm()
        enable, *legs = pins
        fast = all(self._duty[leg] < 1 for leg in legs) if self.two_pwm else enable in parts
        return Pwm(self._hz[parts[0]], not fast)

    def advance(self, t_us: int) -> None:
        """Let everything move on to t_us."""
        while self._orders and self._orders[0].us <= t_us:
            order = self._orders.pop(0)
            self._advance(max(order.us, self.us))
            self.disturb(order.motor, order.name)
        self._advance(t_us)

    def disturb(self, motor: str, fault: str) -> None:
        """Begin a fault of encoder.FAULTS at this motor, now; `hand` is one turn of the knob."""
        train = self.trains[motor]
        if fault == "hand":
            train.hand_rev_s, train.hand_s = HAND_REV / HAND_S, HAND_S
            self._moving.add(motor)
        elif fault == "jammed":
            train.jammed = True
        encoder = self.encoders.get(motor)
        if encoder is not None:
            encoder.extend(self.us, self.drive(motor))
            encoder.cut(self.us)
            encoder.faults.add(fault)
            encoder.again()

    def mend(self, motor: str, fault: str) -> None:
        """End a fault."""
        self.trains[motor].jammed &= fault != "jammed"
        encoder = self.encoders.get(motor)
        if encoder is not None:
            encoder.extend(self.us, self.drive(motor))
            encoder.cut(self.us)
            encoder.faults.discard(fault)
            encoder.again()

    def look_ahead(self, until_us: int) -> None:
        """Let the encoders know their changes up to a time, if no pin changes before."""
        for motor, encoder in self.encoders.items():
            encoder.extend(until_us, self.drive(motor))

    def _advance(self, t_us: int) -> None:
        if self.encoders:
            self.look_ahead(t_us)
        if self.on_rest is not None:
            self._come_to_rest(t_us)
        if t_us > self.us:
            dt = (t_us - self.us) * 1e-6
            for motor, train in self.trains.items():
                train.advance(dt, self.drive(motor))
            self.us = t_us

    def _resume(self, motor: str) -> None:
        """A drive begins now: the motion of before has ended if that was no pause of the PWM."""
        rest = self._rests.pop(motor, None)
        if self.us - self._off_us.get(motor, -REST_US) >= REST_US:
            if rest and self.on_rest:
                self.on_rest(rest[0], motor, rest[1])
            if self.on_drive:
                self.on_drive(self.us, motor, self._screws())
        self._moving.add(motor)

    def _screws(self) -> dict[str, float]:
        return {name: train.screw_rev for name, train in self.trains.items()}

    def _come_to_rest(self, t_us: int) -> None:
        """Tell the ends of motions up to a time: advance to each of them, and report it once it has lasted."""
        assert self.on_rest
        on_rest, self.on_rest = self.on_rest, None  # no further one on the way there
        ends = []
        for motor in self._moving:
            train = self.trains[motor]
            if not self.drive(motor):
                ends.append((self.us + math.ceil(max(train.coast_s, train.hand_s) * 1e6), motor))
        for end_us, motor in sorted(ends):
            if end_us <= t_us:
                self._advance(end_us)
                self._moving.discard(motor)
                self._rests[motor] = (end_us, self._screws())
        self.on_rest = on_rest
        for motor, (us, screws) in sorted(self._rests.items(), key=lambda rest: rest[1][0]):
            if us + REST_US <= t_us:
                del self._rests[motor]
                on_rest(us, motor, screws)

    def mirrors_rad(self, t_us: int | None = None) -> list[tuple[float, float]]:
        """Yaw and pitch of each mirror in radians: now, or at t_us if no pin changes until then."""
        trains = list(self.trains.values()) if t_us is None else self._ahead(max(0, t_us - self.us))
        return [mirror_angles(yaw, pitch) for pitch, yaw in zip(trains[::2], trains[1::2], strict=True)]

    def spot_mm(self) -> tuple[float, float]:
        """The spot on the screen: (right, up) of where it is with both screws at zero, in mm.

        The mirror's normal is turned about the vertical and about the mirror's own horizontal,
        and the beam reflected from it: r = d - 2 (d.n) n.
        """
        s, c = math.sin(INCIDENCE), math.cos(INCIDENCE)
        beam = np.array([s, 0.0, -c])  # comes in at INCIDENCE to the normal, which is z
        yaw, pitch = mirror_angles(self.horizontal, self.vertical)
        normal = np.array([math.sin(yaw) * math.cos(pitch), math.sin(pitch), math.cos(yaw) * math.cos(pitch)])
        ray = beam - 2 * (beam @ normal) * normal
        ahead, right, up = np.array([s, 0, c]), np.array([c, 0, -s]), np.array([0, 1, 0])
        ray = ray / (ray @ ahead) * SCREEN_MM
        return float(ray @ right), float(ray @ up)

    def spot_mrad(self) -> tuple[float, float]:
        """The beam's angle (right, up) in mrad."""
        x, y = self.spot_mm()
        return math.atan2(x, SCREEN_MM) * 1e3, math.atan2(y, SCREEN_MM) * 1e3

    def step_mrad(self, motor: str, pulse_us: int) -> tuple[float, float]:
        """mrad of the mirror a pulse at full duty, in the positive and the negative direction of the motor.

        It is the mean over some steps without backlash, and without what differs from pulse to pulse and from place to
        place.
        """
        even = replace(self.profile, periodic=0.0, stick_um=0.0, creep=0.0, twist_urad=0.0)
        mrad: list[float] = []
        for way in (1.0, -1.0):
            train = Drivetrain(self.trains[motor].lever_mm, 0.0, profile=even)
            for _ in range(_MEAN_OF):
                train.held_s = even.breakaway_s
                train.advance(pulse_us * 1e-6, way)
                train.advance(train.coast_s, None)
            mrad.append(abs(train.mirror_rad) * 1e3 / _MEAN_OF)
        return mrad[0], mrad[1]

    def switch_levels(self) -> dict[str, int]:
        """The level of every switch input that is connected: 0 closed, 1 open (at the end)."""
        if not self.has_switches:
            return {}
        return _levels(*self.trains.values()) | dict.fromkeys(self.broken, 1)

    def next_switch_us(self, horizon_us: int) -> int | None:
        """When, within horizon_us from now, a switch changes if no pin does; None if none will."""
        if not self.has_switches or all(train.far_from_switch(horizon_us) for train in self.trains.values()):
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
        return self.us + high

    def _ahead(self, us: int) -> list[Drivetrain]:
        """Copies of the actuators, us microseconds from now if no pin changes until then."""
        copies = []
        for motor, train in self.trains.items():
            copies.append(copied(train))
            copies[-1].advance(us * 1e-6, self.drive(motor))
        return copies

    def _levels_after(self, us: int) -> dict[str, int]:
        return _levels(*self._ahead(us)) | dict.fromkeys(self.broken, 1)


def _levels(vertical: Drivetrain, horizontal: Drivetrain, *_more: Drivetrain) -> dict[str, int]:
    return {
        "m1_sw_pos": int(vertical.screw_rev >= SWITCH_REV),
        "m1_sw_neg": int(vertical.screw_rev <= -SWITCH_REV),
        "m2_sw_pos": int(horizontal.screw_rev >= SWITCH_REV),
        "m2_sw_neg": int(horizontal.screw_rev <= -SWITCH_REV),
        "emergency_stop": 0,  # pressed: put it into Bench.broken
    }
