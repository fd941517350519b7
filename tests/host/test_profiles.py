"""The two kinds of mechanics: smooth is what the paper's figures stand on, rough what its numbers say. Pins only."""

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from pulsed_bench import Driver

from mirrormount.cli.arguments import virtual_address
from mirrormount.cli.main import main, parser
from mirrormount.device.mount import Mount
from mirrormount.errors import BadAddress
from mirrormount_sim.bench import Bench
from mirrormount_sim.board import profile_named
from mirrormount_sim.mechanics import Drivetrain
from mirrormount_sim.profiles import ROUGH, SMOOTH, Profile

# where the spot of a bench with seed 1 was, in mm, after each of these, before there were profiles
SMOOTH_WAY = (
    ("m2", "pos", 3, 200_000, (7.41537062034108, 0.0)),
    ("m1", "neg", 2, 200_000, (7.41669218327701, -4.485646991000667)),
    ("m2", "neg", 2, 50_000, (7.41669218327701, -4.485646991000667)),
)


def only(**facts: float) -> Profile:
    """Smooth mechanics without scatter, and with these facts."""
    return Profile("test", **({"pulse_noise": 0.0} | facts))


def turns(profile: Profile, drive: float, on_s: float, count: int, seed: int = 5) -> np.ndarray:
    """The shaft's turn in each of so many pulses in one direction, in revolutions."""
    noise = np.random.default_rng(seed)
    train = Drivetrain.new(30.0, profile, noise)
    train.travel_rev = math.inf
    made = []
    for _ in range(count):
        before = train.shaft_rev
        train.begin(drive, noise)
        train.advance(on_s, drive)
        train.advance(0.5, None)
        made.append(train.shaft_rev - before)
    return np.array(made)


def test_smooth_is_to_the_last_digit_what_the_bench_was():
    bench = Bench(seed=1)
    driver = Driver(bench)
    bench.vertical.noise = bench.horizontal.noise = SMOOTH.pulse_noise
    for motor, way, count, on_us, spot in SMOOTH_WAY:
        driver.step(motor, way, count, on_us)
        assert bench.spot_mm() == pytest.approx(spot, abs=1e-9)


def test_the_negative_direction_is_slower_by_the_profiles_share():
    ahead, back = (abs(turns(only(negative_slower=0.15), way, 2.0, 1)[0]) for way in (1.0, -1.0))
    assert back / ahead == pytest.approx(0.85, abs=0.003)  # coasting does not scale with the speed


def test_nothing_moves_before_the_motor_breaks_away():
    made = turns(ROUGH, 1.0, 3e-3, 2000)
    assert np.mean(made == 0) == pytest.approx(0.5, abs=0.05)  # half of all pulses need longer than the mean
    assert np.all(turns(only(breakaway_s=3e-3), 1.0, 2.99e-3, 5) == 0)


def test_a_pulse_is_shorter_by_the_time_until_the_motor_breaks_away():
    held = turns(only(breakaway_s=3e-3), 1.0, 0.203, 1)
    assert held == pytest.approx(turns(only(), 1.0, 0.2, 1), rel=1e-12)


@pytest.mark.parametrize("on_s", [0.01, 0.02, 0.2])
def test_the_scatter_of_a_pulse_depends_on_its_length_as_the_profile_says(on_s):
    made = turns(only(pulse_noise=0.05, short_noise=0.25, short_s=0.02), 1.0, on_s, 3000)
    # coasting is not proportional to the speed, and is a larger part of a shorter pulse
    assert np.std(made) / np.mean(made) == pytest.approx(0.05 + 0.25 * math.exp(-on_s / 0.02), rel=0.15)
    assert np.all(made > 0)


def test_a_scattered_pulse_does_not_depend_on_how_finely_it_is_looked_at():
    def end(parts: int) -> float:
        noise = np.random.default_rng(3)
        train = Drivetrain.new(30.0, ROUGH, noise)
        for drive, seconds in ((1.0, 0.03), (None, 0.2), (-1.0, 0.4), (None, 0.2), (1.0, 0.01), (None, 0.2)):
            if drive:
                train.begin(drive, noise)
            for _ in range(parts):
                train.advance(seconds / parts, drive)
        return train.screw_rev

    assert end(50) == pytest.approx(end(1), abs=1e-9)


def test_the_mirrors_speed_is_periodic_in_the_screws_turn():
    profile = only(periodic=0.10)
    train = Drivetrain(30.0, noise=0.0, profile=profile, phase_rad=1.0)
    rates = []
    for step in range(100):
        train.screw_rev = step / 100
        here = train.mirror_rad
        train.screw_rev += 1e-6
        rates.append((train.mirror_rad - here) / 1e-6 * train.lever_mm / train.pitch_mm)
    assert (min(rates), max(rates)) == pytest.approx((0.90, 1.10), abs=1e-3)
    train.screw_rev = 1.0
    assert train.mirror_rad == pytest.approx(train.pitch_mm / train.lever_mm)  # a whole turn is a whole turn


def reversing(count: int) -> Iterator[tuple[Drivetrain, Callable[[float, float], None]]]:
    """A drivetrain whose gap varies, before each of its reversals, and what gives a pulse that way (on, off in s)."""
    noise = np.random.default_rng(8)
    train = Drivetrain.new(30.0, only(gap_spread=0.03), noise)
    for k in range(count):
        drive = 1.0 if k % 2 else -1.0

        def pulse(on_s: float, off_s: float, drive: float = drive) -> None:
            train.begin(drive, noise)
            train.advance(on_s, drive)
            train.advance(off_s, None)

        yield train, pulse


