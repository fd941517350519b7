"""Ctrl-C at moments that a person cannot choose: one line and 130, no traceback, and no board is left running."""

import os
import subprocess
import sys

import pytest
from served import HANG_S

from mirrormount.cli import main
from mirrormount_sim import board

AT_IMPORT = """
import io, signal, sys
from importlib.abc import MetaPathFinder

class At(MetaPathFinder):
    def __init__(self, name, act):
        self.name, self.act = name, act

    def find_spec(self, name, path, target=None):
        if name == self.name:
            self.act()

def interrupt():
    signal.raise_signal(signal.SIGINT)
"""
RUN = "\nfrom mirrormount.__main__ import run\nsys.exit(run())\n"


def run(code: str) -> tuple[int, str]:
    """Exit status and stderr of `mirrormount status --port virtual://` after that code."""
    command = [sys.executable, "-c", AT_IMPORT + code + RUN, "status", "--port", "virtual://"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANG_S)
    return done.returncode, done.stderr


@pytest.mark.parametrize("module", ["mirrormount.cli.main", "mirrormount.cli.status", "mirrormount.device.mount"])
def test_ctrl_c_while_a_module_is_imported_is_one_line(module):
    assert run(f"sys.meta_path.insert(0, At({module!r}, interrupt))") == (130, "mirrormount: stopped\n")


def test_ctrl_c_while_the_words_are_parsed_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr(main, "parser", interrupted)
    assert main.main(["status"]) == 130
    assert capsys.readouterr().err == "mirrormount: stopped\n"


@pytest.fixture
def boards(monkeypatch) -> list[board.Simulation]:
    """The boards that were switched on."""
    found = []
    start = board.Simulation

    def remembered(*args, **options):
        found.append(start(*args, **options))
        return found[-1]

    monkeypatch.setattr(board, "Simulation", remembered)
    return found


def interrupted(*_args) -> None:
    raise KeyboardInterrupt


def test_ctrl_c_while_a_virtual_board_starts_leaves_no_process(monkeypatch, boards):
    monkeypatch.setattr(board, "RealtimePort", interrupted)
    monkeypatch.setattr(board, "Lockstep", interrupted)
    sleeper = [sys.executable, "-c", "import sys; sys.stdin.read()"]
    monkeypatch.setattr(board.emulator, "command", lambda *_args, **_options: sleeper)
    for address in ("virtual://", "virtual://?machine=rp2040"):
        with pytest.raises(KeyboardInterrupt):
            board.open_virtual(address)
    assert len(boards) == 2
    assert all(simulation._child.poll() is not None for simulation in boards)


@pytest.mark.parametrize("machine", ["cpython", "circuitpython"])
def test_a_board_whose_folder_went_before_it_started_ends_without_a_word(machine, tmp_path):
    command = getattr(board.machines, machine)(tmp_path / "gone")
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=HANG_S)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.skipif(os.name != "posix", reason="a terminal's process groups are POSIX")
def test_a_ctrl_c_in_the_terminal_does_not_reach_the_boards_process(boards):
    simulation = board.make_simulation()
    try:
        assert os.getpgid(simulation._child.pid) != os.getpgid(0)
    finally:
        simulation.close()
