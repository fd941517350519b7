"""Moves by sight: without the board's take-up, with short rests, and with the board's settings as they were."""

import itertools

import pytest

from mirrormount.device.mount import Mount
from mirrormount.errors import BoardError
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_port

OWN = {"take_up_us": 100_000, "velocity": 1.25}


@pytest.fixture
def board():
    """A mount, and the pulses of its axis 2: (begin, length) in us."""
    port = open_port("virtual://?speed=max")
    with Mount(Link(port)) as mount:
        mount.apply({"x": OWN})

        def pulses():
            edges = [(us, duty) for us, pin, duty in port.simulation.edges if pin == "m2_en"]
            return [(on, off - on) for (on, _), (off, _) in zip(edges[::2], edges[1::2], strict=True)]

        yield mount, pulses


def lengths(pulses):
    return [round(length, -3) for _, length in pulses]


def test_a_reversal_by_sight_takes_nothing_up(board):
    mount, pulses = board
    mount.x.step(1, by_sight=True)
    mount.x.step(-2, by_sight=True)
    mount.x.pulse(20_000, by_sight=True)
    assert lengths(pulses()) == [200_000, 200_000, 200_000, 20_000]
    assert mount.settings()["x"] | OWN == mount.settings()["x"]


def test_steps_by_sight_rest_for_50_ms(board):
    mount, pulses = board
    mount.x.step(3, by_sight=True)
    begins = [begin for begin, _ in pulses()]
    assert [round(b - a, -3) for a, b in itertools.pairwise(begins)] == [250_000, 250_000]


@pytest.mark.parametrize("pulse_us", [200, 9_000, 252_000, 960_000, 2_000_000])
def test_the_rest_is_one_that_the_board_can_make(board, pulse_us):
    mount, pulses = board
    mount.apply({"x": {"pulse_us": pulse_us}})
    before = mount.settings()
    mount.x.step(2, by_sight=True)
    (first, _), (second, _) = pulses()
    assert second - first >= pulse_us + 49_000
    assert mount.settings() == before
    assert not mount.errors()


def test_afterwards_a_move_takes_up_as_the_mount_is_set(board):
    mount, pulses = board
    mount.x.step(-1, by_sight=True)
    mount.x.step(2)
    mount.x.step(-1)
    assert lengths(pulses())[-2:] == [100_000, 200_000]


def test_a_move_that_is_refused_leaves_the_settings_as_they_were(board):
    mount, pulses = board
    mount.apply({"x": {"motor_type": 0}})
    with pytest.raises(BoardError):
        mount.x.step(1, by_sight=True)
    assert not pulses()
    assert mount.settings()["x"] | OWN == mount.settings()["x"]
