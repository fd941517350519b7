"""The experiments find what the virtual mount has, and their error bars are right, over 200 seeds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from drivetrain_rig import DRIFT_PX, STEP_US, DrivetrainRig, true_pulse_px

from mirrormount.beam.estimate import Estimate, combined, mean, student
from mirrormount.beam.experiments import backlash, pulses, square, step_size, steps, waiting
from mirrormount.beam.result import Result
from mirrormount.common.beam_errors import NotMeasurable
from mirrormount.virtual.drivetrain import GAP_REV
from mirrormount.virtual.profile import PROFILES, ROUGH, SMOOTH

SEEDS = range(200)


def quietly(_done: float, _phase: str) -> None:
    pass


def within(truth: float, estimates: list[Estimate]) -> float:
    """The share of estimates with the truth within 2 standard errors."""
    return float(np.mean([abs(e.value - truth) < 2 * e.error for e in estimates]))


def results(experiment, profile, seeds, **options) -> list[Result]:
    every = []
    for seed in seeds:
        every.append(Result("test"))
        experiment(DrivetrainRig(profile, seed), every[-1], quietly, **options)
    return every


@pytest.mark.parametrize("name", PROFILES)
def test_the_steps_error_bars_are_right_in_both_directions(name):
    every = results(steps.run, PROFILES[name], range(400))
    for way, sign in (("positive", 1), ("negative", -1)):
        truth = true_pulse_px(PROFILES[name], sign * STEP_US)
        for axis in ("x", "y"):
            found = [result.estimates[f"{axis}.{way}.step"] for result in every]
            assert 0.92 <= within(truth, found) <= 0.98, (axis, way)
            assert np.median([e.error / e.value for e in found]) < 0.02


def test_the_periodic_error_of_the_screw_is_found_and_none_where_there_is_none():
    rough = [" ".join(result.remarks) for result in results(steps.run, ROUGH, range(20))]
    smooth = [" ".join(result.remarks) for result in results(steps.run, SMOOTH, range(20))]
    assert sum(remarks.count("with a period of") for remarks in rough) >= 78  # of 80 runs
    assert sum(remarks.count("with a period of") for remarks in smooth) <= 2


def test_the_rotation_of_the_camera_is_found_within_its_error():
    found, square_axes = [], []
    for seed in SEEDS:
        result = Result("steps")
        steps.run(DrivetrainRig(ROUGH, seed, rotation_rad=0.05), result, quietly)
        found.append(result.estimates["x.angle_in_picture"])
        square_axes.append(result.estimates["cross_talk"])
    assert within(50.0, found) >= 0.92
    assert within(0.0, square_axes) >= 0.92


@pytest.mark.parametrize("name", PROFILES)
def test_the_backlash_is_the_gap_of_the_shaft_within_its_error(name):
    profile = PROFILES[name]
    per_px = 0.025 / true_pulse_px(PROFILES["smooth"], STEP_US)  # turns; only the ratio of ways counts below
    every = results(backlash.run, profile, range(60))
    for way, sign in (("positive", 1), ("negative", -1)):
        turn = true_pulse_px(profile, sign * STEP_US) * per_px
        found = [result.estimates[f"x.to_{way}"] for result in every]
        assert np.mean([e.value for e in found]) == pytest.approx(GAP_REV / turn, rel=0.035)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", PROFILES)
def test_the_backlashs_error_bars_are_right_in_both_directions(name):
    profile = PROFILES[name]
    per_px = 0.025 / true_pulse_px(PROFILES["smooth"], STEP_US)
    every = results(backlash.run, profile, SEEDS)
    for way, sign in (("positive", 1), ("negative", -1)):
        truth = GAP_REV / (true_pulse_px(profile, sign * STEP_US) * per_px)
        found = [result.estimates[f"{axis}.to_{way}"] for result in every for axis in ("x", "y")]
        assert 0.92 <= within(truth, found) <= 0.98, way


def test_the_take_up_is_the_backlash_times_the_pulse():
    (result,) = results(backlash.run, SMOOTH, [1])
    assert result.estimates["y.take_up"].value == pytest.approx(result.estimates["y.backlash"].value * STEP_US)
    assert result.estimates["y.take_up"].unit == "us"


@pytest.mark.parametrize("name", PROFILES)
def test_the_pulse_curve_has_right_error_bars(name):
    profile = replace(PROFILES[name], periodic=0.0)  # which differs from place to place, and the experiment says so
    every = results(pulses.run, profile, SEEDS, lengths_ms=(5, 12, 35, 100))
    for ms in (12, 35, 100):
        truth = true_pulse_px(profile, ms * 1000)
        assert within(truth, [result.estimates[f"x.positive.pulse_{ms}ms"] for result in every]) >= 0.92, ms


@pytest.mark.parametrize(("name", "factor"), [("smooth", 0.2), ("rough", 0.6), ("rough", 1.5)])
def test_the_pulse_for_a_step_of_a_wanted_size_makes_it(name, factor):
    inside = []
    for seed in range(30):
        rig, result = DrivetrainRig(PROFILES[name], seed), Result("steps")
        steps.run(rig, result, quietly)
        now_px = (result.estimates["x.positive.step"].value + result.estimates["x.negative.step"].value) / 2
        step_size.run(rig, result, quietly, {"x": factor * now_px})
        us = round(result.estimates["x.wanted.pulse"].value)
        both = []
        for way, sign in (("positive", 1), ("negative", -1)):
            found, truth = result.estimates[f"x.wanted.{way}.step"], true_pulse_px(PROFILES[name], sign * us, 500)
            inside.append(abs(found.value - truth) < 2 * found.error)
            both.append(truth)
        assert np.mean(both) == pytest.approx(factor * now_px, rel=0.08)
    assert np.mean(inside) >= 0.87  # 95 %, less three standard errors of 60


@pytest.mark.parametrize(
    ("size", "says"), [(100.0, "would need a pulse of"), (1e-4, "would need a pulse of|for certain")]
)
def test_a_step_that_no_pulse_makes_is_told(size, says):
    rig, result = DrivetrainRig(SMOOTH, 1), Result("steps")
    steps.run(rig, result, quietly)
    with pytest.raises(NotMeasurable, match=says):
        step_size.run(rig, result, quietly, {"x": size})


def test_a_square_without_take_up_does_not_close_by_what_the_gap_takes():
    (result,) = results(square.run, SMOOTH, [1])
    gap_px = 1.4 * true_pulse_px(SMOOTH, STEP_US)
    assert abs(result.estimates["closure.x"].value) == pytest.approx(gap_px, rel=0.2)
    assert len(result.readings) == 41


def test_the_drift_is_a_random_walk_of_the_size_that_the_beam_has():
    every = results(waiting.drift, SMOOTH, range(40), seconds=1200.0)
    found = [result.estimates["x.walk"] for result in every]
    assert np.mean([e.value for e in found]) == pytest.approx(DRIFT_PX, rel=0.1)
    assert within(DRIFT_PX, found) >= 0.85
    assert every[0].estimates["x.rms"].to_json()["standard_error"] is None


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", PROFILES)
def test_the_drifts_error_bars_are_right(name):
    every = results(waiting.drift, PROFILES[name], SEEDS, seconds=1200.0)
    assert 0.92 <= within(DRIFT_PX, [result.estimates[f"{axis}.walk"] for result in every for axis in "xy"]) <= 0.98


def test_creep_is_told_only_if_it_is_larger_than_the_beams_drift():
    (result,) = results(waiting.settle, SMOOTH, [1], seconds=10.0)
    silent = [remark.split(":")[0] for remark in result.remarks if "no creep" in remark]
    assert len(silent) >= 3
    assert not any(f"{run}.settled_after" in result.estimates for run in silent)
    assert all(series.points[0][0] == 0 for series in result.series), "the time is that after the move"


def test_a_motor_that_does_not_move_the_spot_is_told():
    rig = DrivetrainRig(SMOOTH, 1)
    rig.trains["x"].speed_rev_s = 0.0
    for experiment in (steps.run, backlash.run, pulses.run):
        with pytest.raises(NotMeasurable, match=r"x: .*look at motor and coupler"):
            experiment(rig, Result("test"), quietly)


def test_a_picture_that_is_too_small_is_told_with_what_to_do():
    rig = DrivetrainRig(SMOOTH, 1)
    rig.picture_px = (345, 480)
    with pytest.raises(NotMeasurable, match=r"room for \d+ steps"):
        steps.run(rig, Result("test"), quietly)


def test_the_quantile_of_student_is_that_of_the_tables():
    # t at the two-sided 95.45 %: 4 degrees 2.869, 10: 2.284, 30: 2.087 (the usual tables)
    for degrees, t in ((4, 2.869), (10, 2.284), (30, 2.087)):
        assert 2 * student(degrees) == pytest.approx(t, rel=0.01)
    assert math.isinf(student(0))


def test_an_estimate_is_written_with_two_digits_of_its_error():
    assert str(Estimate(431.23, 1.31, "urad")) == "431.2 ± 1.3 urad"
    assert str(Estimate(0.0123, 0.00042, "px")) == "0.01230 ± 0.00042 px"
    assert str(Estimate(318_519.0, 28_836.0, "us")) == "319000 ± 29000 us"
    assert str(Estimate(-0.00002, 0.0011, "mm")) == "0.0000 ± 0.0011 mm"
    assert str(mean([1.0, 1.0], "px")) == "1 px"


def test_estimates_that_differ_too_much_widen_their_error():
    agree = combined([Estimate(1.0, 0.1, "px"), Estimate(1.1, 0.1, "px")])
    differ = combined([Estimate(1.0, 0.1, "px"), Estimate(2.0, 0.1, "px")])
    assert agree.error == pytest.approx(0.1 / math.sqrt(2))
    assert differ.error > 0.4
