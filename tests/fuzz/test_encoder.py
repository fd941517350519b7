"""One axis with an encoder under random commands and faults: what it says of its place is never more than it knows.

The truth is the motor of rig_encoder.py. `measured` is the place to the count (and the time of a reading); every
accepted move ends once, with its reason; no fault leaves a motor on for longer than 80 ms; whenever the power goes,
the next start claims no more than it may.
"""

import os

import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from rig_encoder import encoded, finish

from mountfw import codes
from mountfw.motion.axis import SEARCH, SETTLE

pytestmark = pytest.mark.slow

EXAMPLES = int(os.environ.get("MIRRORMOUNT_FUZZ_EXAMPLES", "30"))
SEED = os.environ.get("MIRRORMOUNT_FUZZ_SEED")  # not set: the same sessions each time
PER_STEP = 280
LATE_COUNTS = 3  # in the time that an answer takes a motor at 120 % of the supply turns so far
STALL_US = 80_000

MOTION = st.sampled_from(
    [
        b"1PR1",
        b"1PR-1",
        b"1PR3",
        b"1PR-4",
        b"1PA0",
        b"1PA2",
        b"1XU30000",
        b"1XU-250000",
        b"1MV+",
        b"1MV-",
        b"02550000",
        b"-1800000",
        b"02550255",
        b"1OR",
        b"1MT+",
    ]
)
OTHER = st.sampled_from(
    [
        b"!",
        b"1ST",
        b"AB",
        b"00000000",
        b"1DH0",
        b"1DH5",
        b"1VA4",
        b"1VA2",
        b"1DB0",
        b"1DB2",
        b"1XI1",
        b"1XI0",
        b"1XG40",
        b"1XV120",
        b"1XV255",
        b"1XA150",
        b"1XA0",
    ]
)
FAULT = st.sampled_from(["hand", "stuck", "free", "slip", "low", "high"])
WAIT_US = st.one_of(st.integers(0, 5_000), st.integers(5_000, 300_000), st.just(1_500_000), st.just(10_800_000))
ACTION = st.tuples(st.one_of(MOTION, MOTION, OTHER, FAULT), WAIT_US)


class Truth:
    """Where the axis is since its place was said, by the motor itself."""

    def __init__(self, rig):
        self.rig = rig
        self.slips = 0

    def disturb(self, fault):
        motor = self.rig.motor1
        if fault == "hand":
            motor.at += 333
        elif fault in ("stuck", "free"):
            motor.stuck = fault == "stuck"
        elif fault == "slip":
            motor.slips += 1
        else:
            motor.supply = 0.8 if fault == "low" else 1.2

    def check(self):
        """What it says agrees with the motor, as far as it claims to know."""
        rig, axis = self.rig, self.rig.axis1
        rig.motor1.catch_up()
        before = rig.motor1.at
        said = axis.position_now()
        assert rig.drives()[0] == 0 or axis.moving()
        if axis.position.certainty != codes.MEASURED:
            return None
        if rig.motor1.slips != axis.measured.reader.slips:
            return None
        way = -1 if axis.inverted else 1
        return before * way * 1000 / PER_STEP - said

    def watch(self):
        """A stuck motor that is driven is off soon; so is one that a pulse begins to drive meanwhile."""
        rig = self.rig
        if rig.motor1.stuck and rig.axis1.stall_ms:
            rig.run(STALL_US)
            if rig.drives()[0]:
                rig.run(STALL_US)
            assert rig.drives()[0] == 0, "it drives a motor that does not turn"


def examples(most):
    """Always the same examples, or others with a seed."""
    common = settings(
        max_examples=most,
        deadline=None,
        derandomize=SEED is None,
        database=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
    return lambda test: common(test if SEED is None else seed(int(SEED))(test))


def defines(word):
    return word[:3] in (b"1DH", b"1OR", b"1XI")  # it says anew where the axis is


def play(actions):
    """Play a session, and check after each action. Returns the rig."""
    rig = encoded(settings=b"XN280;MM1")
    rig.motor1.ends = (-20_000, 20_000)
    rig.ask(b"1DH0;1XT20000\n")
    truth = Truth(rig)
    zero = truth.check()
    for action, wait_us in actions:
        if isinstance(action, str):
            truth.disturb(action)
        else:
            rig.send(action + b"\n")
            rig.settle()
        rig.run(wait_us)
        truth.watch()
        off = truth.check()
        if (isinstance(action, bytes) and defines(action)) or rig.axis1.state in (SETTLE, SEARCH):
            finish(rig)
            zero = truth.check()
        elif off is not None and zero is not None:
            counts = LATE_COUNTS if rig.motor1.speed else 1
            assert abs(off - zero) <= (counts + 0.5) * 1000 / PER_STEP, f"{off - zero} millisteps off after {action}"
        elif off is not None:
            zero = off
    finish(rig)
    rig.run(600_000)
    assert rig.drives() == (0, 0)
    assert rig.axis1.reason in codes.REASONS
    while rig.controller.errors.waiting:
        assert rig.controller.errors.pop() != codes.INTERNAL_FAULT
    return rig


@examples(2 * EXAMPLES)
@given(actions=st.lists(ACTION, min_size=5, max_size=25))
def test_what_is_called_measured_is_where_the_motor_has_turned(actions):
    play(actions)


@examples(EXAMPLES)
@given(
    actions=st.lists(ACTION, min_size=3, max_size=12), cut_us=st.integers(0, 12_000_000), turned=st.integers(-500, 500)
)
def test_a_power_cut_at_any_moment_leaves_no_place_that_is_called_measured(actions, cut_us, turned):
    rig = play(actions)
    rig.send(b"1PR2\n")
    rig.run(cut_us)
    record = rig.port.files.get("mountfw.position")
    moving = rig.controller.moving()
    at, place = rig.motor1.at, rig.axis1.position_now()
    again = encoded({"mountfw.position": record} if record else {})
    again.motor1.at = at + turned  # a hand while it is off
    certainty = again.axis1.position.certainty
    assert certainty != codes.MEASURED
    if moving or not record:
        assert certainty == codes.UNKNOWN
    elif certainty in (codes.COUNTED, codes.HOMED):
        assert abs(again.axis1.position.millisteps - place) <= 1000 * 3 / PER_STEP
