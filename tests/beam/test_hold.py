"""Holding the beam: how well, what is told of it, and what is never done. The truth is the table's, for tests only."""

import json

import numpy as np
import pytest
from loop_rig import Rig

from mirrormount.cli.main import main
from mirrormount_beam.cli import hold
from mirrormount_beam.control.backlash import Gap, Width
from mirrormount_beam.control.controller import Prices, plan_correction
from mirrormount_beam.control.events import Corrected, Observed, Pulsed
from mirrormount_beam.control.hold import angle_weight
from mirrormount_beam.control.kalman import Tracker

ONE = ("--virtual", "--profile", "smooth", "--mounts", "1", "--cameras", "1", "--off", "0")
LEVER_M = 1.2  # between the cameras
SECONDS = 240


def held(rig, seconds=SECONDS):
    """The summary, and the true errors over time: rows of time, x and y of each camera."""
    rows = []
    add = rig.hold.summary.add

    def both(time_s, errors):
        rows.append((time_s, *rig.table.truth_um()))
        return add(time_s, errors)

    rig.hold.summary.add = both
    return rig.run(seconds), np.array(rows)


def rms_urad(rows):
    dt = np.diff(rows[:, 0])[:, None]
    angles = (rows[:-1, 3:5] - rows[:-1, 1:3]) / LEVER_M
    return float(np.sqrt((angles**2 * dt).sum(axis=0) / dt.sum()).max())


@pytest.mark.parametrize(("profile", "seed", "most_urad"), [("smooth", 1, 6.5), ("smooth", 2, 6.5), ("rough", 1, 9.0)])
def test_the_beam_is_held_in_truth_and_the_summary_says_so(profile, seed, most_urad):
    summary, rows = held(Rig(profile, seed))
    assert summary.interlocks == []
    assert rms_urad(rows) < most_urad
    assert np.abs(rows[:, 1:]).max() < 80
    assert summary.rms_urad == pytest.approx(rms_urad(rows), rel=0.2)
    assert summary.max_um == pytest.approx(np.abs(rows[:, 1:]).max(), abs=20)


def test_without_the_loop_the_beam_drifts_further():
    rig = Rig("smooth", 1)
    free = []
    for _ in range(SECONDS):
        rig.table.sleep(1)
        free.append(np.abs(rig.table.truth_um()).max())
    _, rows = held(Rig("smooth", 1))
    assert max(free) > 2 * np.abs(rows[:, 1:]).max()


def test_an_error_within_the_noise_is_not_corrected():
    rig = Rig("smooth", 1)
    gaps = rig.gaps
    for gap in gaps:
        gap.followed(1)
    errors = np.array([2.0, -2.0, 3.0, 1.0])
    assert not plan_correction(errors, rig.response, gaps, Prices(50.0, 220.0), angle_weight(2))


def test_a_reversal_has_to_pay():
    rig = Rig("smooth", 1)
    step = rig.response.matrices[1][:, 0]
    for gap in rig.gaps:
        gap.followed(1)
    errors = 10.0 * step / np.linalg.norm(step)  # to be corrected by a move of the first axis in the other way
    prices = Prices(1.0, 1e6)
    assert not plan_correction(errors, rig.response, rig.gaps, prices, np.eye(4)).steps[0] < 0
    assert plan_correction(-errors, rig.response, rig.gaps, prices, np.eye(4)).steps[0] > 0


def test_what_is_free_of_a_gap_is_less_than_the_gap():
    gap = Gap({1: Width(1.5, 0.05), -1: Width(1.5, 0.05)})
    gap.followed(1)
    assert gap.free(1, 0.005, 0.03, 0.0) == 0.0
    assert 1.2 < gap.free(-1, 0.005, 0.03, 0.0) < 1.5
    assert gap.free(-1, 0.005, 0.03, 0.06) < gap.free(-1, 0.005, 0.03, 0.0)  # the travel itself scatters


