"""Calibration and alignment, on a table without pictures: what is measured, how far it gets, what it refuses."""

import itertools

import numpy as np
import pytest
from fast_table import FastTable

from mirrormount.errors import BadFile
from mirrormount_beam.control.calibrate import Calibration
from mirrormount_beam.control.hold import align
from mirrormount_beam.control.response import belongs_to, load, save
from mirrormount_beam.errors import NotControllable, ResponseOfOther, SpotLost
from mirrormount_sim.optics import Geometry

OFF_MM = 9.0


def calibrated(table):
    measuring = Calibration(table)
    return measuring.run(), measuring.gaps


@pytest.mark.parametrize(("profile", "seed"), list(itertools.product(("smooth", "rough"), (1, 2, 3))))
def test_a_beam_that_is_9_mm_off_is_aligned(profile, seed):
    table = FastTable(profile, seed, OFF_MM)
    response, gaps = calibrated(table)
    summary = align(table, response, gaps)
    assert summary.reached
    assert summary.corrections <= 10
    assert np.abs(table.truth_um()).max() < 20  # the goal is of what cameras see: 15, and their noise
    assert not any(actuator.is_moving() for actuator in table.actuators)


def test_a_calibration_of_two_mounts_takes_less_than_4_minutes():
    table = FastTable("rough", 4, OFF_MM)
    calibrated(table)
    assert table.now_s() < 240


def test_the_matrix_is_that_of_the_geometry():
    table = FastTable("smooth", 1)
    response, _ = calibrated(table)
    lever = np.array([1.0, 2.2])  # m, from the first mirror to the cameras
    ratio = response.matrices[1][2, 0] / response.matrices[1][0, 0]
    assert ratio == pytest.approx(lever[1] / lever[0], rel=0.02)


def test_a_gap_is_measured():
    table = FastTable("smooth", 1)
    response, _ = calibrated(table)
    step_rev = 0.0234
    for widths in response.widths:
        assert widths[1].mean == pytest.approx(0.03481 / step_rev, rel=0.03)


def test_directions_differ_on_a_rough_mount():
    table = FastTable("rough", 1)
    response, _ = calibrated(table)
    sizes = {way: np.linalg.norm(response.matrices[way], axis=0) for way in (1, -1)}
    assert np.all(sizes[-1] < 0.95 * sizes[1])


def test_one_mount_and_one_camera_are_aligned():
    table = FastTable("rough", 1, 4.0, mounts=1, geometry=Geometry(cameras_m=(1.6,)))
    response, gaps = calibrated(table)
    assert align(table, response, gaps).reached


def test_two_mounts_with_one_camera_are_refused():
    table = FastTable("smooth", 1, geometry=Geometry(cameras_m=(1.6,)))
    with pytest.raises(NotControllable, match="add a camera"):
        Calibration(table)
    assert not any(actuator.pulses for actuator in table.actuators)


def test_an_axis_that_does_not_move_the_spot_is_named():
    table = FastTable("smooth", 1)
    table.actuators[1].train.travel_rev = 0.0
    with pytest.raises(NotControllable, match=r"first\.y"):
        calibrated(table)


def test_cameras_at_one_distance_cannot_tell_two_mounts():
    table = FastTable("smooth", 1, geometry=Geometry(cameras_m=(1.6, 1.601)))
    with pytest.raises(NotControllable, match="distance"):
        calibrated(table)


def test_without_a_spot_nothing_is_moved():
    table = FastTable("smooth", 1)
    table.truth.laser.blocked = True
    with pytest.raises(SpotLost):
        calibrated(table)
    assert not any(actuator.pulses for actuator in table.actuators)


def test_more_corrections_than_allowed_is_no_success():
    table = FastTable("rough", 2, OFF_MM)
    response, gaps = calibrated(table)
    assert not align(table, response, gaps, most=1).reached


# ---- the file


def test_a_calibration_is_the_same_after_it_was_saved(tmp_path):
    table = FastTable("rough", 1)
    response, _ = calibrated(table)
    save(response, tmp_path / "a.json")
    again = load(tmp_path / "a.json", table)
    assert again.to_json() == response.to_json()


def test_no_file_is_no_calibration(tmp_path):
    assert load(tmp_path / "none.json", FastTable("smooth", 1)) is None


def change_step(table):
    table.actuators[2].step_us = 100_000


def change_board(table):
    table.actuators[0].board_id = "another"


def change_size(table):
    table.cameras[1].size = table.cameras[1].size._replace(width=320)


@pytest.mark.parametrize("change", [change_step, change_board, change_size])
def test_a_calibration_of_something_else_is_refused(tmp_path, change):
    table = FastTable("smooth", 1)
    response, _ = calibrated(table)
    save(response, tmp_path / "a.json")
    change(table)
    with pytest.raises(ResponseOfOther):
        load(tmp_path / "a.json", table)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"format": 2}', "\x00"])
def test_a_damaged_file_is_told(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(BadFile):
        load(tmp_path / "a.json", FastTable("smooth", 1))


def test_a_calibration_names_boards_and_cameras():
    table = FastTable("smooth", 1)
    belongs = belongs_to(table)
    assert belongs["actuators"][0] == ["first.x", "board of first", 200_000]
    assert belongs["cameras"][1] == ["camera 2", 640, 480, 50.0, 50.0]
