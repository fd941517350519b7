"""Requests as messages: those that are understood, and those that are refused before anything is sent."""

import pytest

from mirrormount.errors import BadValue
from mirrormount.supervise.requests import Drive, GoTo, Home, MoveBy, MoveTo, Press, Steps, Zero, parse

PRESS = {"do": "press", "x": 1, "y": 0, "speed": "128", "steps": "1"}


@pytest.mark.parametrize(
    ("message", "request_"),
    [
        ({"do": "drive", "x": "-255", "y": " 7 "}, Drive(x=-255, y=7)),
        ({"do": "steps", "axis": "y", "way": -1, "n": "3"}, Steps("y", -3)),
        ({"do": "steps", "axis": "y", "way": 1, "n": "+3"}, Steps("y", 3)),
        ({"do": "goto", "axis": "x", "to": "0"}, GoTo("x", 0)),
        ({"do": "goto", "axis": "x", "to": "\N{MINUS SIGN}3"}, GoTo("x", -3)),
        ({"do": "steps", "axis": "x", "way": -1, "n": "1.5"}, MoveBy("x", -1.5, "steps")),
        ({"do": "steps", "axis": "x", "way": 1, "n": "3", "unit": "mm"}, MoveBy("x", 3, "mm")),
        ({"do": "steps", "axis": "x", "way": 1, "n": "3.0", "unit": "steps"}, Steps("x", 3)),
        ({"do": "goto", "axis": "x", "to": "-.25", "unit": "beam-mrad"}, MoveTo("x", -0.25, "beam-mrad")),
        ({"do": "goto", "axis": "x", "to": "2."}, GoTo("x", 2)),
        ({"do": "home", "axis": "x"}, Home("x")),
        ({"do": "zero", "axis": "y"}, Zero("y")),
        (PRESS, Press({"x": 1}, 128)),
        ({"do": "press", "z": -1, "speed": 7, "steps": 1}, Press({"z": -1}, 7)),
        ({"do": "home", "axis": "z"}, Home("z")),
        (PRESS | {"steps": " 100 "}, Press({"x": 1}, 128, steps=100)),
        (PRESS | {"y": -1, "steps": "7"}, Press({"x": 1, "y": -1}, 128, steps=7)),
    ],
)
def test_a_request_is_understood(message, request_):
    assert parse(message, ("x", "y", "z")) == request_


@pytest.mark.parametrize(
    "message",
    [
        {},
        {"do": "dance", "axis": "x"},
        {"do": "steps", "axis": "z", "n": "1"},
        {"do": "steps", "axis": ["x"], "n": "1"},
        {"do": "steps", "axis": "x", "way": 1, "n": "0"},
        {"do": "steps", "axis": "x", "way": 1, "n": "1000001"},
        {"do": "steps", "axis": "x", "way": 1, "n": "1_000"},
        {"do": "steps", "axis": "x", "way": 1, "n": None},
        {"do": "steps", "axis": "x", "way": 1, "n": "1,5"},
        {"do": "steps", "axis": "x", "way": 1, "n": "1e3"},
        {"do": "steps", "axis": "x", "way": 1, "n": "nan"},
        {"do": "steps", "axis": "x", "way": 1, "n": "0.0", "unit": "mm"},
        {"do": "steps", "axis": "x", "way": 1, "n": "."},
        {"do": "steps", "axis": "x", "way": 1, "n": "1", "unit": "inch"},
        {"do": "goto", "axis": "x", "to": "1", "unit": ["mm"]},
        {"do": "steps", "axis": "x", "way": 1, "n": True},
        {"do": "steps", "axis": "x", "way": -1, "n": "-3"},
        {"do": "steps", "axis": "x", "way": 0, "n": "3"},
        {"do": "steps", "axis": "x", "n": "3"},
        {"do": "goto", "axis": "x"},
        {"do": "drive", "x": "1"},
        {"do": "drive", "x": "256", "y": "0"},
        PRESS | {"x": 0},
        PRESS | {"x": 2},
        PRESS | {"y": None},
        PRESS | {"speed": "0"},
        PRESS | {"speed": "-5"},
        PRESS | {"speed": "9" * 5000},
        PRESS | {"steps": "0"},
        PRESS | {"steps": "-1"},
        PRESS | {"steps": "101"},
        PRESS | {"steps": "1.5"},
        PRESS | {"steps": ""},
        PRESS | {"steps": None},
    ],
)
def test_what_is_no_request_is_refused_in_words(message):
    with pytest.raises(BadValue) as e:
        parse(message)
    assert len(str(e.value).splitlines()) == 1


@pytest.mark.parametrize(("speed", "fine"), [(255, 63), (80, 20), (3, 1), (1, 1)])
def test_a_fine_press_is_one_step_and_a_quarter_of_the_speed_whatever_the_step_is(speed, fine):
    for steps in ("100", "", "a word"):
        assert parse(PRESS | {"speed": speed, "steps": steps, "fine": True}) == Press({"x": 1}, fine)


def test_a_diagonal_press_is_of_both_axes():
    assert parse(PRESS | {"y": -1}).ways == {"x": 1, "y": -1}