def drive(gap, way, steps, moved, error):
    """One travel of the shaft, and a look by which the screw has moved so far."""
    return gap.moved(way, steps, 0.0, gap.pulse(way, steps, 0.0).seen(moved, error))


def test_a_gap_that_was_crossed_teaches_its_width():
    gap = Gap({1: Width(1.5, 0.05), -1: Width(1.5, 0.05)})
    gap.followed(1)
    for _ in range(60):
        for way in (-1, 1):
            drive(gap, way, 1.4, 0.0, 0.001)
            drive(gap, way, 0.22, 0.02, 0.01)
            drive(gap, way, 0.05, 0.05, 0.01)
            drive(gap, way, 0.05, 0.05, 0.01)
            assert gap.in_contact(way)
    assert gap.widths[1].mean == pytest.approx(1.6, abs=0.02)


def test_one_look_of_two_sigma_is_no_contact_and_several_are():
    gap = Gap({1: Width(1.5, 0.05), -1: Width(1.5, 0.05)})
    gap.followed(1)
    drive(gap, -1, 1.3, 0.0, 0.01)
    assert not drive(gap, -1, 0.02, 0.02, 0.01)
    assert not gap.in_contact(-1)
    assert any(drive(gap, -1, 0.02, 0.02, 0.01) for _ in range(8))


def test_a_contact_that_was_seen_wrongly_is_taken_back():
    gap = Gap({1: Width(1.5, 0.05), -1: Width(1.5, 0.05)})
    gap.followed(1)
    drive(gap, -1, 1.3, 0.0, 0.005)
    for _ in range(3):
        drive(gap, -1, 0.05, 0.05, 0.01)
    assert gap.in_contact(-1)
    for _ in range(3):
        drive(gap, -1, 0.05, 0.0, 0.01)
    assert not gap.in_contact(-1)
    assert gap.widths[-1].samples == 2


def test_the_tracker_learns_that_the_beam_drifts_in_one_direction():
    noise = np.random.default_rng(1)
    tracker = Tracker(np.eye(2) * 9.0)
    place = np.zeros(2)
    for k in range(3000):
        place = place + np.array([1.0, 2.0]) * noise.normal(0, 2.0)
        tracker.pass_to(float(k))
        tracker.see(place + noise.normal(0, 3.0, 2), 1, rested_s=1.0)
    assert tracker.drift[0, 1] == pytest.approx(8.0, rel=0.4)
    assert np.sqrt(tracker.covariance[1, 1]) < 3.0


def test_a_reversal_is_told_with_the_correction_that_makes_it_and_no_other():
    rig = Rig("rough", 1)
    rig.run(60)
    way, told = {}, 0
    for event in [event for event in rig.told if isinstance(event, Corrected)]:
        turned = {name for name, steps in event.steps.items() if steps * way.get(name, 0) < 0}
        assert set(event.reversals) == turned
        way |= {name: steps for name, steps in event.steps.items() if steps}
        told += len(turned)
    assert told > 0


def test_each_pulse_and_each_look_is_told():
    rig = Rig("rough", 1)
    summary = rig.run(30)
    kinds = [type(event) for event in rig.told]
    assert kinds.count(Pulsed) == summary.actions
    assert kinds.count(Observed) > 30
    assert kinds.count(Corrected) >= summary.corrections


def test_what_the_beam_would_have_done_is_told():
    off = []
    for seed in (1, 2, 3):
        rig, free = Rig("smooth", seed), Rig("smooth", seed)
        rig.run(200)
        free.table.sleep(200)
        last = [event for event in rig.told if isinstance(event, Observed)][-1]
        off.append(np.ravel(last.free_um) - free.table.truth_um())
    assert np.sqrt(np.mean(np.square(off))) < 50  # each of a few hundred pulses is split between motion and drift


