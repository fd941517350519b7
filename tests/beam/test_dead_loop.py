"""A loop that is killed, frozen or cut off at any moment, on real firmware: by the boards' own pins and time.

A killed process sends no byte more, and a frozen one none for a while: that is all that a board sees of it.
"""

import contextlib

import pytest
from board_rig import BoardTable, Died

from mirrormount.errors import MountError
from mirrormount.values import KEEP_ALIVE_MS
from mirrormount_beam.control.events import InterlockTripped
from mirrormount_beam.control.hold import Hold, align
from mirrormount_beam.control.response import load, save

OFF_S = KEEP_ALIVE_MS / 1000 + 0.002  # the board looks at its clock once a millisecond
OFF_UM = 2500.0


@pytest.fixture
def table():
    with BoardTable() as table:
        table.be_off(OFF_UM)
        yield table


def die(part):
    """Of the message at which it happens only this part is sent."""

    def action(port, data):
        port.send(data[: round(part * len(data))])
        port.table.dead = True

    return action


def killed(table):
    """Run an alignment in which the loop's process dies; then let a second pass on the boards."""
    with contextlib.suppress(Died, MountError):  # what the process would still have done reaches no board
        align(table, table.response)
    assert table.dead
    table.virtual.sleep(1.0)


def finish(table):
    """Watch the motions to their ends."""
    while any(actuator.is_moving() for actuator in table.actuators):
        table.sleep(0.03)


def check_off(table, number, last_s):
    """No motor of that board was on longer than the keep-alive allows after a time."""
    for _, to_s in table.on(number):
        assert to_s is not None
        assert to_s <= last_s + OFF_S


@pytest.mark.parametrize(("n", "part"), [(8, 1.0), (30, 0.5), (61, 1.0), (97, 0.9), (110, 0.2), (125, 0.0), (140, 1.0)])
def test_a_loop_that_is_killed_at_any_moment_leaves_motors_off_and_settings_alone(table, n, part):
    before = [mount.settings() for mount in table.mounts]
    table.at(n, die(part))
    killed(table)
    for number, port in enumerate(table.sent):
        check_off(table, number, port.heard_s)
    table.start()
    assert [mount.settings() for mount in table.mounts] == before


@pytest.mark.parametrize("n", [1, 2, 9, 16])
def test_a_loop_that_is_killed_while_a_motor_is_on(table, n):
    table.at(n, die(0.5), only_moving=True)
    killed(table)
    assert any(to_s > min(port.heard_s for port in table.sent) for number in (0, 1) for _, to_s in table.on(number))
    for number, port in enumerate(table.sent):
        check_off(table, number, port.heard_s)


def test_many_steps_of_a_loop_that_dies_end_by_the_keep_alive(table):
    actuator = table.actuators[0]
    actuator.step(50)
    table.at(3, die(1.0))
    with pytest.raises(Died):
        finish(table)
    table.virtual.sleep(1.0)
    check_off(table, 0, table.sent[0].heard_s)
    assert not table.on(1)


@pytest.mark.parametrize("n", [1, 8])
def test_a_loop_that_was_frozen_stands_still_when_it_wakes_up(table, n):
    begun_s = []

    def freeze(_port, _data):
        begun_s.append(table.now_s())
        table.virtual.sleep(3.0)

    table.actuators[0].step(50)
    table.actuators[2].step(50)
    table.at(n, freeze)
    with pytest.raises(MountError, match="keep-alive"):
        finish(table)
    table.virtual.sleep(3.0)
    for number in (0, 1):
        check_off(table, number, begun_s[0])


def test_an_alignment_that_was_frozen_in_a_pulse_gives_no_more_than_that_pulse_meanwhile(table):
    begun_s = []

    def freeze(_port, _data):
        begun_s.append(table.now_s())
        table.virtual.sleep(3.0)

    table.at(4, freeze, only_moving=True)
    align(table, table.response)
    woke_s = begun_s[0] + 3.0
    for number in (0, 1):
        assert not [on for on in table.on(number) if on[1] > begun_s[0] + OFF_S and on[0] < woke_s]


@pytest.mark.parametrize("n", [10, 40, 64, 96])
@pytest.mark.parametrize("number", [0, 1])
def test_a_board_that_is_unplugged_at_any_moment_ends_it_for_both(table, n, number):
    cut_s = []

    def unplug(_port, _data):
        cut_s.append(table.now_s())
        table.sent[number].close()

    told = []
    table.at(n, unplug)
    summary = align(table, table.response, None, told.append)
    table.virtual.sleep(1.0)
    (gate,) = [event for event in told if isinstance(event, InterlockTripped)]
    assert gate.name == "board" and gate.cause and gate.remedy
    assert not summary.reached
    assert all(to_s <= cut_s[0] + 0.001 for _, to_s in table.on(number))
    assert all(to_s <= gate.time_s for _, to_s in table.on(1 - number))  # which the loop may have needed alone


@pytest.mark.parametrize("how", ["killed", "unplugged"])
def test_after_a_restart_it_goes_on_from_what_was_saved_and_moves_nothing_unseen(table, tmp_path, how):
    save(table.response, tmp_path / "calibration.json")
    if how == "killed":
        table.at(96, die(0.5))
        killed(table)
    else:
        table.at(96, lambda _port, _data: table.sent[1].close())
        align(table, table.response)
        table.virtual.replug(1)
    table.start()
    table.be_off(150.0)
    moved = [len(table.on(number)) for number in (0, 1)]
    table.truth.laser.blocked = True
    told = []
    hold = Hold(table, load(tmp_path / "calibration.json", table), None, told.append)
    unblock_s = table.now_s() + 5.0
    table.virtual.clock.at(unblock_s, lambda: setattr(table.truth.laser, "blocked", False))
    hold.run(25)
    assert [event.name for event in told if isinstance(event, InterlockTripped)] == ["no spot"]
    first_s = [table.on(number)[had][0] for number, had in enumerate(moved) if len(table.on(number)) > had]
    assert min(first_s) > unblock_s
    assert abs(hold.summary.last_um).max() < 80


@pytest.mark.parametrize("fault", ["mounts exchanged", "a sign", "a camera turned"])
def test_a_wrong_calibration_leaves_the_pins_off(fault):
    with BoardTable(exchanged=fault == "mounts exchanged") as table:
        table.be_off(1200.0)
        if fault == "a sign":
            table.mounts[0].apply({"x": {"inverted": 1}})
        elif fault == "a camera turned":
            table.cameras[1].rotation += 1.5708
        closed = []

        def listen(event):
            if isinstance(event, InterlockTripped):
                closed.append((event.name, table.moving(), [len(table.on(number)) for number in (0, 1)]))

        Hold(table, table.response, None, listen).run(120)
        table.virtual.sleep(1.0)
        assert [len(table.on(number)) for number in (0, 1)] == closed[0][2]
        assert closed[0][:2] in (("corrections do not help", False), ("spot jumped", False))
        assert abs(table.cameras[1].px(table.spots_mm()[1])[0] - 319.5) * 50 < 5000
