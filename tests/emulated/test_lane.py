"""The fast lane on a real image (docs/gate.md): a board file may leave it out, and nothing but times differs."""

import shutil

import pytest

from mirrormount.deploy.firmware import firmware
from mirrormount_sim import emulator
from mirrormount_sim.emulator import mpy_of
from mirrormount_sim.machines import THIS

ENABLES = ("m1_en", "m2_en")
LANE_US, PYTHON_US = 900, 1_200  # a frame reaches both motors before the first with the lane, after the second without


@pytest.fixture(params=[True, pytest.param(False, marks=pytest.mark.full)], ids=["lane", "no-lane"])
def lane(request) -> bool:
    return request.param


@pytest.fixture
def board(lane, make_board, tmp_path):
    text = f"from mountfw.boards.pico import *\n\nLANE = {lane}\n"
    flash = tmp_path / "flash.bin"
    files = firmware(mpy_of(emulator.find_image(None))) | {THIS: text.encode()}
    shutil.copyfile(emulator.flash_with_firmware(None, files), flash)
    return make_board("rp2040", flash=flash)


def both_on_us(board, frame: bytes) -> int:
    """From a frame's sending, while the loop sleeps, to the last enable's edge."""
    board.run(20_000)
    board.simulation.edges.clear()
    since_us = board.simulation.us
    board.send(frame)
    board.run(20_000)
    return max(us for us, pin, _ in board.simulation.edges if pin in ENABLES) - since_us


def positions(board) -> list[int]:
    return [int(board.ask(b"%dTP?\n" % axis)) for axis in (1, 2)]


def millisteps(board) -> list[int]:
    return [int(axis.split(b",")[0]) for axis in board.ask(b"XS?\n").split(b"|")[1:]]


def test_frames_stops_and_steps_are_obeyed_told_and_counted_with_the_lane_and_without(board, lane):
    # steps of 10 ms; the first frame takes the record of the position off the flash
    board.send(b"1XP10000;2XP10000;1DH100;2DH100\n0100-100")
    board.run(100_000)
    board.send(b"!\n")
    board.run(100_000)
    before = millisteps(board)

    late_us = both_on_us(board, b"0255-255")
    assert (late_us < LANE_US) if lane else (late_us > PYTHON_US), late_us
    board.run(300_000)
    board.send(b"!\n")
    board.run(100_000)
    assert board.off() and b"0255-255" in board.received
    # 320 ms from the frame's last byte to the stop's landing, less what the frame took, and a little for the stop
    made = [new - old for old, new in zip(before, millisteps(board), strict=True)]
    driven = (320_000 - late_us) // 10
    assert abs(made[0] - driven) < 100 and abs(made[1] + driven) < 100, (made, driven)
    after = positions(board)

    board.send(b"1PR3;2PR-2\n")
    board.run(3_000_000)
    assert positions(board) == [after[0] + 3, after[1] - 2]
    board.send(b"02550255" + b"0" * 8)
    board.run(100_000)
    assert board.off() and board.ask(b"TB?\n").startswith(b"0,")


@pytest.mark.full
def test_what_comes_behind_a_ctrl_c_is_the_prompts(board):
    for delay_us in range(0, 1000, 150):  # native code looks for input, and it must not read past an interrupt
        board.run(delay_us)
        board.send(b"\x03\x03\r\x01")
        board.until(b"raw REPL; CTRL-B to exit\r\n>")
        board.simulation.lit = False
        board.send(b"\x02\x04")
        board.boot()
