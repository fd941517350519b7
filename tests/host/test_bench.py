"""The bench: what pins do to the spot. The figures are the paper's."""

import pytest
from pulsed_bench import Driver

from mirrormount_sim.bench import Bench
from mirrormount_sim.mechanics import Drivetrain
from mirrormount_sim.profiles import GAP_REV


@pytest.mark.parametrize(("motor", "component", "mrad"), [("m2", 0, 0.43), ("m1", 1, 0.47)])
def test_a_default_step_turns_the_beam_by_the_papers_angle(motor, component, mrad):
    driver = Driver(Bench())
    driver.step(motor, "pos", 3)
    before = driver.bench.spot_mrad()
    driver.step(motor, "pos", 10)
    after = driver.bench.spot_mrad()
    assert (after[component] - before[component]) / 10 == pytest.approx(mrad, rel=0.005)
    assert abs(after[1 - component] - before[1 - component]) < 0.05  # a 45 degree mirror couples a little


@pytest.mark.parametrize(("motor", "component", "mrad"), [("m2", 0, 0.64), ("m1", 1, 0.70)])
def test_a_reversal_loses_the_papers_backlash(motor, component, mrad):
    driver = Driver(Bench())
    driver.step(motor, "pos", 3)
    before = driver.bench.spot_mrad()
    driver.step(motor, "pos", 10)
    driver.step(motor, "neg", 10)
    after = driver.bench.spot_mrad()
    assert after[component] - before[component] == pytest.approx(mrad, rel=0.01)


def test_a_reversal_within_the_gap_does_not_move_the_spot():
    driver = Driver(Bench())
    driver.step("m2", "pos", 3)
    before = driver.bench.spot_mm()
    driver.step("m2", "neg", 1)
    driver.step("m2", "pos", 1)
    assert driver.bench.spot_mm() == pytest.approx(before, abs=0.01)


def test_both_legs_alike_brake_and_no_enable_coasts():
    bench = Bench()
    assert bench.drive("m1") is None
    bench.edge(0, "m1_en", 65535)
    assert bench.drive("m1") == 0
    bench.edge(0, "m1_pos", 65535)
    assert bench.drive("m1") == 1
    bench.edge(0, "m1_neg", 65535)
    assert bench.drive("m1") == 0
    bench.edge(0, "m1_pos", 0)
    assert bench.drive("m1") == -1
    bench.edge(0, "m1_en", 32768)
    assert bench.drive("m1") == pytest.approx(-0.5, abs=1e-4)


def test_a_two_pwm_bridge_takes_the_duty_on_its_legs():
    bench = Bench(two_pwm=True)
    bench.edge(0, "m2_neg", 16384)
    assert bench.drive("m2") == pytest.approx(-0.25, abs=1e-4)
    bench.edge(0, "m2_neg", 0)
    assert bench.drive("m2") is None


def test_a_motor_spins_up_and_coasts():
    train = Drivetrain(lever_mm=30, gap_rev=0, noise=0)
    train.advance(0.01, 1.0)
    assert 0 < train.rev_s < train.profile.speed_rev_s
    here = train.shaft_rev
    train.advance(0.002, None)
    assert train.shaft_rev > here
    train.advance(1.0, None)
    assert train.rev_s == 0


def test_motion_does_not_depend_on_how_finely_it_is_looked_at():
    whole, parts = Drivetrain(lever_mm=30), Drivetrain(lever_mm=30)
    for drive, seconds in (
        (1.0, 0.2),
        (None, 0.05),
        (-1.0, 0.3),
        (0.0, 0.1),
        (1.0, 0.05),
        (-0.3, 0.2),
        (None, 0.2),
    ):
        whole.advance(seconds, drive)
        for _ in range(100):
            parts.advance(seconds / 100, drive)
    assert parts.screw_rev == pytest.approx(whole.screw_rev, abs=1e-9)
    assert parts.shaft_rev == pytest.approx(whole.shaft_rev, abs=1e-9)


def test_the_gap_sees_the_farthest_point_of_a_motor_that_is_reversed_while_it_turns():
    train = Drivetrain(lever_mm=30, gap_rev=GAP_REV)
    train.advance(0.3, 1.0)
    screw = train.screw_rev
    train.advance(0.1, -1.0)  # overshoots forward first, then turns back inside the gap
    assert train.screw_rev > screw


def test_a_motor_stalls_at_the_hard_end_of_its_screw():
    train = Drivetrain(lever_mm=30, travel_rev=0.1)
    train.advance(10.0, 1.0)
    assert train.screw_rev == 0.1
    assert train.rev_s == 0


def test_the_next_change_of_a_switch_is_foretold_to_the_microsecond():
    bench = Bench(switches=True)
    bench.edge(0, "m1_pos", 65535)
    bench.edge(0, "m1_en", 65535)
    at = bench.next_switch_us(60_000_000)
    assert at is not None
    bench.advance(at - 2)
    assert bench.switch_levels()["m1_sw_pos"] == 0
    bench.advance(at + 1)
    assert bench.switch_levels()["m1_sw_pos"] == 1


def test_the_same_seed_gives_the_same_noise_and_another_seed_another():
    def end(seed: int) -> tuple[float, float]:
        driver = Driver(Bench(seed=seed))
        driver.bench.horizontal.noise = 0.01
        driver.step("m2", "pos", 5)
        return driver.bench.spot_mm()

    assert end(1) == end(1)
    assert end(1) != end(2)
