"""`mirrormount measure` on the virtual table: what it offers to save of its result, and what is saved."""

from types import SimpleNamespace

import pytest

from mirrormount.cli import main
from mirrormount.device import calibration
from mirrormount_beam.cli import measure
from mirrormount_beam.estimates import Estimate

SEED = ("--virtual", "--profile", "smooth", "--seed", "5")
pytestmark = pytest.mark.usefixtures("own_folder")


@pytest.mark.full
def test_the_scale_of_steps_is_saved_when_asked_for(capsys, tables):
    assert main.main(["measure", "steps", *SEED, "--axes", "x", "--apply"]) == 0
    assert "The scales are saved in" in capsys.readouterr().out
    scale = calibration.read(_board_id(), 2)
    assert scale is not None and scale.positive == pytest.approx(0.215, rel=0.03)
    assert (scale.beam_per_mirror, scale.screen_mm) == (2.0, 400.0)


def _board_id() -> str:
    return next(iter(calibration.path().read_text().split("[")[1].split(".axis2")[:1]))


def terminal(monkeypatch, answer):
    asked = []
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda question: (asked.append(question), answer)[1])
    return asked


@pytest.mark.parametrize(("answer", "saved"), [("y", True), ("Yes", True), ("", False), ("n", False), ("x", False)])
def test_on_a_terminal_the_result_is_offered_and_saved_only_for_yes(answer, saved, found, tables, monkeypatch, capsys):
    asked = terminal(monkeypatch, answer)
    assert main.main(["measure", "backlash", *SEED, "--axes", "x"]) == 0
    out = capsys.readouterr().out
    assert asked == ["Save this? [y/N] "]
    assert "x.take_up_us: 0 → 251000" in out
    assert ("The take-up is saved on the board." in out) is saved
    assert ("to use it: mirrormount config set x.take_up_us 251000 --save" in out) is not saved


def test_a_take_up_beyond_what_the_board_takes_up_is_told_with_what_was_measured(tables, monkeypatch, capsys):
    def worn(rig, result, _tell):
        rig.observe()
        result.estimates["x.take_up"] = Estimate(2_800_000.0, 900.0, "us")

    monkeypatch.setattr(measure.backlash, "run", worn)
    assert main.main(["measure", "backlash", *SEED, "--axes", "x"]) == 0
    out = capsys.readouterr().out
    assert "x.take_up_us: 0 → 2000000\n" in out
    assert "  x: a turn loses 2.8 s of drive, and the board takes up 2 s at most\n" in out


def test_without_a_terminal_nothing_is_asked_and_nothing_is_saved(found, tables, monkeypatch, capsys):
    monkeypatch.setattr("builtins.input", pytest.fail)
    assert main.main(["measure", "backlash", *SEED, "--axes", "x"]) == 0
    assert "to use it: mirrormount config set x.take_up_us 251000 --save" in capsys.readouterr().out


@pytest.mark.parametrize(("sure_ms", "says"), [(300, "x.pulse_us: 200000 → 300000"), (100, "it stays")])
def test_a_step_that_is_shorter_than_a_sure_pulse_is_offered_to_be_longer(sure_ms, says, tables, monkeypatch, capsys):
    def at_once(rig, result, _tell):
        rig.observe()
        for way in ("positive", "negative"):
            result.estimates[f"x.{way}.pulse_50ms"] = Estimate(0.1, 0.1, "px")
            result.estimates[f"x.{way}.pulse_{sure_ms}ms"] = Estimate(5.0, 0.1, "px")

    monkeypatch.setattr(measure.backlash, "run_pulses", at_once)
    assert main.main(["measure", "pulses", *SEED, "--axes", "x", "--apply"]) == 0
    assert says in capsys.readouterr().out


@pytest.fixture
def asked_for(monkeypatch):
    """The experiments that find a step of a wanted size, at once; the sizes that are asked for."""
    seen = []

    def steps(rig, result, _tell):
        rig.observe()
        for way in ("positive", "negative"):
            result.estimates[f"x.{way}.step"] = Estimate(3.4, 0.02, "px")

    def of_size(_rig, result, _tell, wanted_px):
        seen.append(wanted_px)
        result.estimates["x.wanted.pulse"] = Estimate(231_000.0, 900.0, "us")
        for way in ("positive", "negative"):
            result.estimates[f"x.wanted.{way}.step"] = Estimate(4.0, 0.02, "px")

    monkeypatch.setattr(measure.steps, "run", steps)
    monkeypatch.setattr(measure.steps, "run_step_size", of_size)
    return seen


def test_a_step_of_a_wanted_size_is_offered_with_its_scale_and_saved_when_asked_for(asked_for, tables, capsys):
    assert main.main(["measure", "steps", *SEED, "--axes", "x", "--step", "250", "urad", "--apply"]) == 0
    out = capsys.readouterr().out
    # the camera: 0.05 mm a pixel at 400 mm; the beam turns twice as far as the mirror
    assert asked_for == [{"x": pytest.approx(250e-6 * 2 * 400 / 0.05, rel=1e-3)}]
    assert "x.pulse_us: 200000 → 231000" in out and "x, positive: not known → 0.25 mrad a step" in out
    assert "The step is saved on the board." in out
    scale = calibration.read(_board_id(), 2)
    assert scale is not None and (scale.positive, scale.step.pulse_us) == (0.25, 231_000)


def test_a_step_in_pixels_needs_no_scale_and_is_told_how_to_be_saved(asked_for, tables, capsys):
    assert main.main(["measure", "steps", *SEED, "--axes", "x", "--mm-per-px", "0.05", "--step", "4", "px"]) == 0
    assert asked_for == [{"x": 4.0}]
    assert "to use it: mirrormount config set x.pulse_us 231000 --save" in capsys.readouterr().out


def test_steps_say_how_a_step_of_another_size_is_found(asked_for, tables, capsys):
    assert main.main(["measure", "steps", *SEED, "--axes", "x"]) == 0
    assert "for steps of another size: --step SIZE UNIT" in capsys.readouterr().out
    assert not asked_for
