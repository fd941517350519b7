"""Each interlock: what trips it, that nothing is moved from then on, and what clears it."""

from pathlib import Path

import numpy as np
import pytest
from loop_rig import Rig

from mirrormount.errors import BoardError, NotInControl
from mirrormount_beam.control import interlocks
from mirrormount_beam.control.events import TAKE_UP, InterlockTripped
from mirrormount_beam.control.hold import Hold
from mirrormount_beam.spot.find import NoSpotReason

WHEN_S = 20.0  # after the begin of the hold


@pytest.fixture
def rig():
    return Rig()


def after(rig, seconds, action):
    rig.table.at(rig.table.now_s() + seconds, action)


def set_all(things, name, value):
    for thing in things:
        setattr(thing, name, value)


def test_a_laser_blocked_for_10_s_is_waited_for(rig):
    begin_s = rig.table.now_s()
    after(rig, WHEN_S, lambda: setattr(rig.table.truth.laser, "blocked", True))
    after(rig, WHEN_S + 10, lambda: setattr(rig.table.truth.laser, "blocked", False))
    summary = rig.run(60)
    assert rig.trips() == ["no spot"]
    assert not rig.pulses(begin_s + WHEN_S + 0.2, begin_s + WHEN_S + 10)
    assert rig.pulses(begin_s + WHEN_S + 11, begin_s + 60)
    assert summary.reached


@pytest.mark.parametrize(
    ("reason", "most"), [(NoSpotReason.SHAPE, 4), (NoSpotReason.SPLIT, 4), (NoSpotReason.NOTHING, 1)]
)
def test_frames_that_noise_alone_may_spoil_trip_no_interlock(rig, reason, most):
    eye = rig.table.cameras[1]
    eye.reason, eye.left = reason, 0
    after(rig, WHEN_S, lambda: setattr(eye, "left", most))
    after(rig, 2 * WHEN_S, lambda: setattr(eye, "left", most + 1))
    rig.run(1.5 * WHEN_S)
    assert rig.trips() == []
    rig.run(WHEN_S)
    assert len(rig.trips()) == 1


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_interlock_that_trips_behind_a_take_up_does_not_make_it_forgotten(seed):
    rig = Rig("smooth", seed)

    travel = rig.hold.guard.controller.mover.travel

    def blocked_then(response, travels, purposes):
        made = travel(response, travels, purposes)
        rig.table.truth.laser.blocked |= TAKE_UP in purposes.values()
        return made

    rig.hold.guard.controller.mover.travel = blocked_then
    rig.run(120)
    assert rig.trips() == ["no spot"]
    for actuator, gap in zip(rig.table.actuators, rig.hold.guard.controller.gaps, strict=True):
        train = actuator.train
        for way in (1, -1):
            left = train.gap_rev / 2 - way * (train.shaft_rev - train.screw_rev)
            assert not gap.in_contact(way) or left < 0.05 * train.gap_rev


def test_a_beam_that_comes_back_elsewhere_is_not_followed(rig):
    begin_s = rig.table.now_s()
    after(rig, WHEN_S, lambda: setattr(rig.table.truth.laser, "blocked", True))
    after(rig, WHEN_S + 5, lambda: rig.table.truth.bump(0, 800.0, 0.0))
    after(rig, WHEN_S + 10, lambda: setattr(rig.table.truth.laser, "blocked", False))
    summary = rig.run(60)
    assert rig.trips() == ["no spot", "spot jumped"]
    assert not rig.pulses(begin_s + WHEN_S + 0.2, begin_s + 60)
    assert not summary.reached


