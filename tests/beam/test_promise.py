"""What a calibration promises that a table will hold, and the interlock of one that holds worse."""

from dataclasses import replace

import pytest
from fast_table import FastTable
from loop_rig import Rig

from mirrormount_beam.control.calibrate import Calibration
from mirrormount_beam.control.hold import Hold, align
from mirrormount_beam.control.promise import promise_of
from mirrormount_beam.runlog import Rms


def changed(table, **numbers):
    """Numbers of the mechanics change."""
    for actuator in table.actuators:
        actuator.train.profile = replace(actuator.train.profile, **numbers)


def measured(profile, seed):
    table = FastTable(profile, seed)
    measuring = Calibration(table)
    response = measuring.run()
    align(table, response, measuring.gaps)
    return table, response, measuring.gaps


@pytest.mark.parametrize("profile", ["smooth", "rough", "hardware"])
def test_a_table_holds_what_was_promised(profile):
    table, response, gaps = measured(profile, 2)
    hold = Hold(table, response, gaps)
    held = hold.run(240).held.rms
    assert response.promise
    assert 1 / 1.5 < held.times(response.promise) < 1.5
    assert not hold.summary.interlocks


def test_a_table_that_cannot_be_held_is_promised_nothing():
    table, response, _ = measured("smooth", 1)
    response.drift_um2_s *= 1e5  # 3 mm in a second, which is further than a correction reaches
    assert promise_of(response, table.cameras, 1 / 30) is None


def test_one_camera_without_a_distance_is_promised_in_micrometres():
    table = FastTable("smooth", 1, mounts=1)
    table.cameras = table.cameras[:1]
    table.cameras[0].distance_m = None
    promise = Calibration(table).run().promise
    assert promise
    assert promise.urad is None
    assert 1 < promise.um < 50


def test_ten_minutes_of_twice_the_promise_end_the_hold():
    rig = Rig("smooth", 1)
    rig.response.promise = Rms(4.0, 1.5)  # as if the table had been calibrated in a better state
    rig.run(1200)
    assert rig.trips() == ["holds worse than it promised"]
    assert rig.states()[-2:] == ["stopped", "ended"]
    tripped = rig.hold.summary.interlocks[0]
    assert not tripped.clears_itself
    assert "promised were 1.5" in tripped.cause


@pytest.mark.parametrize(
    "fault",
    [
        {"breakaway_s": 0.02, "breakaway_spread_s": 0.005},  # a start that comes late
        {"gap_spread": 0.4},
        {"supply": 0.7},
    ],
    ids=["late start", "gap", "supply"],
)
def test_what_goes_wrong_after_the_calibration_is_held_or_ends_it(fault):
    table, response, gaps = measured("hardware", 2)
    changed(table, **fault)
    hold = Hold(table, response, gaps)
    summary = hold.run(900)
    assert response.promise
    assert summary.interlocks or summary.held.rms.times(response.promise) < 2
