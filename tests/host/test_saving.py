"""What is saved on the virtual boards, by the port that a board has; and a recorded position at the prompt."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from test_repl import PROMPT

from mirrormount.errors import EmulatorMissing
from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.clocks import Lockstep
from mirrormount_sim.machines import new_files
from mirrormount_sim.simulation import START_US

RECORDED_US = 10_800_000
SWITCHED_ON = Callable[[], Lockstep]


@pytest.fixture(params=["cpython", "micropython"])
def machine(request) -> str:
    return request.param


@pytest.fixture
def files(tmp_path) -> Path:
    return new_files(tmp_path)


@pytest.fixture
def switch_on(machine, files) -> Iterator[SWITCHED_ON]:
    """A board that has just started; the one before it loses its power."""
    boards: list[Lockstep] = []

    def on() -> Lockstep:
        if boards:
            boards.pop().simulation.close()
        try:
            boards.append(Lockstep(make_simulation(Options(machine=machine, files=files))))
        except EmulatorMissing as e:
            pytest.skip(str(e))
        boards[0].boot()
        return boards[0]

    yield on
    for board in boards:
        board.simulation.close()


def ask(board: Lockstep, line: bytes) -> bytes:
    board.received.clear()
    board.send(line)
    assert board.run(1_000_000, lambda: b"\n" in board.received)
    return bytes(board.received)


def test_settings_and_positions_survive_a_power_cut_and_a_second_save(switch_on):
    for pulse_us in (b"150000", b"90000"):
        board = switch_on()
        assert ask(board, b"1XP%s;SM;1DH7;TE?\n" % pulse_us) == b"0\r\n"
        board.run(RECORDED_US)
        assert ask(switch_on(), b"1XP?;1TP?;TE?\n") == pulse_us + b"; 7; 0\r\n"


@pytest.mark.parametrize("name", ["mountfw.settings", "mountfw.position"])
def test_a_file_that_would_not_fit_the_memory_is_a_damaged_one(switch_on, files, name):
    (files / name).write_bytes(b"0" * 2_000_000)
    assert ask(switch_on(), b"TE?;TE?;1XP?\n") == b"63; 0; 200000\r\n"


def test_settings_that_cannot_be_read_are_damaged_ones(switch_on, files):
    (files / "mountfw.settings").mkdir()
    assert ask(switch_on(), b"TE?;TE?;1XP?\n") == b"63; 0; 200000\r\n"


def say(board: Lockstep, line: str) -> str:
    """Type a line at the prompt; its answer."""
    board.received.clear()
    board.send(line.encode() + b"\r")
    assert board.run(5_000_000, lambda: board.received.endswith(PROMPT) and line.encode() in board.received)
    return bytes(board.received).decode()


REMEMBER_WHEN = "gone = []; f = p.remove; p.remove = lambda n: (f(n), gone.append(p.ticks_us()))"


@pytest.mark.parametrize("machine", ["micropython"])
@pytest.mark.parametrize("line", ["m.y.step(1)", "m.x.move_to(-1)", "m.y.jog(1, ms=50)", "m.drive(0, -9, ms=50)"])
def test_at_the_prompt_the_record_is_gone_before_the_first_pin_rises(switch_on, files, line):
    board = switch_on()
    assert ask(board, b"1DH7;2DH7;TE?\n") == b"0\r\n"
    board.run(RECORDED_US)
    assert (files / "mountfw.position").exists()
    board.received.clear()
    board.send(b"\x03")
    assert board.run(5_000_000, lambda: board.received.endswith(PROMPT))
    say(board, "from mountfw.repl import m; from mountfw.ports import micropython as p; import os")
    say(board, REMEMBER_WHEN)
    say(board, "os.chdir('mountfw')")  # whatever somebody does there
    assert (files / "mountfw.position").exists()
    board.simulation.edges.clear()
    assert "Error" not in say(board, line)
    (gone_ticks,) = re.findall(r"\[(\d+)\]", say(board, "gone"))
    gone_us = (int(gone_ticks) - START_US) % (1 << 30)
    rises = [us for us, _, duty in board.simulation.edges if duty]
    assert rises and gone_us < rises[0]
    assert not (files / "mountfw.position").exists()
    assert ask(switch_on(), b"XS?\n").split(b",")[-1] == b"0\r\n"
