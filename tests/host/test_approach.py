"""The last part of a way in one direction: what the pins do, what a stop and a limit leave."""

import pytest

from mirrormount.cli.main import main
from mirrormount.device.mount import Mount
from mirrormount.device.status import Limits
from mirrormount.errors import BadValue, MountError, MoveEnded
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_port

BITS = {"m2_pos": 1, "m2_neg": -1}


@pytest.fixture
def board():
    port = open_port("virtual://?speed=max&profile=smooth")  # both directions alike: only the gap is left to show
    with Mount(Link(port)) as mount:
        yield mount, lambda: directions(port.simulation.edges)


def directions(edges):
    """The direction of each pulse of x: what its bridge was told when it was switched on."""
    sign, told = 0, []
    for _us, pin, level in edges:
        if pin in BITS and level:
            sign = BITS[pin]
        elif pin == "m2_en" and level:
            told.append(sign)
    return told


@pytest.mark.parametrize(
    ("n", "approach", "first", "last"),
    [(5, "+", 2, 3), (-5, "+", -8, 3), (1, "+", -2, 3), (5, "-", 8, -3), (-5, "-", -2, -3), (-5.5, "+", -9, 3.5)],
)
def test_the_last_pulses_of_a_step_go_in_the_direction_of_the_approach(board, n, approach, first, last):
    mount, pulses = board
    mount.x.move_by(n, approach=approach)
    assert mount.x.position == n
    sign = 1 if first > 0 else -1
    assert pulses() == [sign] * abs(first) + [1 if last > 0 else -1] * (int(abs(last)) + (last % 1 > 0))


def test_a_backlash_that_the_board_takes_up_is_gone_past(board):
    mount, pulses = board
    mount.x.take_up_us = 900_000  # 4.5 steps
    mount.x.move_to(-10, approach="+")
    assert mount.x.position == -10
    back = pulses()
    assert back.count(-1) >= 16 and back[-6:] == [1] * 6


def test_an_approach_ends_where_the_mirror_was_whichever_way_it_came(board):
    mount, _ = board
    places = []
    for away in (7, -7):
        mount.x.move_to(away)
        mount.x.move_to(0, approach="+")
        places.append(mount.link.port.simulation.bench.spot_mm()[0])
    assert abs(places[0] - places[1]) < 0.6  # of a step's 3.3 mm, and a gap's 4.9


@pytest.mark.parametrize(("n", "approach", "why"), [(4, "-", r"turns at \+7"), (6, "+", r"ends at \+6")])
def test_a_limit_that_an_approach_would_cross_is_told_before_any_motion(board, n, approach, why):
    mount, pulses = board
    mount.x.limits = Limits(-5, 5)
    with pytest.raises(BadValue, match=why):
        mount.x.step(n, approach=approach)
    assert pulses() == [] and mount.x.position == 0


def test_a_stop_in_the_first_motion_ends_the_approach(board):
    mount, pulses = board
    with pytest.raises(MoveEnded):
        mount.x.step(-3, approach="+", progress=lambda _status: mount.stop())
    assert -6 < mount.x.position < 0
    assert 1 not in pulses() and not mount.status().moving


def test_a_stop_between_the_two_motions_ends_the_approach(board, monkeypatch):
    mount, pulses = board
    axis_type, wait = type(mount.x), type(mount.x).wait

    def stopped_after(axis, progress=None):
        ended = wait(axis, progress)
        mount.stop()
        return ended

    monkeypatch.setattr(axis_type, "wait", stopped_after)
    with pytest.raises(MountError):
        mount.x.step(-3, approach="+")
    assert pulses() == [-1] * 6 and mount.x.position == -6


def test_ctrl_c_in_the_first_motion_stops_and_ends_the_approach(board):
    mount, pulses = board

    def press(_status):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mount.x.step(-3, approach="+", progress=press)
    assert 1 not in pulses() and not mount.status().moving


@pytest.mark.parametrize("options", [{"wait": False}, {"by_sight": True}])
def test_an_approach_that_nobody_waits_for_is_refused(board, options):
    mount, pulses = board
    with pytest.raises(BadValue, match="two motions"):
        mount.x.step(2, approach="+", **options)
    assert pulses() == []


def test_the_shell_takes_an_approach(capsys):
    assert main(["step", "x", "2", "--approach", "-", "--port", "virtual://?speed=max"]) == 0
    assert capsys.readouterr().out == "x: moved +2 steps, now at +2 (unknown)\n"
    assert main(["move", "x", "-1", "--approach", "+", "--port", "virtual://?speed=max"]) == 0
    assert capsys.readouterr().out == "x: moved -1 steps, now at -1 (unknown)\n"
