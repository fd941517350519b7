"""A hand on an actuator's knob while the beam is held: it is corrected, or ends at a gate; nothing runs away."""

import numpy as np
import pytest
from board_rig import BoardTable
from loop_rig import Rig

from mirrormount_beam.control.events import InterlockTripped
from mirrormount_beam.control.hold import Hold

WHEN_S = 20.0  # after the begin of the hold
ENDS = ("corrections do not help", "axis does not move", "spot jumped")
FURTHER_UM = 1000.0  # than the hand has brought it


class Turned:
    """A hold in which the knob of one axis is turned by so many revolutions in so many seconds."""

    def __init__(self, profile, axis, rev, seconds):
        self.rig = Rig(profile)
        table = self.rig.table
        self.train = table.actuators[axis].train
        self.largest_um = 0.0
        begin_s = table.now_s()
        for beat in range(round(seconds * 10)):
            table.at(begin_s + WHEN_S + beat / 10, lambda: self._turn(rev / seconds))
        sleep = table.sleep

        def watched(span_s):
            sleep(span_s)
            self.largest_um = max(self.largest_um, float(np.abs(table.truth_um()).max()))

        table.sleep = watched
        self.summary = self.rig.run(90)
        self.off_um = float(np.abs(table.truth_um()).max())
        self.gates = [event for event in self.rig.told if isinstance(event, InterlockTripped)]

    def _turn(self, rev_s):
        self.train.hand_rev_s, self.train.hand_s = rev_s, 0.1


@pytest.mark.parametrize("axis", [0, 3])
@pytest.mark.parametrize("profile", ["smooth", "rough"])
def test_a_touch_is_corrected(profile, axis):
    turned = Turned(profile, axis, 0.003, 0.5)
    assert not turned.gates
    assert turned.off_um < 80


@pytest.mark.parametrize("axis", [0, 1, 2, 3])
@pytest.mark.parametrize("profile", ["smooth", "rough"])
@pytest.mark.parametrize(("rev", "seconds"), [(0.05, 0.5), (-0.05, 0.5), (0.15, 1.0), (0.1, 20.0)])
def test_a_turn_of_the_knob_is_corrected_or_ends_at_a_gate_that_moves_nothing(profile, axis, rev, seconds):
    turned = Turned(profile, axis, rev, seconds)
    rig = turned.rig
    if not turned.gates:
        assert turned.off_um < 80
        return
    (gate,) = turned.gates
    assert gate.name in ENDS and gate.cause and gate.remedy
    assert not rig.pulses(gate.time_s, rig.table.now_s())
    assert not any(actuator.is_moving() for actuator in rig.table.actuators)
    alone = Rig(profile)  # the same knob, turned as far where nobody holds the beam
    alone.table.actuators[axis].train.screw_rev += rev
    assert turned.largest_um < float(np.abs(alone.table.truth_um()).max()) + FURTHER_UM


@pytest.mark.parametrize("axis", [0, 1, 2, 3])
@pytest.mark.parametrize("profile", ["smooth", "rough"])
def test_a_knob_that_is_held_fast_ends_at_a_gate(profile, axis):
    rig = Rig(profile)
    rig.table.actuators[axis].train.jammed = True
    rig.table.truth.bump(axis // 2, *((0.0, 300.0) if axis % 2 else (300.0, 0.0)))
    rig.run(200)
    (gate,) = [event for event in rig.told if isinstance(event, InterlockTripped)]
    assert gate.name in ENDS
    assert not rig.pulses(gate.time_s, rig.table.now_s())


@pytest.mark.full
@pytest.mark.parametrize("fault", ["hand", "jammed"])
@pytest.mark.parametrize("motor", ["m1", "m2"])
def test_a_hand_on_a_knob_leaves_the_pins_off(fault, motor):
    with BoardTable() as table:
        table.be_off(400.0)  # so that it drives
        bench = table.virtual.simulations[0].bench
        table.virtual.clock.at(table.now_s() + 4.0, lambda: bench.disturb(motor, fault))
        told = []

        def listen(event):
            if isinstance(event, InterlockTripped):
                told.append((event, table.moving(), [len(table.on(number)) for number in (0, 1)]))

        hold = Hold(table, table.response, None, listen)
        # the other three axes help for a while: it says after 40 to 160 s that it fails
        table.virtual.clock.at(table.now_s() + 240.0, hold.stop)
        hold.run(240)
        table.virtual.sleep(1.0)
        assert not table.moving()
        for gate, moving, driven in told:
            assert gate.name in ENDS and not moving
            assert driven == [len(table.on(number)) for number in (0, 1)]
        if not told:
            assert abs(hold.summary.last_um).max() < 80
