"""The firmware counts an encoder with the real PIO program on the real image, and moves by what it counts."""

from dataclasses import replace

import pytest
from test_memory import SESSION

from mirrormount_sim.profiles import SMOOTH
from mirrormount_sim.simulation import START_US

FAST = 2.03  # times the motors' nominal voltage: 3000 edges a second


def truth(board) -> list[int]:
    """What the two discs have turned, in edges."""
    bench = board.simulation.bench
    return [bench.encoders[motor].count(bench.trains[motor]) for motor in ("m1", "m2")]


def counts(board) -> list[int]:
    return [int(word) for word in board.ask(b"1XC?;2XC?\n").split(b";")]


def closed(board) -> None:
    assert board.ask(b"1XN280;2XN280;1MM1;2MM1;1DH0;2DH0;TB?\n", 1_000_000) == b"0, NO ERROR DETECTED\r\n"


@pytest.mark.full
def test_no_edge_is_lost_at_3000_a_second_on_both_axes_at_once(make_board):
    board = make_board(encoder="motor", profile=replace(SMOOTH, supply=FAST))
    counted, true = counts(board), truth(board)
    board.send(b"1XM60000;2XM60000;1MV+;2MV-\n")
    for data in SESSION[:3]:  # the loop has other work, too
        board.run(250_000)
        board.send(data)
    board.run(250_000)
    board.send(b"1ST;2ST\n")
    board.run(300_000)
    turned = [after - before for before, after in zip(true, truth(board), strict=True)]
    assert turned[0] > 2_900 and turned[1] < -2_900  # in a second
    assert [after - before for before, after in zip(counted, counts(board), strict=True)] == turned


@pytest.mark.full
def test_steps_of_the_closed_loop_are_their_counts_on_the_real_image(make_board):
    board = make_board(encoder="motor", profile=replace(SMOOTH, supply=0.8))
    closed(board)
    for way in (1, 1, -1, -1):
        before = truth(board)[0]
        board.send(b"1PR%d\n" % way)
        board.run(20_000)
        assert board.run(3_000_000, lambda: board.ask(b"1MD?\n") == b"1\r\n")
        assert abs(truth(board)[0] - before - 280 * way) <= 2
    assert board.ask(b"XS?\n").split(b"|")[1].split(b",")[5] == b"4"


@pytest.mark.full
def test_a_stalled_motor_is_off_within_80_ms_on_the_real_image(make_board):
    board = make_board(encoder="motor")
    closed(board)
    board.send(b"1PR5\n")
    board.run(120_000)
    assert not board.off()
    board.simulation.bench.disturb("m1", "broken")
    at = board.simulation.now_us - START_US
    board.run(200_000)
    assert board.off()
    assert [us for us, wire, level in board.edges_after(at) if wire == "m1_en" and not level][-1] - at < 80_000
    assert board.ask(b"TB?;1XE?\n").startswith(b"147, AXIS 1 MOTOR STALLED; 13,")


@pytest.mark.full
def test_a_sensor_that_does_not_answer_holds_the_loop_up_by_no_time_out(make_board):
    board = make_board(encoder="shaft")
    assert board.ask(b"1XN97;1MM1;1DH0;TB?\n", 1_000_000) == b"0, NO ERROR DETECTED\r\n"
    board.simulation.bench.disturb("m1", "broken")
    board.run(1_000_000)
    begun_us = board.simulation.us
    assert board.ask(b"XS?\n", 2_000_000)
    # 50 ms a look are the time-out of the bus, which a chip that hears no acknowledge does not wait for: 800 ms in all
    assert board.simulation.us - begun_us < 200_000
