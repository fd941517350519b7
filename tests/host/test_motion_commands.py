"""What a person sees of a motion in the shell: a line while it lasts, the position at its end, however it ends."""

import contextlib
import os
import signal
import subprocess
import sys

import pytest
from served import PATIENCE_S, ServedBoard, run_cli, wait_for

from mirrormount.device import calibration
from mirrormount.device.mount import Mount


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


@pytest.mark.parametrize(
    "words",
    [
        ("100", "urad"),
        ("100urad",),
        ("100µrad",),
        ("100 µrad",),
        ("100\u03bcrad",),
        ("100", "\u00b5rad"),
        ("0.1mrad",),
        ("1e-1mrad",),
    ],
)
def test_an_amount_is_typed_in_one_word_or_in_two_and_micro_in_each_of_its_spellings(words):
    for sign, way in (("", "+"), ("-", "-")):
        run = run_cli("step", "x", sign + words[0], *words[1:], "--port", "virtual://?speed=max")
        assert run.stdout.startswith(f"x: moved {way}0.465 steps (≈ {way}"), run.stderr


def test_a_unit_that_is_given_twice_moves_nothing():
    run = run_cli("step", "x", "100urad", "urad", "--port", "virtual://?speed=max")
    assert (run.returncode, run.stdout) == (1, "") and "has a unit already" in run.stderr


def test_a_micrometre_is_a_thousandth_of_a_millimetre(own_folder):
    with Mount.open("virtual://?speed=max") as mount:
        step = calibration.Step(*mount.x.ask_whole("XP?", "XD?", "XI?"))
        calibration.write(mount.board_id, {2: calibration.Scale(0.2, 0.2, step, 2.0, 1000.0)})  # 0.4 mm a step
        assert mount.x.per_step("um") == pytest.approx(1000 * mount.x.per_step("mm"))
    run = run_cli("step", "x", "800\u03bcm", "--port", "virtual://?speed=max")
    assert run.stdout == "x: moved +2 steps (≈ +800 um), now at +2 (unknown)\n"


def test_a_motion_says_how_far_it_went_and_where_it_is(board):
    port = "--port", str(board.link)
    assert run_cli("zero", "x", *port).returncode == 0
    assert run_cli("step", "x", "5", *port).stdout == "x: moved +5 steps, now at +5 (counted)\n"
    assert run_cli("move", "x", "3.5", *port).stdout == "x: moved -1.5 steps, now at +3.5 (estimated)\n"
    assert run_cli("move", "x", "3.5", *port).stdout == "x: moved +0 steps, now at +3.5 (estimated)\n"


def test_zero_says_what_was_before_and_is_undone(board, own_folder):
    port = "--port", str(board.link)
    run_cli("step", "x", "2", *port)
    assert run_cli("zero", *port).stdout.splitlines() == [
        "x: 0 is here; it was at +2 (unknown). `mirrormount undo x` takes it back",
        "y: 0 is here; it was at +0 (unknown). `mirrormount undo y` takes it back",
    ]
    assert "the position here is +2 steps as before Zero" in run_cli("undo", "x", *port).stdout


def test_zero_promises_no_undo_where_nothing_can_be_kept(monkeypatch, tmp_path):
    (folder := tmp_path / "data").write_text("no folder")
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(folder))
    run = run_cli("zero", "y", "--port", "virtual://?speed=max")
    assert run.stdout == "y: 0 is here; it was at +0 (unknown). there is no undo of it\n"


def test_nothing_is_shown_where_there_is_no_terminal(board):
    run = run_cli("step", "x", "2", "--port", str(board.link))
    assert (run.returncode, run.stdout, run.stderr) == (0, "x: moved +2 steps, now at +2 (unknown)\n", "")


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
    assert run.stdout.startswith("x: moved +")
    assert "the run limit of 10 s has ended it: setting x.run_limit_ms" in run.stdout


def test_a_jog_that_something_else_ends_is_an_error_with_its_reason(tmp_path):
    port = f"virtual://?speed=max&bench=switches&files={tmp_path}"
    assert run_cli("send", "2XL3;2XM400000;SM", "--port", port).returncode == 0
    run = run_cli("jog", "x", "1", "--port", port)
    assert run.returncode == 1
    assert "x: end-stop reached" in run.stderr and "remedy: Drive the other way" in run.stderr