def test_the_gap_varies_from_reversal_to_reversal_and_the_screw_never_jumps():
    gaps = []
    for train, pulse in reversing(1000):
        screw, shaft = train.screw_rev, train.shaft_rev
        pulse(1e-6, 0.0)
        assert train.screw_rev == screw
        pulse(0.6, 0.5)
        gaps.append(abs(train.shaft_rev - shaft) - abs(train.screw_rev - screw))
    gaps = np.array(gaps[1:])
    assert np.mean(gaps) == pytest.approx(train.gap_rev, rel=0.005)
    assert np.std(gaps) / np.mean(gaps) == pytest.approx(0.03, rel=0.1)


def test_the_gap_stays_as_it_is_while_the_shaft_pushes_the_screw():
    gaps = []
    for train, pulse in reversing(400):
        for number in range(11):
            pulse(0.2, 0.1)
            if number == 4:
                across = abs(train.shaft_rev - train.screw_rev)
        assert abs(train.shaft_rev - train.screw_rev) == pytest.approx(across, abs=1e-9)
        gaps.append(2 * across)
    assert np.mean(gaps) == pytest.approx(train.gap_rev, rel=0.005)


def test_the_speed_follows_the_supply():
    low, nominal = (turns(profile_named("smooth", supply), 1.0, 2.0, 200).mean() for supply in ("0.8", "1.0"))
    assert low / nominal == pytest.approx(0.8, abs=0.003)


def test_a_mount_creeps_after_a_move_by_the_profiles_share():
    train = Drivetrain(30.0, gap_rev=0.0, noise=0.0, profile=only(creep=0.01, creep_s=15.0))
    train.advance(0.2, 1.0)
    train.advance(0.1, None)
    at_once = train.mirror_rad
    train.advance(15.0, None)
    later = train.mirror_rad
    train.advance(1000.0, None)
    whole = train.mirror_rad
    assert at_once / whole == pytest.approx(0.99, abs=2e-4)
    assert (whole - later) / (whole - at_once) == pytest.approx(math.exp(-1), abs=0.01)


def test_a_rough_mount_is_its_seed():
    def way(seed: int) -> tuple[float, ...]:
        bench = Bench(seed=seed, profile=ROUGH)
        driver = Driver(bench)
        seen = []
        for motor, turn in (("m1", "pos"), ("m2", "neg"), ("m1", "neg"), ("m2", "pos")):
            driver.step(motor, turn, 3, 30_000)
            driver.step(motor, turn, 2)
            seen += bench.spot_mm()
        return tuple(seen)

    assert way(1) == way(1)
    assert way(1) != way(2)


def test_a_motor_without_supply_edges_stands_still_on_a_rough_mount():
    bench = Bench(seed=4, profile=ROUGH)
    before = bench.spot_mm()
    bench.edge(1000, "m1_pos", 65535)  # a leg without its enable
    bench.advance(60_000_000)
    assert bench.spot_mm() == before


def test_an_address_names_profile_and_seed_and_the_firmware_drives_that_mount():
    def after_steps(address: str) -> tuple[float, float]:
        with Mount.open(address) as mount:
            mount.x.step(4)
            return mount.link.port.simulation.bench.spot_mm()  # type: ignore[attr-defined]

    rough = after_steps("virtual://?speed=max&profile=rough&seed=11")
    assert rough == after_steps("virtual://?speed=max&profile=rough&seed=11")
    assert rough != after_steps("virtual://?speed=max&profile=smooth&seed=11")
    assert 0.5 < after_steps("virtual://?speed=max&supply=0.7")[0] / after_steps("virtual://?speed=max")[0] < 0.75


@pytest.mark.parametrize("option", ["profile=ruff", "supply=0", "supply=two", "supply=nan", "supply=٣"])
def test_an_unknown_profile_or_supply_is_refused_in_one_line(option):
    with pytest.raises(BadAddress) as refused:
        Mount.open(f"virtual://?{option}")
    assert "\n" not in str(refused.value)


def test_a_short_pulse_moves_less_than_its_share():
    curve = [turns(SMOOTH, 1.0, ms / 1000, 200).mean() for ms in (3, 6, 10, 200)]
    assert curve == sorted(curve)
    assert curve[2] / curve[3] < 10 / 200  # it has not spun up


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["panel", "--profile", "rough"], "add --virtual"),
        (["virtual", "--seed", "x", "--tcp", "0"], "a seed is a number"),
    ],
)
def test_the_shell_refuses_a_profile_of_a_real_board_and_a_seed_that_is_no_number(words, why, capsys):
    assert main(words) == 1
    assert why in capsys.readouterr().err


def test_the_shells_words_become_the_address():
    args = parser().parse_args(["panel", "--virtual", "--profile", "rough", "--seed", "7"])
    assert virtual_address(args) == "virtual://?profile=rough&seed=7"
    assert virtual_address(args, "virtual-table", mounts="1") == "virtual-table://?profile=rough&mounts=1&seed=7"
    assert virtual_address(parser().parse_args(["panel", "--virtual"])) == "virtual://?profile=hardware"
