"""`--calibration FILE`: what was measured is not lost, and a place that cannot be written is told before."""

import json

import pytest
from full_disk import run_with_room

from mirrormount.cli.main import main
from mirrormount.errors import CannotWrite
from mirrormount_beam.cli import hold
from mirrormount_beam.control import calibrate

ONE = ("--virtual", "--mounts", "1", "--cameras", "1")


@pytest.fixture
def unmeasured(monkeypatch):
    """A measurement would fail the test."""
    monkeypatch.setattr(calibrate.Calibration, "run", lambda _self: pytest.fail("something was measured"))


@pytest.mark.parametrize("verb", ["calibrate", "align", "hold"])
def test_a_calibration_that_cannot_be_saved_is_told_before_it_is_measured(verb, unmeasured, tmp_path, capsys):
    (tmp_path / "file").touch()
    place = tmp_path / "file" / "cal.json"
    assert main([verb, *ONE, "--calibration", str(place)]) == 1
    out, err = capsys.readouterr()
    assert out == "" and str(place) in err and err.count("\n") == 1


def test_on_a_full_disk_nothing_is_measured_and_no_file_is_left(tmp_path):
    pytest.importorskip("resource")
    run = run_with_room(1000, "calibrate", *ONE, "--calibration", str(tmp_path / "cal.json"))
    assert run.returncode == 1 and run.stdout == ""
    assert run.stderr == f"mirrormount: cannot write {tmp_path}/cal.json: File too large\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.full
def test_a_disk_that_fills_up_meanwhile_costs_only_the_file(monkeypatch, tmp_path, capsys):
    def full(*_):
        raise CannotWrite("cannot write cal.json: No space left on device")

    monkeypatch.setattr(hold, "save", full)
    numbers = tmp_path / "all.json"
    assert main(["calibrate", *ONE, "--calibration", str(tmp_path / "cal.json"), "--json", str(numbers)]) == 1
    out, err = capsys.readouterr()
    assert err == "mirrormount: cannot write cal.json: No space left on device\n"
    assert "a step moves the spots by" in out
    assert "um_for_a_step" in json.loads(numbers.read_text())


@pytest.mark.full
def test_a_users_own_link_to_the_calibration_is_kept(tmp_path):
    link, file = tmp_path / "cal.json", tmp_path / "folder" / "mine.json"
    link.symlink_to(file)
    assert main(["calibrate", *ONE, "--calibration", str(link)]) == 0
    assert link.is_symlink() and "um_for_a_step" in json.loads(file.read_text())
