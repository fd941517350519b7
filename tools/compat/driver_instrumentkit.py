"""InstrumentKit's `PicoMotorController8742` (import `instruments`), over TCP and over a serial port.

The class is in what its repository has; the 0.6.0 that package indexes have is older than it.
"""

import importlib
from typing import Any

from checks import Checks, Trial
from place import PERIOD_MS, STEP_MS, wait_for

NAME = "instrumentkit"
WAYS = ("tcp", "pty")
CHECKS = Checks()

_VELOCITY, _USUAL_VELOCITY = 1000 // PERIOD_MS, 1750  # here, and of its own controllers
_GREETING = 6  # bytes; its users read them away


def connect(address: str, way: str, **_options: Any) -> Any:
    """An open controller."""
    kind = importlib.import_module("instruments").newport.PicoMotorController8742
    if way == "pty":
        return kind.open_serial(address, baud=115200, timeout=10)
    host, port = address.split(":")
    controller = kind.open_tcpip(host, int(port))
    controller._file.timeout = 10
    controller._file.read_raw(_GREETING)
    return controller


def disconnect(driver: Any) -> None:
    """Close it."""
    driver._file._conn.close()  # its own close() fails over a serial port


def send(driver: Any, line: str) -> str:
    """A line of its own; the answer if it asks for one."""
    if line.endswith("?"):
        return driver.query(line)
    driver.sendcmd(line)
    return ""


def magnitude(quantity: Any) -> int:
    """The number of a quantity with a unit."""
    return quantity.magnitude


def arrive(t: Trial, axis: int) -> None:
    """Wait as its users do."""
    wait_for(lambda: t.driver.axis[axis - 1].is_stopped, "the end of the move")


@CHECKS.add("move_relative")
def move_relative_makes_as_many_pulses_as_it_was_told(t: Trial) -> None:
    t.driver.axis[0].move_relative = 3
    arrive(t, 1)
    t.driver.axis[1].move_relative = -2
    arrive(t, 2)
    assert t.place.driven_ms(1) == [STEP_MS] * 3
    assert t.place.driven_ms(2) == [-STEP_MS] * 2
    assert [t.driver.axis[i].position for i in range(4)] == [3, -2, 0, 0]


@CHECKS.add("move_absolute")
def move_absolute_goes_on_from_where_it_is(t: Trial) -> None:
    for position in (2, -1):
        t.driver.axis[1].move_absolute = position
        arrive(t, 2)
        assert t.driver.axis[1].position == position
    assert t.place.driven_ms(2) == [STEP_MS] * 2 + [-STEP_MS] * 3


@CHECKS.add("move_absolute, out of range")
def a_target_of_32_bits_is_refused_and_the_error_is_read(t: Trial) -> None:
    t.driver.axis[1].move_indefinite("-")
    wait_for(lambda: t.place.driving(2), "the motor to run")
    t.driver.axis[0].move_absolute = 2147483647
    assert t.driver.error_code_and_message == (101, "AXIS 1 OUT OF RANGE")
    assert t.place.driving(2)
    t.driver.axis[1].stop()
    arrive(t, 2)
    assert t.place.drives(1) == []


@CHECKS.add("error_code_and_message after a safety stop")
def the_error_after_malformed_input_is_read(t: Trial) -> None:
    t.driver.axis[0].move_indefinite("+")
    wait_for(lambda: t.place.driving(1), "the motor to run")
    t.line("255-")
    assert t.driver.error_code_and_message == (60, "MALFORMED INPUT: MOTORS STOPPED")
    assert not t.place.driving()


@CHECKS.add("move_indefinite, stop, abort_motion")
def an_indefinite_move_runs_until_it_is_stopped(t: Trial) -> None:
    for direction, sign in (("+", 1), ("-", -1)):
        t.driver.axis[0].move_indefinite(direction)
        wait_for(t.place.driving, "the motor to run")
        t.driver.axis[0].stop() if sign > 0 else t.driver.abort_motion()
        arrive(t, 1)
        assert not t.place.driving()
        assert t.place.drives(1)[-1].sign == sign


@CHECKS.add("velocity, acceleration")
def velocity_is_read_as_a_whole_number_also_where_the_pulses_bound_it(t: Trial) -> None:
    axis = t.driver.axis[0]
    assert magnitude(axis.velocity) == _VELOCITY
    axis.velocity = _USUAL_VELOCITY
    assert magnitude(axis.velocity) == 1000 // (STEP_MS + 1)
    assert t.errors() == [110]
    axis.acceleration = 500
    assert magnitude(axis.acceleration) == 500
    assert t.place.drives() == []


@CHECKS.add("home_position, motor_type")
def a_home_position_and_a_motor_type_drive_nothing(t: Trial) -> None:
    axis = t.driver.axis[0]
    axis.home_position = 444
    assert axis.home_position == axis.position == 444
    axis.motor_type = axis.MotorType.none
    axis.move_relative = 2
    assert t.errors() == [108]
    axis.motor_type = axis.MotorType.standard
    assert axis.motor_type == axis.MotorType.standard
    assert t.place.drives() == []


@CHECKS.add("name, firmware_version, scan_controllers, network")
def what_it_asks_is_answered(t: Trial) -> None:
    assert t.driver.name.startswith("mirrormount,")
    model, word, version, maker = t.driver.firmware_version.split()
    assert (model, word, maker) == ("MM2", "Version", "mirrormount") and version in t.driver.name
    assert t.driver.controller_address == 1
    assert t.driver.scan_controllers == "2"
    assert t.driver.scan_done
    assert t.driver.ip_address == t.driver.gateway == t.driver.netmask == "0.0.0.0"
    assert t.place.drives() == []


@CHECKS.add("multiple_controllers")
def of_several_controllers_only_the_first_is_this_one(t: Trial) -> None:
    t.driver.multiple_controllers = True
    t.driver.axis[0].move_relative = 2
    arrive(t, 1)
    t.driver.axis[4].move_relative = 5
    assert t.driver.axis[0].error_code == 48
    assert t.driver.axis[0].is_stopped
    t.driver.multiple_controllers = False
    assert t.place.driven_ms(1) == [STEP_MS] * 2


@CHECKS.add("save_settings, recall_parameters")
def settings_are_saved_and_recalled(t: Trial) -> None:
    t.driver.axis[0].velocity = 9
    t.driver.recall_parameters(1)
    assert magnitude(t.driver.axis[0].velocity) == _VELOCITY
    t.driver.save_settings()
    assert t.driver.error_code == 0
