"""The mount at the board's own prompt, on a MicroPython VM: what the pins did."""

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from mirrormount.errors import REASONS, EmulatorMissing
from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.clocks import Lockstep
from mirrormount_sim.profiles import SWITCH_REV

PAGE = Path(__file__).parent.parent.parent / "docs" / "python.md"
STEP_US = 200_000
PROMPT = b"\r\n>>> "


class Prompt(Lockstep):
    """A board in lockstep, its firmware interrupted, somebody at its prompt."""

    def __init__(self) -> None:
        super().__init__(make_simulation(Options(machine="micropython")))
        self.bench = self.simulation.bench
        self.run(1_000_000)

    def interrupt(self) -> str:
        """Ctrl-C, and what the board says up to the prompt."""
        self.send(b"\x03")
        return self.answer()

    def answer(self) -> str:
        """Let time pass until the prompt is back; returns what was said before it."""
        assert self.run(60_000_000, lambda: self.received.endswith(PROMPT)), bytes(self.received)
        said = bytes(self.received).decode()
        self.received.clear()
        return said.removesuffix(PROMPT.decode()).strip()

    def begin(self, line: str) -> None:
        """Type a line; returns when the board has taken it in."""
        self.simulation.edges.clear()
        self.send(line.encode() + b"\r")
        echo = line.encode() + b"\r\n"
        assert self.run(1_000_000, lambda: echo in self.received)
        del self.received[: len(echo) - 2]  # the end of the line stays: a prompt begins with one

    def type(self, line: str) -> str:
        """Type a line and return its answer."""
        self.begin(line)
        return self.answer()

    def refused(self, line: str) -> str:
        """Type a line that raises, and return the exception's last line."""
        said = self.type(line)
        assert said.startswith("Traceback"), said
        return said.splitlines()[-1]

    def driving(self) -> bool:
        return self.bench.drive("m1") is not None or self.bench.drive("m2") is not None

    def pulses(self) -> list[tuple[str, int, int, int]]:
        """Each drive since the last line: the leg that was high, the duty, from, to."""
        level, since, out = {}, {}, []
        for us, pin, duty in self.simulation.edges:
            motor = pin[:2]
            if pin.endswith("_en") and duty:
                legs = [leg for leg in (f"{motor}_pos", f"{motor}_neg") if level.get(leg)]
                assert len(legs) == 1
                since[motor] = (legs[0], duty, us)
            elif pin.endswith("_en"):
                out.append((*since.pop(motor), us))
            level[pin] = duty
        assert not since
        return out

    def lengths(self, leg: str, duty: int = 65535) -> list[int]:
        """How long each drive since the last line was, all of which were this leg at this duty."""
        pulses = self.pulses()
        assert {p[:2] for p in pulses} <= {(leg, duty)}, pulses
        return [to - start for _, _, start, to in pulses]


def boards() -> Iterator[Prompt]:
    try:
        board = Prompt()
    except EmulatorMissing as e:
        pytest.skip(str(e))
    yield board
    board.simulation.close()


def prompts() -> Iterator[Prompt]:
    for board in boards():
        board.interrupt()
        assert board.type("from mountfw.repl import m") == ""
        yield board


board = pytest.fixture(boards, name="board")
prompt = pytest.fixture(prompts, name="prompt")
lasting_prompt = pytest.fixture(prompts, name="lasting_prompt", scope="module")


def test_steps_are_the_firmwares_steps(prompt):
    assert prompt.type("m.x.step(5)") == ""
    assert prompt.lengths("m2_pos") == pytest.approx([STEP_US] * 5, abs=20)
    starts = [p[2] for p in prompt.pulses()]
    assert [b - a for a, b in pairwise(starts)] == pytest.approx([500_000] * 4, abs=300)
    assert prompt.type("m.y.step(-2)") == ""
    assert prompt.lengths("m1_neg") == pytest.approx([STEP_US] * 2, abs=20)


def test_positions_read_back(prompt):
    prompt.type("m.x.step(5)")
    assert prompt.type("m.x.position") == "5.0"
    prompt.type("m.x.move_to(3)")
    assert prompt.lengths("m2_neg") == pytest.approx([STEP_US] * 2, abs=20)
    assert prompt.type("m.x.position") == "3.0"
    assert prompt.type("m.status()").splitlines() == [
        "x: +3.000 steps (unknown), end-stops: -, last move: done",
        "y: +0.000 steps (unknown), end-stops: -, last move: none yet",
    ]


def test_a_jog_lasts_its_time(prompt):
    assert prompt.type("m.y.jog(0.3, ms=800)") == ""
    assert prompt.lengths("m1_pos", round(0.3 * 255) * 257) == pytest.approx([800_000], abs=20)
    assert prompt.type("m.y.jog(-1, ms=10000)") == ""  # the run limit itself
    assert prompt.lengths("m1_neg") == pytest.approx([10_000_000], abs=20)
    assert "last move: done" in prompt.type("m.status()").splitlines()[1]


