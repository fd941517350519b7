"""Virtual boards whose board file has a third axis: the real entry files, ports and prompt.

The bench has two motors. What the third axis does shows as edges of its pins, which are probes.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest
from test_repl import PROMPT
from three_axes import THIRD, make_board_files, make_firmware

from mirrormount.errors import EmulatorMissing
from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.clocks import Lockstep

STEP_US = 200_000
CLOCK_US = {"circuitpython": 2_000}  # how far a pulse may be off


class Board(Lockstep):
    """A board with three axes that has just started."""

    def __init__(self, machine: str, root: Path) -> None:
        if machine == "micropython":
            options = Options(machine=machine, files=root / "board")
        else:
            options = Options(machine=machine, files=root / "files", firmware=root / "firmware")
        super().__init__(make_simulation(options))
        self.simulation.probes.update(THIRD)
        self.level = dict.fromkeys(THIRD.values(), 0)
        self.boot()

    def ask(self, line: bytes) -> bytes:
        self.received.clear()
        self.send(line)
        assert self.run(1_000_000, lambda: b"\n" in self.received)
        return bytes(self.received)

    def third(self) -> tuple[int, ...]:
        """Enable, pos and neg of motor 3, now."""
        for _, pin, duty in self.simulation.edges:
            if pin in self.level:
                self.level[pin] = duty
        return tuple(self.level.values())

    def off(self) -> bool:
        return not any(self.third()) and not any(self.simulation.bench.duties().values())

    def all_run(self) -> None:
        self.send(b"1MV+;2MV+;3MV+\n")
        self.run(100_000)
        assert self.third() == (65535, 65535, 0)
        assert self.simulation.bench.duties()["m1_en"] == self.simulation.bench.duties()["m2_en"] == 1


@pytest.fixture(params=["cpython", "circuitpython", "micropython"])
def machine(request) -> str:
    return request.param


@pytest.fixture
def root(machine, tmp_path) -> Path:
    """A folder with the firmware and that board file."""
    if machine == "micropython":
        (tmp_path / "board").mkdir()
        make_board_files(tmp_path / "board")
    else:
        (tmp_path / "files").mkdir()
        make_firmware(tmp_path)
    return tmp_path


@pytest.fixture
def switch_on(machine, root) -> Iterator:
    """Makes a board that has just started; the one before it loses its power."""
    boards: list[Board] = []

    def on() -> Board:
        if boards:
            boards.pop().simulation.close()
        try:
            boards.append(Board(machine, root))
        except EmulatorMissing as e:
            pytest.skip(str(e))
        return boards[0]

    yield on
    for board in boards:
        board.simulation.close()


@pytest.fixture
def board(switch_on) -> Board:
    return switch_on()


def test_a_step_of_the_third_axis_is_a_pulse_on_its_pins(board, machine):
    board.simulation.edges.clear()
    board.send(b"3PR-1\n")
    board.run(400_000)
    edges, level = [], dict.fromkeys(THIRD.values(), 0)
    for us, pin, duty in board.simulation.edges:  # of a probe each write is kept
        if level.get(pin, 0) != duty:
            edges.append((us, pin, duty))
        level[pin] = duty
    rises = [(pin, us) for us, pin, duty in edges if duty]
    falls = [(pin, us) for us, pin, duty in edges if not duty]
    assert [pin for pin, _ in rises] == ["m3_neg", "m3_en"]
    # on CircuitPython the enable falls when its PWM period is over, up to 50 us after the leg
    assert [pin for pin, _ in (sorted(falls) if machine == "circuitpython" else falls)] == ["m3_en", "m3_neg"]
    on_us = dict(falls)["m3_en"] - dict(rises)["m3_en"]
    assert on_us == pytest.approx(STEP_US, abs=CLOCK_US.get(machine, 20))
    _, *axes = board.ask(b"XS?\n").rstrip().split(b"|")
    assert len(axes) == 3
    assert axes[2] == b"-1000,0,0,0,1,0"


@pytest.mark.parametrize("stop", [b"!", b"00000000", b"ST\n", b"AB\n", b"255-\n"])
def test_a_stop_turns_all_three_motors_off(board, stop):
    board.all_run()
    sent_us = board.simulation.us
    board.send(stop)
    board.run(100_000)
    assert board.off()
    assert max(us for us, _, _ in board.simulation.edges) - sent_us < 3_000


def test_ctrl_c_turns_all_three_motors_off(board, machine):
    board.all_run()
    if machine == "circuitpython":
        board.simulation.type(b"\x03")
    else:
        board.send(b"\x03")
    board.run(200_000)
    assert board.off()


def test_settings_and_positions_of_three_axes_survive_a_power_cut(switch_on):
    board = switch_on()
    assert board.ask(b"1XP150000;2XP160000;3XP170000;SM;1DH7;2DH-8;3DH9;TE?\n") == b"0\r\n"
    board.run(10_800_000)
    asked = b"1XP?;2XP?;3XP?;1TP?;2TP?;3TP?;TE?\n"
    assert switch_on().ask(asked) == b"150000; 160000; 170000; 7; -8; 9; 0\r\n"


@pytest.mark.parametrize("machine", ["micropython"])
def test_the_prompt_has_the_third_axis_too(board):
    board.all_run()
    board.send(b"\x03")
    assert board.run(5_000_000, lambda: board.received.endswith(PROMPT))

    def say(line: str) -> str:
        board.received.clear()
        board.send(line.encode() + b"\r")
        assert board.run(5_000_000, lambda: board.received.endswith(PROMPT) and line.encode() in board.received)
        return bytes(board.received).decode().removesuffix(PROMPT.decode()).partition("\r\n")[2]

    assert say("from mountfw.repl import m") == ""
    assert say("len(m.axes), m.axes[0] is m.y, m.axes[1] is m.x") == "(3, True, True)"
    board.simulation.edges.clear()
    assert say("m.axes[2].step(2)") == ""
    rises = [us for us, pin, duty in board.simulation.edges if pin == "m3_en" and duty]
    falls = [us for us, pin, duty in board.simulation.edges if pin == "m3_en" and not duty]
    assert [fall - rise for rise, fall in zip(rises, falls, strict=True)] == pytest.approx([STEP_US] * 2, abs=20)
    assert board.off()
    last = say("m.status()").splitlines()[2]
    assert last.startswith("axis3: ") and last.endswith("last move: done")
