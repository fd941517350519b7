"""A calibration that is not true any more: the loop ends at a gate, and the beam has not run away.

The faults come after the calibration, while nobody looks: then the loop starts with what was saved.
"""

import numpy as np
import pytest
from loop_rig import Rig

from mirrormount_beam.control.events import InterlockTripped
from mirrormount_beam.control.hold import Hold, align

FURTHER_UM = 4000.0  # a quarter of a picture's half: by so much at most the beam gets further off, on any camera
ENDS = ("corrections do not help", "axis does not move", "spot jumped")


def turn_cameras(table):
    for eye in table.cameras:
        eye.rotation += np.pi / 2


def turn_one_camera(table):
    table.cameras[1].rotation += np.pi / 2


def turn_cameras_over(table):
    for eye in table.cameras:
        eye.rotation += np.pi


def exchange_cameras(table):
    near, far = table.cameras
    near.number, far.number = far.number, near.number


def exchange_mounts(table):
    table.wired = table.wired[2:] + table.wired[:2]


def exchange_axes(table):
    table.wired[:2] = reversed(table.wired[:2])


def reverse_all_wires(table):
    for actuator in table.actuators:
        actuator.sign = -1


def reverse_the_wires_of_one_axis(table):
    table.actuators[0].sign = -1


FAULTS = [
    turn_cameras,
    turn_one_camera,
    turn_cameras_over,
    exchange_cameras,
    exchange_mounts,
    exchange_axes,
    reverse_all_wires,
    reverse_the_wires_of_one_axis,
]


class Watched:
    """A rig with a fault. largest_um: how far the beam was off at any moment; closed: the gates, with the pulses by
    then, and whether a motor was on."""

    def __init__(self, profile, fault):
        self.rig = Rig(profile)
        self.table = table = self.rig.table
        fault(table)
        self.largest_um = 0.0
        self.closed = []
        sleep = table.sleep

        def watched_sleep(seconds):
            sleep(seconds)
            self.largest_um = max(self.largest_um, float(np.abs(table.truth_um()).max()))

        table.sleep = watched_sleep

    def listen(self, event):
        if isinstance(event, InterlockTripped):
            moving = any(actuator.is_moving() for actuator in self.table.actuators)
            self.closed.append((event, self.pulses, moving))

    @property
    def pulses(self):
        return sum(actuator.pulses for actuator in self.table.actuators)

    def check(self, begun_um):
        """It has ended at one gate, said why and what to do, and moved nothing then."""
        ((gate, pulses, moving),) = self.closed
        assert gate.name in ENDS
        assert not gate.clears_itself
        assert gate.cause and gate.remedy
        assert not moving
        assert pulses == self.pulses
        assert self.largest_um < begun_um + FURTHER_UM


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("profile", ["smooth", "rough"])
def test_a_hold_with_a_calibration_that_is_not_true_ends_at_a_gate(profile, fault):
    watched = Watched(profile, fault)
    table = watched.table
    for eye, spot in zip(table.cameras, table.spots_mm(), strict=True):
        eye.target_px = eye.px(spot)  # the person has set the targets anew: there is no error to begin with
    summary = Hold(table, watched.rig.response, None, watched.listen).run(300)
    watched.check(0.0)
    assert not summary.reached


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("profile", ["smooth", "rough"])
def test_an_alignment_with_a_calibration_that_is_not_true_ends_at_a_gate(profile, fault):
    watched = Watched(profile, fault)
    for eye, spot, off in zip(watched.table.cameras, watched.table.spots_mm(), (1500.0, 3300.0), strict=True):
        x, y = eye.px(spot)
        eye.target_px = x - off / eye.um_per_px[0], y - off / 2 / eye.um_per_px[1]
    summary = align(watched.table, watched.rig.response, None, watched.listen)
    watched.check(3300.0)
    assert not summary.reached


@pytest.mark.parametrize("profile", ["smooth", "rough"])
def test_a_calibration_that_is_still_true_aligns_from_there(profile):
    watched = Watched(profile, lambda _table: None)
    for eye, off in zip(watched.table.cameras, (1500.0, 3300.0), strict=True):
        x, y = eye.target_px
        eye.target_px = x - off / eye.um_per_px[0], y - off / 2 / eye.um_per_px[1]
    assert align(watched.table, watched.rig.response, None, watched.listen).reached
    assert not watched.closed
