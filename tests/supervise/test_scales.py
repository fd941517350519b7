"""Steps in units of mirror, beam and screen for the panel, where a scale was measured."""

from types import SimpleNamespace

import pytest

from mirrormount.device import calibration
from mirrormount.supervise.connection import State

STEP = calibration.Step(200_000, 255, 0)


@pytest.fixture
def mount(tmp_path, monkeypatch):
    """A board of which x has all scales, y only the mirror's; axis3 none."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    calibration.write(
        "board",
        {
            2: calibration.Scale(0.21, 0.19, STEP, beam_per_mirror=2.0, screen_mm=1500.0),
            1: calibration.Scale(0.22, 0.22, STEP),
        },
    )
    axes = {
        name: SimpleNamespace(number=number, ask_whole=lambda *_: (200_000, 255, 0))
        for name, number in (("x", 2), ("y", 1), ("axis3", 3))
    }
    return SimpleNamespace(board_id="board", by_name=axes, axis=axes.__getitem__)


@pytest.fixture
def state(mount):
    state = State()
    state.connect(mount)
    return state


def test_a_position_is_told_in_the_units_that_have_a_scale(state):
    assert state.angle_text("x", -10.0) == "≈ −2.00 mrad, −6.00 mm"
    assert state.angle_text("y", 10.0) == "≈ +2.20 mrad"
    assert state.angle_text("axis3", 10.0) == ""


def test_what_a_step_is_is_told_for_each_axis(state):
    assert state.step_text() == (
        "x: a step is about 200 µrad of the mirror, 400 µrad of the beam, 0.6 mm on the screen."
        " y: a step is about 220 µrad of the mirror. axis3: no scale, so steps only."
        " mirrormount setup measures a scale."
    )


def test_the_scale_of_another_step_is_none(mount):
    mount.by_name["x"].ask_whole = lambda *_: (100_000, 255, 0)
    state = State()
    state.connect(mount)
    assert state.angle_text("x", 1.0) == ""
