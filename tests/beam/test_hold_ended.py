"""`mirrormount hold` that is ended by a signal, or whose last stop fails: what it learned by then is told and kept."""

import json
import resource
import signal
from types import SimpleNamespace

import pytest

from mirrormount.cli.main import main
from mirrormount.errors import NoAnswer
from mirrormount_beam.cli import hold as hold_module
from mirrormount_beam.control.hold import Hold
from mirrormount_beam.control.interlocks import Guard

ONE = ("--virtual", "--mounts", "1", "--cameras", "1", "--off", "0")
LEARNED = 1.25  # the factor of a short pulse


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The calibration of that table, as text."""
    file = tmp_path_factory.mktemp("table") / "calibration.json"
    assert main(["calibrate", *ONE, "--calibration", str(file)]) == 0
    return file.read_text()


@pytest.fixture
def run(tmp_path, measured, monkeypatch, capsys):
    """run(end): a hold without an end that learns something, and calls end() after its third look.

    status, out and err of the command; learned: the factor in the saved calibration; numbers: those of --json.
    """
    calibration, numbers = tmp_path / "calibration.json", tmp_path / "hold.json"
    calibration.write_text(measured)

    def run(end):
        looks = iter(range(3))
        cycle = Hold._cycle

        def learn(hold, frames):
            cycle(hold, frames)
            hold.response.short[0][1] = LEARNED
            if next(looks) == 2:
                end()

        monkeypatch.setattr(Hold, "_cycle", learn)
        words = ["hold", *ONE, "--duration", "1000000", "--calibration", str(calibration), "--json", str(numbers)]
        status = main(words)
        learned = json.loads(calibration.read_text())["short_pulses"][0]["1"]
        out, err = capsys.readouterr()
        return SimpleNamespace(
            status=status, out=out, err=err, learned=learned, numbers=json.loads(numbers.read_text())
        )

    return run


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_hold_that_is_told_to_end_keeps_what_it_learned(run, name):
    ended = run(lambda: signal.raise_signal(getattr(signal, name)))
    assert ended.status == 128 + getattr(signal, name) and ended.err == f"mirrormount: ended by {name}\n"
    assert "pulses in" in ended.out
    assert ended.learned == LEARNED and ended.numbers["seconds"] > 0


def test_a_last_stop_that_no_board_confirms_costs_nothing_that_was_learned(run, monkeypatch):
    def unanswered(_guard):
        raise NoAnswer("first: no answer")

    def end():
        monkeypatch.setattr(Guard, "motors_off", unanswered)
        raise KeyboardInterrupt

    ended = run(end)
    assert ended.status == 1 and ended.err == "mirrormount: first: no answer\n"
    assert ended.learned == LEARNED and ended.numbers["seconds"] > 0


def test_without_a_terminal_a_hold_that_ends_keeps_what_it_learned(run, monkeypatch):
    def gone(_summary):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(hold_module, "_tell_hold", gone)
    ended = run(lambda: signal.raise_signal(signal.SIGHUP))
    assert ended.learned == LEARNED and ended.numbers["seconds"] > 0


def test_a_disk_that_fills_up_in_mid_hold_leaves_the_numbers_of_before(run, tmp_path):
    before = {"reached": False}
    (tmp_path / "hold.json").write_text(json.dumps(before, indent=1))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def full():
        resource.setrlimit(resource.RLIMIT_FSIZE, (10, limits[1]))
        raise KeyboardInterrupt

    try:
        ended = run(full)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "File too large" in ended.err and ended.numbers == before
