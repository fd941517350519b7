"""A pin with a duty of the MicroPython port (RP2350, and virtual boards): on a virtual board, in its own time."""

from mirrormount_sim import machines
from mirrormount_sim.bench import Bench
from mirrormount_sim.simulation import Simulation

PERIOD_US = 40_000  # at 25 Hz


def duties(board, pin):
    return [round(duty / 257) for _, name, duty in board.simulation.edges if name == pin]


def test_at_25_hz_a_drive_begins_at_its_own_duty_and_a_new_one_shows_with_the_next_period(boards, tmp_path):
    board = boards(Simulation(machines.cpython(tmp_path), Bench()))
    board.send(b"1XQ25\n02000000")
    board.run(100_000)
    board.send(b"!\n")
    board.run(10_000)
    board.simulation.edges.clear()
    board.send(b"00100000")  # in the middle of a period: what the PWM had before must not show
    board.run(10_000)
    assert duties(board, "m1_en") == [10]
    began_us = board.simulation.edges[-1][0]
    board.send(b"00200000")
    board.run(2 * PERIOD_US)
    assert duties(board, "m1_en") == [10, 20]
    assert abs(board.simulation.edges[-1][0] - began_us - PERIOD_US) < 100
    board.send(b"00300000!\n")  # cut before it could show, and it does not come later
    board.run(2 * PERIOD_US)
    assert duties(board, "m1_en")[-1] == 0 and board.simulation.bench.duties()["m1_en"] == 0