def test_a_person_tells_it_to_go_on_from_there(rig):
    begin_s = rig.table.now_s()
    after(rig, WHEN_S, lambda: setattr(rig.table.truth.laser, "blocked", True))
    after(rig, WHEN_S + 5, lambda: rig.table.truth.bump(0, 800.0, 0.0))
    after(rig, WHEN_S + 10, lambda: setattr(rig.table.truth.laser, "blocked", False))
    after(rig, WHEN_S + 20, rig.hold.go_on)
    after(rig, 80, rig.hold.stop)
    rig.hold.run()
    assert np.abs(rig.table.truth_um()).max() < 80
    assert rig.pulses(begin_s + WHEN_S + 20, begin_s + 80)


def test_a_beam_that_is_lost_is_not_searched(rig):
    begin_s = rig.table.now_s()
    after(rig, WHEN_S, lambda: setattr(rig.table.truth.laser, "blocked", True))
    summary = rig.run(200)
    assert not rig.pulses(begin_s + WHEN_S + 0.2, begin_s + 200)
    assert not summary.reached


@pytest.mark.parametrize(
    ("name", "value", "gate"),
    [
        ("reason", NoSpotReason.SATURATED, "spot not clear"),
        ("reason", NoSpotReason.SPLIT, "spot not clear"),
        ("reason", NoSpotReason.EDGE, "no spot"),
        ("gone", True, "camera gone"),
        ("frozen", True, "camera repeats"),
        ("stale_s", 2.0, "frames too old"),
    ],
)
def test_a_fault_of_a_camera_closes_its_gate_and_its_end_opens_it(rig, name, value, gate):
    begin_s = rig.table.now_s()
    eye = rig.table.cameras[1]
    before = getattr(eye, name)
    after(rig, WHEN_S, lambda: setattr(eye, name, value))
    after(rig, WHEN_S + 10, lambda: setattr(eye, name, before))
    summary = rig.run(60)
    assert rig.trips() == [gate]
    assert not rig.pulses(begin_s + WHEN_S + 1.0, begin_s + WHEN_S + 10)
    assert summary.reached


def test_a_bump_of_half_a_milliradian_is_corrected_within_30_s(rig):
    after(rig, WHEN_S, lambda: rig.table.truth.bump(0, 500.0, 0.0))
    back = []
    after(rig, WHEN_S + 30, lambda: back.append(np.abs(rig.table.truth_um()).max()))
    rig.run(60)
    assert rig.trips() == []
    assert back[0] < 80


def test_a_spot_further_off_than_a_correction_reaches_is_left_alone(rig):
    begin_s = rig.table.now_s()
    after(rig, WHEN_S, lambda: rig.table.truth.bump(0, 2300.0, 0.0))
    rig.run(60)
    assert rig.trips() == ["spot jumped"]
    assert not rig.pulses(begin_s + WHEN_S + 0.5, begin_s + 60)


def turn_camera(rig):
    for eye in rig.table.cameras:
        eye.rotation += np.pi / 2


def reverse_wires(rig):
    for actuator in rig.table.actuators:
        actuator.sign = -1


@pytest.mark.parametrize("fault", [turn_camera, reverse_wires])
@pytest.mark.parametrize("profile", ["smooth", "rough"])
def test_a_wrong_calibration_ends_by_a_gate_before_the_beam_runs_away(profile, fault):
    rig = Rig(profile)
    fault(rig)
    worst = []
    add = rig.hold.summary.add

    def both(time_s, errors):
        worst.append(np.abs(rig.table.truth_um()).max())
        return add(time_s, errors)

    rig.hold.summary.add = both
    summary = rig.run(300)
    assert rig.trips() in (["corrections do not help"], ["axis does not move"], ["spot jumped"])
    assert max(worst) < 3000
    assert not summary.reached


def test_an_axis_that_does_not_move_any_more_is_named(rig):
    for actuator in rig.table.actuators[::2]:
        actuator.train.travel_rev = 0.0
        actuator.train.screw_rev = 0.0
    rig.table.truth.bump(0, 100.0, 0.0)
    summary = rig.run(200)
    assert rig.trips() in (["axis does not move"], ["corrections do not help"], ["spot jumped"])
    assert not summary.reached


