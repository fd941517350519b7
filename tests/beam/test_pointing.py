"""The spot on its way to a place: on a bench of numbers with backlash, and what ends the way."""

import math

import drivetrain_rig
import numpy as np
import pytest

from mirrormount_beam.errors import NotMeasurable
from mirrormount_beam.observe import Sighting
from mirrormount_beam.pointing import CORRECTIONS, GAP_STEPS, LEARN_STEPS, WITHIN_PX, Learned, approach, learn
from mirrormount_sim.profiles import PROFILES

STEP_US = 200_000
TURNED = np.array([[9.0, 4.0], [5.0, -11.0]])  # px of a step: a camera that is turned, axes that are not square


class Bench:
    """Two axes with a backlash of `gap` steps each, seen with a noise of 0.02 px."""

    def __init__(self, px=TURNED, gap=1.5):
        self.px, self.gap = np.array(px, float), gap
        self.motor, self.mirror = np.zeros(2), np.zeros(2)
        self.noise = np.random.default_rng(3)
        self.longest = 0.0
        self.asked = np.zeros(2)

    def step_us(self, axis):
        return STEP_US

    def step(self, axis, n):
        self._turn(axis, n)

    def pulse(self, axis, us):
        self._turn(axis, us / STEP_US)

    def _turn(self, axis, steps):
        at = "xy".index(axis)
        self.longest = max(self.longest, abs(steps))
        self.asked[at] += abs(steps)
        self.motor[at] += steps
        self.mirror[at] = min(max(self.mirror[at], self.motor[at] - self.gap), self.motor[at])

    def observe(self, frames):
        x, y = (320, 240) + self.px @ self.mirror + self.noise.normal(0, 0.02, 2)
        return Sighting(x, y, 0.02, 0.02, 0.0, frames)


def say(_text):
    pass


def test_learn_finds_what_a_step_does_behind_the_backlash_and_moves_no_further_than_it_says():
    bench = Bench()
    found = learn(bench, ("x", "y"), say)
    assert np.allclose(found.px, TURNED, atol=0.1)
    assert bench.asked.max() <= GAP_STEPS + LEARN_STEPS


@pytest.mark.parametrize("gap", [0.0, 0.4, 1.5, 3.0])
@pytest.mark.parametrize("error", [1.0, 1.4, 0.6])
def test_the_spot_arrives_with_backlash_and_with_a_response_that_is_wrong_by_two_fifths(gap, error):
    bench = Bench(gap=gap)
    learned = Learned(("x", "y"), tuple(map(tuple, TURNED * error)))
    for target in ((400.0, 200.0), (250.0, 300.0), (255.0, 297.0)):
        arrival = approach(bench, learned, target, say)
        seen = np.array([320, 240]) + bench.px @ bench.mirror
        assert arrival.reached and math.dist(seen, target) < WITHIN_PX + 0.1
    assert bench.longest <= 4.0


@pytest.mark.parametrize(("profile", "at_least"), [("smooth", 100), ("rough", 98), ("hardware", 97)])
def test_on_published_mechanics_a_step_of_18_px_and_a_tip_that_slips_by_half_a_pixel_are_no_hindrance(
    monkeypatch, profile, at_least
):
    monkeypatch.setattr(drivetrain_rig, "PX_PER_RAD", 64_000.0)  # the virtual table's far camera
    arrived = 0
    for seed in range(50):
        rig = drivetrain_rig.DrivetrainRig(PROFILES[profile], seed)
        learned = learn(rig, ("x", "y"), say)
        for right, down in np.random.default_rng(seed).uniform(-80, 80, (2, 2)):
            seen = rig.observe(3)
            arrived += approach(rig, learned, (seen.x + right, seen.y + down), say).reached
    assert arrived >= at_least


@pytest.mark.parametrize("wrong", [-TURNED, TURNED[:, ::-1] * (1, -1)], ids=["signs", "axes exchanged"])
def test_a_response_that_is_wrong_in_its_directions_ends_the_way_after_some_moves(wrong):
    bench = Bench()
    with pytest.raises(NotMeasurable, match="learn again"):
        approach(bench, Learned(("x", "y"), tuple(map(tuple, wrong))), (400.0, 200.0), say)
    assert bench.asked.max() <= 4.0 * 8


def test_a_motor_that_does_not_turn_is_no_response():
    with pytest.raises(NotMeasurable, match="steps of y did not move the spot"):
        learn(Bench(px=[[9.0, 0.0], [5.0, 0.0]]), ("x", "y"), say)


def test_two_axes_that_do_the_same_are_no_response():
    with pytest.raises(NotMeasurable, match="along the same line"):
        learn(Bench(px=[[9.0, 9.0], [5.0, 5.5]]), ("x", "y"), say)


def test_a_mount_that_sticks_is_given_up_and_told_how_far_off():
    bench = Bench(gap=1e9)
    arrival = approach(bench, Learned(("x", "y"), tuple(map(tuple, TURNED))), (330.0, 240.0), say)
    assert not arrival.reached and arrival.off_px > 9 and arrival.corrections == CORRECTIONS
