"""The closed-loop calls of PLACE's `PMot` (its plug-in new_focus), a driver of the New Focus 8743-CL, over TCP.

Here the board has encoders, and its owner's settings are those of docs/bring-up.md: 280 counts a step. Positions are in
steps. The driver asks again for a target until the position is exactly that, so the dead band is 0.
"""

import importlib
from typing import Any

from checks import Checks, Trial
from place import wait_for

NAME = "place"
WAYS = ("tcp",)
ENCODER = "motor"
SETTINGS = "1XN280;2XN280;1DB0;2DB0"
CHECKS = Checks()

_X, _Y = "2", "1"  # the driver's motors
_STEP_MS = 200


def connect(address: str, way: str, **_options: Any) -> Any:
    """A connected PMot."""
    driver = importlib.import_module("pmot").PMot()
    host, port = address.split(":")
    driver.connect(host, int(port))
    return driver


def disconnect(driver: Any) -> None:
    """Close it."""
    driver.close()


def send(driver: Any, line: str) -> str:
    """A line of its own; the answer if it asks for one."""
    if line.endswith("?"):
        return driver._get("0", line).strip()
    driver.send_setting("0", line)
    return ""


def configure(t: Trial) -> None:
    """As the plug-in does at the start of an experiment, but for the velocity, which is a piezo's, and for counts."""
    for motor in (_X, _Y):
        t.driver.set_following_error(motor, 200)
        t.driver.set_cl(motor, 0.1)
        t.driver.set_mm(motor, 1)


@CHECKS.add("set_following_error, set_cl, set_mm")
def what_the_experiment_sets_is_set_and_drives_nothing(t: Trial) -> None:
    configure(t)
    for axis in "12":
        assert [t.line(f"{axis}{word}?") for word in ("SN", "FE", "CL", "MM")] == ["0", "200", "0.1", "1"]
    assert t.place.drives() == []


@CHECKS.add("absolute_move")
def a_move_to_a_position_drives_until_it_is_there(t: Trial) -> None:
    configure(t)
    assert t.driver.absolute_move(1, -2) == (1, -2)
    x, y = sum(t.place.driven_ms(2)), sum(t.place.driven_ms(1))
    assert 0.8 * _STEP_MS < x < 1.3 * _STEP_MS  # the first part of it is the spin-up; then it coasts on
    assert -2.3 * _STEP_MS < y < -1.8 * _STEP_MS
    assert t.driver.absolute_move(0, 0) == (0, 0)


@CHECKS.add("set_mm(0)")
def without_the_closed_loop_a_move_is_timed_pulses_again(t: Trial) -> None:
    configure(t)
    for motor in (_X, _Y):
        t.driver.set_mm(motor, 0)
    t.driver.send_setting(_Y, "PR2")
    wait_for(lambda: t.line("1MD?") == "1", "the end of the move")
    assert t.place.driven_ms(1) == [_STEP_MS] * 2
    assert t.place.driven_ms(2) == []


@CHECKS.add("abort")
def an_abort_ends_a_move_of_the_closed_loop(t: Trial) -> None:
    configure(t)
    t.driver.send_setting(_Y, "PA20")
    wait_for(lambda: t.place.driving(1), "the motor to run")
    t.driver.abort()
    wait_for(lambda: not t.place.driving(), "the motor to stop")
    assert t.line("1MD?") == "1"
    assert 0 < int(t.line("1TP?")) < 20
