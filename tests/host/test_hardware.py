"""The mechanics of `hardware`, at the pins: start, detents, coast, supply, twist, and what they do to the USB cable."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mirrormount.device.mount import Mount
from mirrormount.errors import MountError
from mirrormount_sim.bench import Bench
from mirrormount_sim.board import profile_named
from mirrormount_sim.mechanics import Drivetrain, Pwm, copied, mean_current
from mirrormount_sim.profiles import DETENTS_REV, HARDWARE, PITCH_MM, SMOOTH
from mirrormount_sim.simulation import Interference


def turned(pins: dict[str, tuple[float, int]], *, two_pwm: bool = False, supply: str = "1") -> float:
    """The shaft's turn in half a second with pins of m1 (duty, Hz) from rest."""
    bench = Bench(profile=replace(profile_named("hardware", supply), loose_start=False), two_pwm=two_pwm)
    for pin, (duty, hz) in pins.items():
        bench.edge(1000, f"m1_{pin}", round(duty * 65535), hz)
    bench.advance(501_000)
    return abs(bench.vertical.shaft_rev)


@pytest.mark.parametrize(
    ("pins", "starts"),
    [
        ({"pos": (1, 0), "en": (0.5, 4000)}, False),
        ({"pos": (1, 0), "en": (0.8, 4000)}, True),
        ({"pos": (1, 0), "en": (0.8, 20_000)}, True),
        ({"pos": (1, 0), "en": (0.45, 400)}, True),
        ({"pos": (1, 0), "en": (0.1, 25)}, True),  # each period is a kick
        ({"en": (1, 0), "pos": (0.45, 4000)}, True),  # slow decay
        ({"en": (1, 0), "pos": (0.25, 4000)}, False),
        ({"en": (1, 0), "pos": (0.1, 25)}, True),
    ],
)
def test_a_motor_starts_by_its_duty_the_pwms_frequency_and_the_decay(pins, starts):
    assert (turned(pins) > 0) == starts
    assert turned(pins | {"pos": (1, 0), "en": (1, 0)}) > 0


def test_a_drv8833_is_in_slow_decay_if_its_other_input_is_high():
    assert turned({"pos": (0.5, 4000)}, two_pwm=True) == 0
    assert turned({"pos": (1, 0), "neg": (0.5, 4000)}, two_pwm=True) > 0


def test_a_full_duty_needs_a_third_of_the_supply():
    full = {"pos": (1.0, 0), "en": (1.0, 0)}
    assert turned(full, supply="0.3") == 0
    assert turned(full, supply="0.4") > 0


def test_the_current_in_fast_decay_is_continuous_where_it_ceases_to_die_in_the_pauses():
    duties = np.linspace(0.01, 1, 400)
    for hz in (25, 1000, 4000, 20_000):
        currents = [mean_current(float(duty), 0.1, Pwm(hz, False), 1.5e-4) for duty in duties]
        assert np.all(np.diff(currents) > 0)
        assert np.max(np.diff(currents)) < 0.01
        assert currents[-1] == pytest.approx(0.9)


def test_a_board_tells_the_bench_the_frequency_of_its_pwm():
    with Mount.open("virtual://?speed=max&profile=hardware") as mount:
        train = mount.link.port.simulation.bench.horizontal  # type: ignore[attr-defined]
        for speed, moves in ((0.4, False), (1.0, True)):
            before = train.shaft_rev
            mount.x.jog(speed)
            mount.link.port.sleep(0.2)
            mount.stop()
            assert (train.shaft_rev != before) == moves


def train_of(**facts: float) -> Drivetrain:
    """One without chance."""
    plain = replace(HARDWARE, pulse_noise=0.0, friction_spread=0.0, stick_um=0.0, **facts)
    return Drivetrain(30.0, profile=plain, noise=0.0)


def pulse(train: Drivetrain, on_s: float, drive: float = 1.0) -> float:
    """The shaft's way of a pulse, until it is at rest."""
    before = train.shaft_rev
    train.advance(on_s, drive)
    train.advance(1.0, None)
    assert train.rev_s == 0
    return train.shaft_rev - before


def test_a_motion_ends_in_a_detent_as_far_as_friction_lets_it():
    train = train_of()
    held = math.asin(HARDWARE.friction_v / HARDWARE.cogging_v) / (2 * math.pi)
    for on_s in np.linspace(0.003, 0.05, 40):
        pulse(train, float(on_s))
        place = train.shaft_rev * DETENTS_REV
        assert abs(place - round(place)) <= held + 1e-9


def test_a_pulse_that_is_too_short_for_half_a_detent_comes_back():
    assert pulse(train_of(), 1.0e-3) < 0.25 / DETENTS_REV
    assert pulse(train_of(), 2.5e-3) > 0.5 / DETENTS_REV