def test_a_loop_that_is_told_to_stop_ends_with_its_motors_off():
    rig = Rig()
    rig.table.at(rig.table.now_s() + 10, rig.hold.stop)
    summary = rig.hold.run()
    assert summary.seconds < 20
    assert not any(actuator.is_moving() for actuator in rig.table.actuators)


# ---- the command, on boards and pictures


@pytest.mark.full
def test_the_command_holds_the_virtual_table_and_writes_its_figures(tmp_path, capsys):
    file, calibration = tmp_path / "hold.json", tmp_path / "calibration.json"
    arguments = ["hold", "--virtual", "--profile", "smooth", "--duration", "10"]  # on others 10 s are left to chance
    assert main([*arguments, "--json", str(file), "--calibration", str(calibration)]) == 0
    told = capsys.readouterr().out
    assert "no calibration yet" in told
    assert "held:" in told
    found = json.loads(file.read_text())
    assert found["reached"]
    assert found["rms_urad"] < 9
    assert found["max_um"] < 80
    assert set(found["residual_um"]["virtual camera 2"]) == {"x", "y"}
    assert {"corrections", "actions", "reversals", "interlocks"} <= set(found)
    assert json.loads(calibration.read_text())["belongs"]["actuators"][0][0] == "first.x"


@pytest.mark.full
def test_a_goal_that_is_not_met_is_no_success(tmp_path):
    file = tmp_path / "hold.json"
    assert main(["hold", *ONE, "--duration", "3", "--max-um", "0.001", "--json", str(file)]) == 1
    assert not json.loads(file.read_text())["reached"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["hold", "--virtual", "--duration", "-1"],
        ["hold", "--virtual", "--rms-urad", "0"],
        ["hold", "--virtual", "--max-um", "-3"],
        ["align", "--virtual", "--within", "0"],
        ["align", "--virtual", "--most", "0"],
        ["hold", "--virtual", "--duration", "x"],
        ["hold", "--virtual", "--duration", ""],
        ["align", "--virtual", "--most", "1.5"],
        ["hold", "--profile", "rough"],
        ["hold", "--virtual", "--cameras", "1"],
        ["hold", "--virtual", "--patience", "3"],
    ],
)
def test_what_cannot_be_is_one_line(arguments, capsys):
    assert main(arguments) == 1
    assert capsys.readouterr().err.startswith("mirrormount: ")


@pytest.mark.parametrize("verb", ["calibrate", "align", "hold"])
def test_numbers_that_cannot_be_written_are_told_before_anything_moves(verb, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(hold, "open_table", pytest.fail)
    for file in (tmp_path / "none" / "hold.json", tmp_path):
        assert main([verb, "--virtual", "--json", str(file)]) == 1
        assert capsys.readouterr().err.startswith(f"mirrormount: cannot write {file}: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("verb", ["calibrate", "align", "hold"])
def test_numbers_never_replace_the_file_of_something_else(verb, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(hold, "open_table", pytest.fail)
    (file := tmp_path / "notes.json").write_text('{"mine": 1}')
    assert main([verb, "--virtual", "--json", str(file)]) == 1
    assert "a file of that name exists" in capsys.readouterr().err
    assert file.read_text() == '{"mine": 1}'


def test_numbers_replace_those_of_an_earlier_run(tmp_path):
    file, words = tmp_path / "all.json", [*ONE, "--calibration", str(tmp_path / "calibration.json")]
    for verb in (["calibrate"], ["align"], ["hold", "--duration", "1"], ["calibrate"]):
        assert main([*verb, *words, "--json", str(file)]) == 0
        assert ("um_for_a_step" in json.loads(file.read_text())) == (verb == ["calibrate"])


@pytest.mark.full
def test_a_users_own_link_to_the_numbers_is_kept(tmp_path):
    link, file = tmp_path / "all.json", tmp_path / "mine.json"
    link.symlink_to(file)
    assert main(["calibrate", *ONE, "--json", str(link)]) == 0
    assert link.is_symlink() and json.loads(file.read_text())["reached"]
