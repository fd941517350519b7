"""What a person sees of a motion in the shell: a line while it lasts, the position at its end, however it ends."""

import contextlib
import os
import signal
import subprocess
import sys

import pytest
from served import PATIENCE_S, ServedBoard, run_cli, wait_for


def start(board: ServedBoard, *words: str, stderr: int = subprocess.PIPE) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "mirrormount", *words, "--port", str(board.link)],
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
    )


def on_a_terminal(board: ServedBoard, *words: str) -> tuple[int, str, str]:
    """(exit status, stdout, what the terminal got)."""
    master, slave = os.openpty()
    command = start(board, *words, stderr=slave)
    os.close(slave)
    shown = b""
    with contextlib.suppress(OSError):  # the other end is closed
        while data := os.read(master, 4096):
            shown += data
    os.close(master)
    out, _ = command.communicate(timeout=PATIENCE_S)
    return command.returncode, out, shown.decode()


@pytest.mark.parametrize(
    ("words", "shows"),
    [
        (("step", "x", "2"), "on the way to +2.0; Ctrl-C stops"),
        (("move", "x", "-2"), "on the way to -2"),
        (("jog", "x", "1", "--seconds", "0.5"), " s more, Ctrl-C stops"),
        (("send", "2PR2"), "; Ctrl-C stops"),
    ],
)
def test_a_motion_is_shown_on_a_terminal_while_it_lasts(board, words, shows):
    status, _, shown = on_a_terminal(board, *words)
    assert status == 0
    assert shows in shown
    assert "\r\x1b[K" in shown.rpartition("Ctrl-C")[2], "the line is not cleared"


def test_nothing_is_shown_where_there_is_no_terminal(board):
    run = run_cli("step", "x", "2", "--port", str(board.link))
    assert (run.returncode, run.stdout, run.stderr) == (0, "x: +2.000 steps\n", "")


@pytest.mark.parametrize("words", [("step", "x", "50"), ("move", "x", "50"), ("jog", "x", "0.5"), ("drive", "0", "99")])
def test_ctrl_c_stops_and_says_where_and_how_certain_that_is(board, words):
    command = start(board, *words)
    wait_for(board.driving, "the motor to run")
    command.send_signal(signal.SIGINT)
    out, err = command.communicate(timeout=PATIENCE_S)
    assert (command.returncode, out) == (130, "")
    assert err.startswith("mirrormount: stopped at x: +") and err.endswith(" steps (unknown)\n")
    assert not board.driving()


def test_a_jog_that_is_ended_by_the_run_limit_says_so_and_is_no_error():
    run = run_cli("jog", "x", "1", "--port", "virtual://?speed=max")
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith("x: +") and "the run limit of 10 s has ended it: setting x.run_limit_ms" in run.stdout


def test_a_jog_that_something_else_ends_is_an_error_with_its_reason(tmp_path):
    port = f"virtual://?speed=max&bench=switches&files={tmp_path}"
    assert run_cli("send", "2XL3;2XM400000;SM", "--port", port).returncode == 0
    run = run_cli("jog", "x", "1", "--port", port)
    assert run.returncode == 1
    assert "x: end-stop reached" in run.stderr and "remedy: Drive the other way" in run.stderr