def test_a_drive_lasts_its_time_on_both_motors(prompt):
    assert prompt.type("m.drive(100, -255, ms=300)") == ""
    pulses = sorted(prompt.pulses())
    assert [(leg, duty) for leg, duty, _, _ in pulses] == [("m1_pos", 25700), ("m2_neg", 65535)]
    assert [to - start for _, _, start, to in pulses] == pytest.approx([300_000] * 2, abs=300)
    assert prompt.type("m.drive(0, 0, ms=300)") == ""
    assert prompt.pulses() == []


MOMENTS_US = [1, 100, *range(10_000, STEP_US, 10_700), STEP_US - 300, STEP_US - 120, STEP_US - 20]


@pytest.mark.parametrize("keys", [b"\x03", b"\x03\x03", b"\x03\x03\x03"])
def test_ctrl_c_at_any_moment_of_a_pulse_turns_the_motors_off_and_leaves_a_prompt(prompt, keys):
    for at_us in MOMENTS_US:
        prompt.begin("m.x.step(3)")
        assert prompt.run(1_000_000, prompt.driving)
        start_us = next(us for us, pin, duty in prompt.simulation.edges if pin == "m2_en" and duty)
        prompt.run(start_us + at_us - prompt.simulation.us)
        sent_us = prompt.simulation.us
        prompt.send(keys)
        assert prompt.run(2_000, lambda: not prompt.driving()), f"still driving after Ctrl-C at {at_us} us"
        assert "KeyboardInterrupt" in prompt.answer()
        assert not any(prompt.bench.duties().values())
        assert prompt.pulses()[-1][3] <= max(sent_us + 1_000, start_us + STEP_US)
        assert len(prompt.pulses()) == 1
    prompt.type("m.y.step(1)")
    assert prompt.lengths("m1_pos") == pytest.approx([STEP_US], abs=20)


def test_ctrl_c_in_a_jog_and_in_a_rest(prompt):
    prompt.begin("m.drive(80, -80, ms=5000)")
    prompt.run(700_000)
    assert prompt.bench.drive("m1") and prompt.bench.drive("m2")
    assert "KeyboardInterrupt" in prompt.interrupt()
    assert not any(prompt.bench.duties().values())
    prompt.begin("m.x.step(2)")
    prompt.run(300_000)
    assert not prompt.driving()
    assert "KeyboardInterrupt" in prompt.interrupt()
    prompt.run(1_000_000)
    assert len(prompt.pulses()) == 1
    assert "last move: aborted" in prompt.type("m.status()").splitlines()[0]


def test_an_exception_in_mid_move_turns_the_motors_off_before_it_goes_on(prompt):
    prompt.type("from mountfw.ports import micropython as p")
    prompt.type("keep, p.led = p.led, lambda on: 1 // 0")
    prompt.begin("m.x.step(1)")
    assert "ZeroDivisionError" in prompt.answer()
    assert 0 < prompt.lengths("m2_pos")[0] < STEP_US
    prompt.type("p.led = keep")
    assert prompt.type("m.x.step(1)") == ""
    assert prompt.lengths("m2_pos") == pytest.approx([STEP_US], abs=20)


def near_the_end(prompt: Prompt) -> None:
    prompt.bench.has_switches = True
    prompt.bench.horizontal.screw_rev = prompt.bench.horizontal.shaft_rev = SWITCH_REV - 0.06  # three steps and a bit
    prompt.type("m.x.axis.set('switches', 3)")


def test_an_end_stop_is_an_exception_in_words(prompt):
    near_the_end(prompt)
    assert prompt.refused("m.x.step(9)").endswith("MoveEnded: x: positive end-stop reached after 3 steps")
    assert len(prompt.pulses()) == 4
    assert "end-stops: positive, last move: end-stop reached" in prompt.type("m.status()")
    for into in ("m.x.step(1)", "m.x.jog(1, ms=100)", "m.drive(0, 9, ms=100)"):
        assert prompt.refused(into).endswith("MoveEnded: x: positive end-stop reached after 0 steps")
        assert prompt.pulses() == []
    assert prompt.type("m.x.step(-8)") == ""
    assert "x: +" not in prompt.type("m.x.position")


def test_an_end_stop_of_one_axis_ends_the_drive_of_both(prompt):
    near_the_end(prompt)
    assert "x: positive end-stop reached" in prompt.refused("m.drive(255, 255, ms=5000)")
    ends = {leg: to for leg, _, _, to in prompt.pulses()}
    assert ends["m1_pos"] - ends["m2_pos"] < 1_000
    prompt.bench.broken.add("m1_sw_pos")
    prompt.type("m.y.axis.set('switches', 1)")
    assert "y: positive end-stop reached" in prompt.refused("m.drive(255, -255, ms=5000)")
    assert all(to - start < 1_000 for _, _, start, to in prompt.pulses())


