"""`mirrormount send`: the errors of a line are read, and what the line starts is waited for, or let go and said."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from served import PATIENCE_S, run_cli, wait_for

from mirrormount import __version__, errors
from mirrormount.device.mount import Mount

MAX = "virtual://?speed=max"


def send(line: str, edges: Path, *options: str) -> tuple[subprocess.CompletedProcess, list[dict]]:
    """The command's result, and the edges of the enables while it ran."""
    run = run_cli("send", *options, line, "--port", f"{MAX}&edges={edges}")
    found = [json.loads(text) for text in edges.read_text().splitlines()]
    return run, [edge for edge in found if edge["pin"].endswith("_en")]


def widths_us(edges: list[dict]) -> list[int]:
    on, off = edges[::2], edges[1::2]
    assert all(edge["duty"] for edge in on) and not any(edge["duty"] for edge in off)
    return [b["t_us"] - a["t_us"] for a, b in zip(on, off, strict=True)]


def test_a_step_that_was_sent_is_as_long_as_a_step(tmp_path):
    run, edges = send("2PR1", tmp_path / "edges")
    assert (run.returncode, run.stdout) == (0, "")
    assert run.stderr == "done; x: +1.000 steps\n"
    assert widths_us(edges) == [pytest.approx(200_000, abs=1000)]


def test_all_steps_that_were_sent_are_made(tmp_path):
    run, edges = send("1PR3;2TP?", tmp_path / "edges")
    assert (run.returncode, run.stdout) == (0, "0\n")
    assert len(widths_us(edges)) == 3


def test_a_line_with_its_own_address_or_keep_alive_is_waited_for_too(tmp_path):
    run, edges = send("1>XK100;2PR2;VE?", tmp_path / "edges")
    assert (run.returncode, run.stdout) == (0, f"1>MM2 Version {__version__} mirrormount\n")
    assert len(widths_us(edges)) == 2


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("2XI1x", "60: malformed input: motors stopped"),
        ("2OR", "235: x not fitted or switched off"),
        ("1OR", "135: y not fitted or switched off"),
        ("2MV+", "x: run limit reached"),
    ],
)
def test_what_the_board_says_of_a_line_is_read_with_cause_and_remedy(tmp_path, line, says):
    run, _ = send(line, tmp_path / "edges")
    message, cause, remedy = run.stderr.splitlines()
    assert run.returncode == 1
    assert says in message and cause.startswith("  cause: ") and remedy.startswith("  remedy: ")


def test_a_refused_command_tells_what_became_of_the_motion_before_it(tmp_path):
    run, edges = send("2PR5;2PR5", tmp_path / "edges")
    message = run.stderr.splitlines()[0]
    told = "the board says 214: x motion in progress; what the line had started before was stopped at x: +0."
    assert run.returncode == 1 and message.startswith(f"mirrormount: {told}")
    assert "cause: The axis moves" in run.stderr
    assert len(edges) == 2 and edges[-1]["duty"] == 0


@pytest.mark.parametrize("line", ["0255-100", "+100+100", "!", "-001-001"])
def test_a_frame_or_a_stop_is_no_command_line_and_is_not_sent(tmp_path, line):
    run = run_cli("send", f"--port={MAX}&edges={tmp_path / 'edges'}", "--", line)
    assert run.returncode == 1 and "is no command line" in run.stderr
    assert "_en" not in (tmp_path / "edges").read_text()


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("", "the command line is empty"),
        ("  ", "the command line is empty"),
        ("2PR3;", "a ; stands between two commands: leave out the one that has nothing behind it"),
        ("VE?; ;2PR3", "a ; stands between two commands"),
    ],
)
def test_a_line_in_which_a_command_is_missing_is_not_sent(tmp_path, line, says):
    run, edges = send(line, tmp_path / "edges")
    assert run.returncode == 1 and f"mirrormount: {says}" in run.stderr and run.stderr.count("\n") == 1
    assert edges == []


def test_a_line_that_would_not_fit_is_refused_before_it_is_sent():
    run = run_cli("send", "VE?;" * 40, "--port", MAX)
    assert run.returncode == 1 and "characters" in run.stderr


def test_a_malformed_line_is_an_error_of_the_board_in_python_too():
    with Mount.open(MAX) as mount:
        with pytest.raises(errors.BoardError, match="60"):
            mount.send("2XI1x")
        assert mount.send("2XI?") == "0"


def test_ctrl_c_stops_what_was_sent_and_says_where(board):
    sent = subprocess.Popen(
        [sys.executable, "-m", "mirrormount", "send", "1XM60000;1MV+", "--port", str(board.link)],
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for(board.driving, "the motor to run")
    sent.send_signal(signal.SIGINT)
    _, err = sent.communicate(timeout=PATIENCE_S)
    assert sent.returncode == 130
    assert err.startswith("mirrormount: stopped at x: ") and "y: " in err and err.count("\n") == 1
    assert not board.driving()


def test_without_waiting_the_move_goes_on_and_its_bounds_are_told(board):
    run = run_cli("send", "--no-wait", "1XM60000;1MV+", "--port", str(board.link))
    assert run.returncode == 0
    assert run.stderr == (
        "y: still moving; it goes on without this program, except on CircuitPython boards, which see the port close,"
        " and behind mirrormount serve without --on-leave finish: a run for 60 s at most, a search for a switch for"
        " 120 s under drive at most, a move until its steps are made; mirrormount stop ends it\n"
    )
    assert board.driving()
    assert run_cli("stop", "--port", str(board.link)).returncode == 0
    assert not board.driving()


def test_without_waiting_a_refused_line_leaves_nothing_running(board):
    run = run_cli("send", "--no-wait", "1MV+;2XP5", "--port", str(board.link))
    assert run.returncode == 1 and "7: parameter out of range" in run.stderr
    assert not board.driving()


def test_a_board_that_ends_with_the_program_cannot_be_left_moving(tmp_path):
    run = run_cli("send", "--no-wait", "2PR5", "--port", f"{MAX}&edges={tmp_path / 'edges'}")
    assert run.returncode == 1 and "ends with this program" in run.stderr
    assert "_en" not in (tmp_path / "edges").read_text()
