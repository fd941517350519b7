"""A board file that is there and cannot be used: no other takes its place, and no pin is driven. Virtual boards."""

import shutil
from pathlib import Path

import pytest

from mirrormount_sim import machines
from mirrormount_sim.clocks import Lockstep
from mirrormount_sim.machines import firmware_folder
from mirrormount_sim.simulation import Simulation

PICO_BUT = (firmware_folder() / "mountfw" / "boards" / "pico.py").read_text()
SLIPS = {
    "an import in it that fails": ("import no_such_module\n" + PICO_BUT, "no_such_module"),
    "an import of a board file that is not there": ("from mountfw.boards.picco import *\n", "picco"),
    "no Python": ("BRIDGE = \n", "SyntaxError"),
    "a misspelled bridge": (PICO_BUT + 'BRIDGE = "two_pwm"\n', "BRIDGE is 'two_pwm', not one of enable, two-pwm"),
    "a misspelled name": (PICO_BUT + "EMERGENCY_STOPP = 14\n", "EMERGENCY_STOPP is no name"),
}


def switched_on(machine: str, folder: Path, slip: str, name: str) -> Lockstep:
    """A board that has had its time to start, with this text as boards/NAME.py."""
    root = folder / "root"
    root.mkdir()
    shutil.copytree(firmware_folder() / "mountfw", root / "mountfw", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(root / "mountfw" / "entry" / "main.py", root / "main.py")
    (root / "mountfw" / "boards" / f"{name}.py").write_text(slip)
    (folder / "files").mkdir()
    if machine == "micropython":
        command = machines.micropython(root)
    elif machine == "cpython":
        command = machines.cpython(folder / "files", firmware=root)
    else:
        command = machines.circuitpython(folder / "files", firmware=root)
    board = Lockstep(Simulation(command))
    board.boot()
    return board


@pytest.mark.parametrize("name", ["this", "pico"])
@pytest.mark.parametrize("machine", ["cpython", "micropython", "circuitpython"])
@pytest.mark.parametrize("slip", SLIPS)
def test_a_board_file_that_cannot_be_used_is_refused_in_one_line(slip, machine, name, tmp_path, capfd):
    text, words = SLIPS[slip]
    board = switched_on(machine, tmp_path, text, name)
    try:
        board.send(b"02550255")
        board.run(200_000)
        assert board.simulation.edges == []
        shown = bytes(board.received).decode() + "".join(capfd.readouterr())
    finally:
        board.simulation.close()
    lines = [line for line in shown.splitlines() if f"boards/{name}.py cannot be used" in line]
    assert len(lines) >= 1 and words in lines[0]
    assert "Traceback" not in shown


@pytest.mark.parametrize("machine", ["cpython", "micropython", "circuitpython"])
def test_a_good_this_goes_before_the_boards_own(machine, tmp_path):
    board = switched_on(machine, tmp_path, PICO_BUT + 'NAME = b"mine"\n', "this")
    try:
        board.send(b"*IDN?\n")
        board.run(200_000, lambda: b"\n" in board.received)
        assert b"mirrormount,mine," in board.received
    finally:
        board.simulation.close()


@pytest.mark.parametrize("machine", ["cpython", "micropython", "circuitpython"])
def test_an_led_that_the_board_lacks_is_left_out(machine, tmp_path):
    """As with --board pico on another board with that chip."""
    board = switched_on(machine, tmp_path, PICO_BUT + 'LED = "NO_SUCH_LED"\n', "this")
    try:
        board.send(b"*IDN?\n")
        board.run(200_000, lambda: b"\n" in board.received)
        assert b"mirrormount,Raspberry Pi Pico," in board.received
    finally:
        board.simulation.close()