@pytest.mark.parametrize(
    "line",
    [
        "m.x.step('5')",
        "m.x.step(1.5)",
        "m.x.step(True)",
        "m.x.step(None)",
        "m.x.step(1000001)",
        "m.x.step(-1000001)",
        "m.y.move_to('here')",
        "m.y.move_to(10**30)",
        "m.y.jog('fast', ms=100)",
        "m.y.jog(1.01, ms=100)",
        "m.y.jog(0, ms=100)",
        "m.y.jog(0.001, ms=100)",
        "m.y.jog(float('nan'), ms=100)",
        "m.y.jog(0.5, ms=0)",
        "m.y.jog(0.5, ms=10001)",
        "m.y.jog(0.5, ms=0.5)",
        "m.drive(256, 0, ms=100)",
        "m.drive(0, -256, ms=100)",
        "m.drive(255, '255', ms=100)",
        "m.drive(255, 255, ms=-1)",
    ],
)
def test_wrong_arguments_move_nothing_and_say_why(lasting_prompt, line):
    said = lasting_prompt.refused(line)
    assert said.startswith("ValueError: ") and len(said) < 100
    assert lasting_prompt.simulation.edges == []


def test_it_goes_on_where_the_firmware_was(board):
    """Settings, positions and end-stops are those of the firmware that was interrupted."""
    board.bench.has_switches = True
    board.send(b"2XL3;2XP100000;2DH7;2XM900;1DH0;1MV-\n")
    board.run(1_000_000)
    board.interrupt()
    board.run(5_000_000)  # time at the prompt is no time under drive
    board.type("from mountfw.repl import m")
    x, y = board.type("m.status()").splitlines()[:2]
    assert x == "x: +7.000 steps (counted), end-stops: -, last move: none yet"
    assert y.endswith("(estimated), end-stops: -, last move: aborted")
    assert float(board.type("m.y.position")) == pytest.approx(-5, abs=0.01)
    board.type("m.x.step(1)")
    assert board.lengths("m2_pos") == pytest.approx([100_000], abs=20)
    assert "ms: a whole number within 1 ... 900, not 901" in board.refused("m.x.jog(1, ms=901)")
    assert board.type("(m.x.axis.positive_stop.fitted, m.y.axis.positive_stop.fitted)") == "(True, False)"


def test_a_firmware_that_was_cut_off_anyhow_is_taken_over_at_rest(board):
    board.interrupt()
    board.type("from mountfw.app import App")
    board.type("c = App.built.controller")
    board.type("c.axes[0].define(5)")
    board.type("c.axes[0].jog(1)")
    board.type("c.inhibit(3)")  # a stop was received and not yet parsed
    assert board.driving()
    board.type("from mountfw.repl import m")
    assert not any(board.bench.duties().values())
    assert "steps (unknown)" in board.type("m.status()").splitlines()[1]
    assert board.type("m.y.step(1)") == ""
    assert board.lengths("m1_pos") == pytest.approx([STEP_US], abs=20)


def test_a_soft_reset_from_the_prompt_is_not_taken_for_the_hang_or_the_reset_before_it(board):
    board.interrupt()
    board.send(b"import machine; machine.reset()\r")
    board.run(2_000_000)
    board.interrupt()
    board.send(b"\x04")
    board.run(2_000_000)
    board.received.clear()
    board.send(b"TB?;XH?\n")
    assert board.run(1_000_000, lambda: board.received.endswith(b"\n"))
    assert board.received.startswith(b"0, NO ERROR DETECTED; ") and board.received.strip().endswith(b",2,0")


def test_it_needs_no_firmware_that_has_run(board):
    board.interrupt()
    board.send(b"\x01\x04\x02")  # a soft reset from the raw prompt does not run main.py
    assert "soft reboot" in board.answer()
    board.type("from mountfw.repl import m")
    assert board.type("m.y.step(1)") == ""
    assert board.lengths("m1_pos") == pytest.approx([STEP_US], abs=20)


def test_what_is_typed_ahead_waits_for_its_turn(prompt):
    prompt.send(b"m.x.step(2)\rm.y.step(1)\r")
    prompt.simulation.edges.clear()
    assert prompt.run(5_000_000, lambda: prompt.received.count(b">>> ") == 2)
    assert [leg for leg, *_ in prompt.pulses()] == ["m2_pos", "m2_pos", "m1_pos"]


def test_the_led_blinks_while_a_motor_is_driven(prompt):
    prompt.type("from mountfw.ports import micropython as p")
    prompt.type("shown = []")
    prompt.type("p.led = shown.append")
    prompt.type("m.x.jog(1, ms=1000)")
    assert int(prompt.type("len(shown)")) >= 6


def test_its_words_are_the_hosts(prompt):
    prompt.type("from mountfw.codes import REASONS")
    assert eval(prompt.type("REASONS")) == REASONS


def test_the_session_of_the_page_is_what_a_board_says(board):
    board.interrupt()
    session = re.search(r"```pycon\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert session
    for part in session[1].split(">>> ")[1:]:
        line, _, answer = part.partition("\n")
        assert board.type(line).replace("\r", "") == answer.strip()
