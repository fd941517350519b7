"""The mount at the prompt of a real MicroPython on the emulated RP2040: real timing, PWM, Ctrl-C over USB."""

import random

import pytest
from lab import on_times_us

from mirrormount_sim.profiles import SWITCH_REV

STEP_US = 200_000
LATE_US = 400  # from a deadline to the pin: some calls of Python


@pytest.fixture
def board(make_board):
    board = make_board("rp2040", bench="switches")
    assert board.ask(b"2XL3;1DH0;2DH0;TE?\n") == b"0\r\n"
    board.send(b"\x03")
    board.until(b">>> ")
    assert b"Error" not in type_line(board, "from mountfw.repl import m")
    return board


def type_line(board, line: str) -> bytes:
    board.send(line.encode() + b"\r")
    return board.until(b"\n>>> ")


def on_times(board, pin: str, since_us: int) -> list[int]:
    return on_times_us(board.edges_after(since_us), pin)


@pytest.mark.full
def test_steps_and_jogs_last_what_they_should(board, capsys):
    start_us = board.simulation.us
    type_line(board, "m.x.step(5)")
    steps = on_times(board, "m2_en", start_us)
    type_line(board, "m.y.jog(-1, ms=800)")
    (jog,) = on_times(board, "m1_en", start_us)
    assert steps == pytest.approx([STEP_US] * 5, abs=LATE_US)
    assert max(steps) - min(steps) < 50
    assert jog == pytest.approx(800_000, abs=LATE_US)
    assert b"x: +5.000 steps (counted), end-stops: -, last move: done" in type_line(board, "m.status()")
    with capsys.disabled():
        print(f"\nat the emulated RP2040's prompt: steps of {steps} us, a jog of {jog} us")


@pytest.mark.full
def test_an_end_stop_is_told_in_words(board):
    train = board.simulation.bench.horizontal
    train.screw_rev = train.shaft_rev = SWITCH_REV - 0.06
    assert b"MoveEnded: x: positive end-stop reached after 3 steps" in type_line(board, "m.x.step(9)")
    assert board.off()
    assert b"x: positive end-stop reached after 0 steps" in type_line(board, "m.x.jog(1, ms=100)")
    assert b"Error" not in type_line(board, "m.x.step(-5)")


@pytest.mark.full
def test_ctrl_c_twice_at_any_moment_turns_the_motors_off_and_leaves_the_prompt(board):
    moments = random.Random(7)
    for line in ["m.y.step(2)", "m.drive(-255, 255, ms=3000)"] * 10:
        board.send(line.encode() + b"\r")
        assert board.run(2_000_000, lambda: not board.off())
        board.run(moments.randrange(STEP_US - 1_000))
        board.send(b"\x03\x03")
        assert board.run(10_000, board.off)
        assert b"KeyboardInterrupt" in board.until(b"\n>>> ")
        assert board.off()
    start_us = board.simulation.us
    type_line(board, "m.y.step(1)")
    assert on_times(board, "m1_en", start_us) == pytest.approx([STEP_US], abs=LATE_US)


@pytest.mark.full
def test_wrong_arguments_move_nothing(board):
    for line in (
        "m.x.step('5')",
        "m.x.step(10**9)",
        "m.y.jog(2, ms=10)",
        "m.y.jog(0.5, ms=10**9)",
        "m.drive(0, 256, 9)",
    ):
        assert b"ValueError: " in type_line(board, line)
        assert board.off()


@pytest.mark.full
def test_ctrl_d_starts_the_firmware_again(board):
    type_line(board, "m.x.step(1)")
    board.send(b"\x04")
    board.until(b"soft reboot")
    board.simulation.lit = False  # it was lit: the boot is over when it is so again
    board.boot()
    assert board.ask(b"*IDN?\n", 5_000_000).startswith(b"mirrormount,")


@pytest.mark.full
def test_ctrl_c_at_any_moment_of_a_start_leaves_the_folder_of_the_firmware_as_it_is(board):
    listing = "import os; print(sorted(os.listdir('mountfw/ports')), os.stat('mountfw/motion/__init__.mpy')[6])"
    before = type_line(board, listing)
    for after_us in (20_000, 60_000, 100_000, 140_000, 300_000, 500_000):
        board.send(b"\x04")
        board.until(b"soft reboot\r\n")
        board.run(after_us)
        for _ in range(5):  # while main.py is compiled, Ctrl-C is a byte like others
            board.send(b"\x03\x03")
            if board.run(1_000_000, lambda: b">>> " in board.received):
                break
        board.until(b">>> ")
        board.run(100_000)
        board.received.clear()
        assert type_line(board, listing) == before, after_us
        assert board.off()