def test_a_refusal_of_the_board_stops_the_loop(rig):
    after(rig, WHEN_S, lambda: set_all(rig.table.actuators, "refuses", BoardError(107, "positive end-stop")))
    summary = rig.run(120)
    assert rig.trips() == ["board"]
    assert "end-stop" in summary.interlocks[0].cause


def test_a_motion_that_ended_early_stops_the_loop(rig):
    after(rig, WHEN_S, lambda: set_all(rig.table.actuators, "ended", "keep-alive lost"))
    rig.run(120)
    assert rig.trips() == ["board"]


def test_a_person_who_takes_over_is_not_disturbed(rig):
    begin_s = rig.table.now_s()
    after(rig, WHEN_S, lambda: setattr(rig.table, "taken_over", "a page of the panel took control"))
    rig.run(60)
    assert rig.trips() == ["somebody took over"]
    assert not rig.pulses(begin_s + WHEN_S + 0.5, begin_s + 60)


def test_after_a_person_it_goes_on_when_it_is_told_to():
    rig = Rig()
    begin_s = rig.table.now_s()
    after(rig, WHEN_S, lambda: setattr(rig.table, "taken_over", "a page of the panel took control"))
    after(rig, WHEN_S + 20, rig.hold.go_on)
    after(rig, 100, rig.hold.stop)
    rig.hold.run()
    assert rig.pulses(begin_s + WHEN_S + 20, begin_s + 100)


def test_it_stands_still_while_the_person_keeps_control(rig):
    def refuse():
        raise NotInControl("a page has control")

    begin_s = rig.table.now_s()
    rig.table.take_control = refuse
    after(rig, WHEN_S, lambda: setattr(rig.table, "taken_over", "a page of the panel took control"))
    after(rig, WHEN_S + 20, rig.hold.go_on)
    after(rig, 100, rig.hold.stop)
    rig.hold.run()
    assert not rig.pulses(begin_s + WHEN_S + 0.5, begin_s + 100)


def test_it_does_not_go_on_with_another_board_in_the_place_of_a_lost_one(rig):
    begin_s = rig.table.now_s()
    after(rig, WHEN_S, lambda: setattr(rig.table, "lost_board", "the board does not answer"))
    after(rig, WHEN_S + 10, lambda: setattr(rig.table.actuators[2], "board_id", "another board"))
    after(rig, WHEN_S + 20, rig.hold.go_on)
    after(rig, 100, rig.hold.stop)
    rig.hold.run()
    assert rig.trips() == ["board"]
    assert not rig.pulses(begin_s + WHEN_S + 0.5, begin_s + 100)


def test_after_a_restart_nothing_moves_before_the_beam_was_seen(rig):
    rig.table.truth.laser.blocked = True
    rig.table.truth.bump(0, 700.0, 0.0)
    begin_s = rig.table.now_s()
    told = []
    again = Hold(rig.table, rig.response, None, told.append)
    after(rig, 10, lambda: setattr(rig.table.truth.laser, "blocked", False))
    again.run(60)
    assert [event.name for event in told if isinstance(event, InterlockTripped)] == ["no spot"]
    pulses = [event.time_s for event in told if type(event).__name__ == "Pulsed"]
    assert pulses
    assert min(pulses) > begin_s + 10
    assert np.abs(rig.table.truth_um()).max() < 80


def test_every_interlock_has_its_number_once():
    numbers = [each.number for each in interlocks.INTERLOCKS]
    assert numbers == list(range(1, len(numbers) + 1))


def test_the_page_lists_every_interlock():
    page = (Path(__file__).parents[2] / "docs" / "hold.md").read_text(encoding="utf-8")
    for each in interlocks.INTERLOCKS:
        itself = "yes" if each.clears_itself else "no"
        assert f"| {each.number} | {each.name} | {each.cause} | {each.remedy} | {itself} |" in page
