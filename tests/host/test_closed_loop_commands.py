"""What setup, status, check and config make of encoders."""

import signal

import pytest

from mirrormount import errors
from mirrormount.cli import check, main
from mirrormount.cli.check import run_checks
from mirrormount.cli.setup import Dialogue, run_course
from mirrormount.cli.setup import encoder as set_up
from mirrormount.device.axis import Axis


def test_a_setting_of_an_encoder_that_is_not_there_is_told_in_one_line(capsys):
    assert main.main(["config", "get", "x.closed_loop", "--port", "virtual://?speed=max"]) == 1
    assert "x has no encoder" in capsys.readouterr().err


def test_setup_measures_an_encoder_and_closes_the_loop_if_it_may(loop):
    mount = loop(closed=False).mount
    said, asked = [], []

    def person(question):
        asked.append(question)
        return "yes"

    set_up(mount, mount.x, Dialogue(person, said.append))
    assert mount.x.closed_loop == 1 and mount.x.counts_per_step == pytest.approx(277, abs=3)
    assert any("counts up" in text for text in said) and len(asked) == 1


def test_setup_goes_on_without_an_encoder_that_does_not_count(loop):
    mount = loop(closed=False)
    mount.bench.disturb("m2", "broken")
    answers = ["again", "without"]
    set_up(mount.mount, mount.mount.x, Dialogue(lambda _question: answers.pop(0), lambda _text: None))
    assert mount.mount.x.closed_loop == 0 and not answers


def test_setup_puts_the_closed_loop_back_where_the_encoders_fail_meanwhile(loop):
    mount = loop(encoder="shaft")

    def ask(question):
        if "Which way" in question:
            mount.bench.disturb("m1", "broken")
            mount.bench.disturb("m2", "broken")
            raise EOFError
        return "yes"

    with pytest.raises(errors.SetupEnded, match="the settings are as they were"):
        run_course(mount.mount, ask, lambda text: None)
    assert [axis.closed_loop for axis in mount.mount.axes] == [1, 1]


def test_setup_measures_anew_what_would_end_every_move_in_the_closed_loop(loop, monkeypatch, tmp_path):
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    mount = loop()
    mount.bench.disturb("m2", "swapped")
    mount.bench.disturb("m1", "broken")
    answers = {
        "May it move": ["yes"],
        "Which way": ["right", "up"],
        "End-stop": ["none", "none"],
        "Close the loop": ["yes"],
        "Measure again": ["without"],
        "Find the least duty": ["yes", "no"],
        "Distance": ["0"],
        "Save this": ["yes"],
    }
    said = []
    run_course(mount.mount, lambda asked: next(a for part, a in answers.items() if part in asked).pop(0), said.append)
    assert "x: encoder, -277 counts a step, closed loop" in said[-3]
    assert "y: encoder, 280 counts a step, open loop" in said[-3]
    assert mount.mount.x.start_duty == 15  # by the encoder, and this bench's motor starts at any duty
    for axis in mount.mount.axes:
        axis.step(1)  # raises what the board says


def test_status_shows_the_counts_and_what_they_are_worth(capsys):
    assert main.main(["status", "--port", "virtual://?speed=max&encoder=motor"]) == 0
    assert capsys.readouterr().out.count("encoder: 0 counts (open loop)") == 2


def test_status_tells_an_encoder_that_does_not_answer(capsys):
    assert main.main(["status", "--port", "virtual://?speed=max&encoder=shaft&fault=m2:broken@0"]) == 0
    assert "encoder: does not answer (open loop)" in capsys.readouterr().out


FOUND = [
    (None, "none lost, and none at rest"),
    ("swapped", "the other way"),
    ("broken", "counts nothing"),
    ("jammed", "does the motor turn?"),
    ("lost", "counts were lost"),
]


@pytest.mark.parametrize(("fault", "found"), FOUND)
def test_check_tells_what_an_encoder_does_not_do(loop, capsys, fault, found):
    mount = loop()
    if fault:
        mount.bench.disturb("m2", fault)
    try:
        run_checks(lambda: mount.mount, move=True)
    except errors.CheckFailed:
        assert fault
    lines = capsys.readouterr().out.splitlines()
    line = next(line for line in lines if "x encoder in a move" in line)
    assert line.startswith("FAILED" if fault else "ok") and found in line
    assert any(line.startswith("ok") and "y encoder in a move" in line for line in lines)
    assert all("its encoder counts" in line for line in lines if "FAILED" in line and "in a move:" not in line)
    assert not [line for line in lines if "report it" in line]


def test_check_at_rest_tells_an_encoder_that_does_not_answer(loop, capsys):
    mount = loop(encoder="shaft", closed=False)
    mount.bench.disturb("m2", "broken")
    with pytest.raises(errors.CheckFailed):
        run_checks(lambda: mount.mount, move=False)
    line = next(line for line in capsys.readouterr().out.splitlines() if "x encoder" in line)
    assert line.startswith("FAILED") and "does not answer" in line and "its plug" in line


@pytest.mark.parametrize(("name", "status"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_ends_check_and_leaves_the_loops_closed(loop, monkeypatch, name, status):
    mount = loop().mount

    def ended(_axis, _steps):
        assert mount.x.closed_loop == 0
        signal.raise_signal(getattr(signal, name))

    monkeypatch.setattr(Axis, "_counts_of", ended)
    monkeypatch.setattr(check, "open_mount", lambda _args: mount)
    monkeypatch.setattr(mount.session, "close", lambda: None)
    assert main.main(["check", "--move"]) == status
    assert [axis.closed_loop for axis in mount.axes] == [1, 1]