def test_most_of_a_short_pulse_is_coast_and_friction_ends_it():
    train = train_of(cogging_v=0.0, coast_s=1e3)
    train.advance(0.01, 1.0)
    speed, driven = train.rev_s, train.shaft_rev
    friction = HARDWARE.friction_v / HARDWARE.volts
    braking = friction * HARDWARE.speed_rev_s / (1 - friction) / HARDWARE.spin_up_s
    train.advance(1.0, None)
    assert train.shaft_rev - driven == pytest.approx(speed**2 / (2 * braking), rel=1e-3)
    assert train.shaft_rev > 3 * driven


def test_two_motors_that_start_together_lack_what_the_supply_loses():
    ways = {}
    for motors in (("m1",), ("m1", "m2")):
        bench = Bench(profile=replace(HARDWARE, loose_start=False, friction_spread=0.0, pulse_noise=0.0, cogging_v=0.0))
        for motor in motors:
            bench.edge(1000, f"{motor}_pos", 65535)
            bench.edge(1000, f"{motor}_en", 65535)
        bench.advance(11_000)
        ways[len(motors)] = bench.vertical.shaft_rev
    assert 0.93 < ways[2] / ways[1] < 0.99


def test_the_tip_follows_in_jumps_of_at_most_twice_the_mean_lag():
    train = Drivetrain(30.0, profile=replace(HARDWARE, creep=0.0, periodic=0.0), chance=4)
    train.turn(train.gap_rev)
    lags = []
    for _ in range(20_000):
        train.turn(1e-6)
        lags.append((train.screw_rev - train.tip_rev) * PITCH_MM * 1000)
    assert min(lags) >= 0
    assert 0.9 * 2 * HARDWARE.stick_um < max(lags) <= 2 * HARDWARE.stick_um
    here = train.mirror_rad
    train.turn(-1e-6)
    assert train.mirror_rad == here  # and a reversal has to cross the lag, too


def test_a_copy_goes_where_the_train_itself_will_however_finely_it_is_looked_at():
    noise = np.random.default_rng(4)
    train = Drivetrain.new(30.0, HARDWARE, noise)
    for k, on_s in enumerate((0.2, 0.01, 0.6, 0.004, 0.05)):
        drive = -1.0 if k % 3 == 2 else 1.0
        train.begin(drive, noise, others=k % 2)
        copy = copied(train)
        for seconds, what in ((on_s, drive), (0.3, None)):
            train.advance(seconds, what)
            for _ in range(100):
                copy.advance(seconds / 100, what)
        assert copy.screw_rev == pytest.approx(train.screw_rev, abs=1e-9)
        assert copy.tip_rev == pytest.approx(train.tip_rev, abs=1e-9)


def test_a_motor_that_drives_twists_the_mirror_and_each_axis_has_a_part_of_the_other():
    bench = Bench(profile=replace(HARDWARE, loose_start=False))
    ((yaw, pitch),) = bench.mirrors_rad()
    bench.edge(1000, "m1_pos", 65535)
    bench.edge(1000, "m1_en", 65535)
    bench.advance(1001)
    ((yaw_after, pitch_after),) = bench.mirrors_rad()
    assert pitch_after - pitch == pytest.approx(HARDWARE.twist_urad * 1e-6)
    assert yaw_after - yaw == pytest.approx(HARDWARE.cross * HARDWARE.twist_urad * 1e-6)
    bench.edge(1002, "m1_en", 0)
    bench.advance(2000)
    assert bench.mirrors_rad() == [pytest.approx((yaw, pitch), abs=1e-9)]


def test_a_step_of_hardware_is_about_the_papers():
    ways = []
    for profile in (SMOOTH, HARDWARE):
        quiet = replace(profile, pulse_noise=0.0, friction_spread=0.0)
        ways.append(pulse(Drivetrain(30.0, profile=quiet, noise=0.0), 0.2))
    assert ways[1] == pytest.approx(ways[0], rel=0.03)


def test_a_motor_that_starts_takes_bytes_and_now_and_then_the_port_for_two_seconds():
    emi, s = Interference(1), 1_000_000
    assert emi.left(0, bytes(1000)) == bytes(1000)
    gone = 0
    for us in range(5 * s, 10_000 * s, 5 * s):
        emi.start(us)
        gone += emi.gone(us)
        assert emi.gone(us + 2 * s - 1) == emi.gone(us)
        assert not emi.gone(us + 2 * s)
        if not emi.gone(us):
            assert 900 < len(emi.left(us + 4999, bytes(1000))) < 990
            assert len(emi.left(us + 5000, bytes(1000))) == 1000
    assert 10 < gone < 40  # of 2000


def test_a_program_whose_port_goes_has_an_error_and_its_motors_end():
    def steps(mount: Mount) -> None:
        for _ in range(1000):
            mount.x.step(1)

    with Mount.open("virtual://?speed=max&emi=1&seed=2") as mount:
        simulation = mount.link.port.simulation  # type: ignore[attr-defined]
        with pytest.raises(MountError):
            steps(mount)
    assert not any(simulation.bench.drive(motor) for motor in ("m1", "m2"))
