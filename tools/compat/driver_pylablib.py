"""pylablib's `Picomotor8742` (PyPI: pylablib-lightweight or pylablib), over TCP and over a serial port.

Steps are counted in pulses of the enables: `[20, 20]` are two steps of 20 ms forwards, `[-20]` is one backwards.
"""

import importlib
from typing import Any

from checks import Checks, Trial
from place import PERIOD_MS, STEP_MS, wait_for

NAME = "pylablib"
WAYS = ("tcp", "pty")
CHECKS = Checks()

_NEWPORT_USUAL = 1750  # steps per second that its own controllers have as made: too fast for a gearmotor
_VELOCITY, _ACCELERATION = 1000 // PERIOD_MS, 100_000
_NO_NETWORK = ("mirrormount", "static", "0.0.0.0", "0.0.0.0", "0.0.0.0")
_A_NETWORK = {
    "hostname": "lab-8742",
    "ipmode": "dhcp",
    "ipaddr": "192.168.1.17",
    "gateway": "192.168.1.1",
    "netmask": "255.255.255.0",
}


def connect(address: str, way: str, **options: Any) -> Any:
    """An open Picomotor8742."""
    from pylablib.core.devio import comm_backend

    # it gives the controller's greeting 10 ms after the connection was made; a busy computer may need longer
    comm_backend.NetworkDeviceBackend._default_operation_cooldown = {"default": 0.0, "open": 0.2}
    newport = importlib.import_module("pylablib.devices.Newport")
    return newport.Picomotor8742(address, backend={"tcp": "network", "pty": "serial"}[way], **options)


def disconnect(driver: Any) -> None:
    """Close it."""
    driver.close()


def send(driver: Any, line: str) -> str:
    """A line of its own; the answer if it asks for one."""
    return driver.query(line) or ""


# ---- motion


@CHECKS.add("move_by")
def move_by_makes_as_many_pulses_as_it_was_told(t: Trial) -> None:
    t.driver.move_by(1, 3)
    t.driver.move_by(2, -2)
    t.driver.wait_move()
    assert t.place.driven_ms(1) == [STEP_MS] * 3
    assert t.place.driven_ms(2) == [-STEP_MS] * 2
    assert t.driver.get_position() == [3, -2, 0, 0]


@CHECKS.add("move_to")
def move_to_goes_on_from_where_it_is(t: Trial) -> None:
    for position in (2, -1):
        t.driver.move_to(2, position)
        t.driver.wait_move(2)
        assert t.driver.get_position(2) == position
    assert t.place.driven_ms(2) == [STEP_MS] * 2 + [-STEP_MS] * 3
    assert t.place.driven_ms(1) == []


@CHECKS.add("wait_move")
def wait_move_returns_when_the_last_pulse_is_over(t: Trial) -> None:
    t.driver.move_by(1, 5)
    assert t.driver.is_moving() == [True, False, False, False]
    t.driver.wait_move("all")
    assert not t.place.driving()
    assert t.place.driven_ms(1) == [STEP_MS] * 5


@CHECKS.add("move_by in a move")
def a_move_in_a_move_is_refused_and_the_first_goes_on(t: Trial) -> None:
    t.driver.move_by(1, 6)
    t.driver.move_by(1, -9)
    t.driver.wait_move(1)
    assert t.place.driven_ms(1) == [STEP_MS] * 6
    assert t.errors() == [114]


@CHECKS.add("move_by, axes 3 and 4")
def axes_that_the_mount_has_not_drive_nothing(t: Trial) -> None:
    t.driver.move_by(3, 5)
    t.driver.jog(4, "+")
    t.driver.wait_move()
    assert t.place.drives() == []
    assert t.driver.get_position() == [0, 0, 0, 0]
    assert t.errors() == [308, 408]


@CHECKS.add("jog, stop")
def jog_runs_until_stop(t: Trial) -> None:
    for axis, direction, sign in ((1, "+", 1), (2, "-", -1)):
        t.driver.jog(axis, direction)
        wait_for(lambda axis=axis: t.place.driving(axis), "the motor to run")
        t.driver.stop(axis)
        assert not t.place.driving()
        (drive,) = t.place.drives(axis)
        assert drive.sign == sign
        assert abs(t.driver.get_position(axis) - drive.ms / STEP_MS) < 1


@CHECKS.add("jog, no stop")
def a_jog_that_nobody_stops_ends_at_the_run_limit(t: Trial) -> None:
    t.line("2XM300")
    t.driver.jog(2, "-")
    t.driver.wait_move()
    assert t.place.driven_ms(2) == [-300]
    assert t.errors() == [240]


@CHECKS.add("close in a jog", ways=("tcp",))
def a_driver_that_is_closed_in_a_jog_stops_the_motor(t: Trial) -> None:
    t.driver.jog(1, "-")
    wait_for(t.place.driving, "the motor to run")
    t.disconnect()
    wait_for(lambda: not t.place.driving(), "the motor to stop")
    t.connect()
    assert t.line("1XE?").startswith("3,")


@CHECKS.add("stop(immediate=True)")
def an_immediate_stop_cuts_pulses_of_both_axes(t: Trial) -> None:
    long_ms = 2000
    t.line(f"1XP{long_ms * 1000};2XP{long_ms * 1000}")
    t.driver.move_by(1, 1)
    t.driver.move_by(2, -1)
    wait_for(lambda: t.place.driving(1) and t.place.driving(2), "both motors to run")
    t.driver.stop(immediate=True)
    assert not t.place.driving()
    for axis, sign in ((1, 1), (2, -1)):
        (drive,) = t.place.drives(axis)
        assert drive.sign == sign and abs(drive.ms) < long_ms
        assert abs(t.driver.get_position(axis) - drive.ms / long_ms) < 1
        assert t.line(f"{axis}XE?").startswith("3,0,")


@CHECKS.add("stop()")
def a_gentle_stop_lets_a_short_pulse_end(t: Trial) -> None:
    t.line("1XP200000;2XP200000")
    t.driver.move_by(1, 50)
    t.driver.move_by(2, -50)
    wait_for(lambda: t.place.driving(1) and t.place.driving(2), "both motors to run")
    t.driver.stop()
    assert not t.place.driving()
    for axis, sign in ((1, 1), (2, -1)):
        pulses = t.place.driven_ms(axis)
        assert 0 < len(pulses) < 50 and set(pulses) == {sign * 200}
        assert t.driver.get_position(axis) == sign * len(pulses)


@CHECKS.add("stop(axis=1)")
def a_stop_of_one_axis_leaves_the_other_alone(t: Trial) -> None:
    t.driver.jog(1, "+")
    wait_for(t.place.driving, "the motor to run")
    t.driver.move_by(2, 3)
    t.driver.stop(axis=1)
    assert not t.place.driving(1)
    t.driver.wait_move(2)
    assert t.place.driven_ms(2) == [STEP_MS] * 3
    assert t.driver.get_position(2) == 3


# ---- settings


@CHECKS.add("setup_velocity")
def velocity_is_the_rate_of_the_pulses(t: Trial) -> None:
    assert t.driver.get_velocity_parameters()[:2] == [(_VELOCITY, _ACCELERATION)] * 2
    assert t.driver.setup_velocity(1, speed=10, accel=50) == (10, 50)
    t.driver.move_by(1, 3)
    t.driver.move_by(2, 3)
    t.driver.wait_move()
    assert t.place.periods_ms(1) == {100}
    assert t.place.periods_ms(2) == {PERIOD_MS}
    assert t.driver.get_position() == [3, 3, 0, 0]


@CHECKS.add("setup_velocity, too fast")
def of_a_velocity_that_the_pulses_do_not_fit_in_as_much_is_made_as_is_possible(t: Trial) -> None:
    assert t.driver.setup_velocity(2, speed=_NEWPORT_USUAL) == (1000 // (STEP_MS + 1), _ACCELERATION)
    assert t.errors() == [210]
    t.driver.move_by(2, 2)
    t.driver.wait_move()
    assert t.place.driven_ms(2) == [STEP_MS] * 2
    assert t.place.periods_ms(2) == {STEP_MS}  # to 10 ms: 47 a second


@CHECKS.add("stop in a long move")
def a_move_over_all_the_travel_is_begun_and_can_be_stopped(t: Trial) -> None:
    t.driver.move_to(1, 999_999)
    wait_for(lambda: t.place.driving(1), "the motor to run")
    assert t.driver.is_moving(1)
    t.driver.stop(immediate=True)
    assert not t.place.driving()


@CHECKS.add("query(…)")
def numbers_of_32_bits_are_refused_and_stop_nothing(t: Trial) -> None:
    t.driver.jog(2, "-")
    wait_for(lambda: t.place.driving(2), "the motor to run")
    t.driver.move_to(1, 2147483647)
    assert t.errors() == [101]
    assert t.place.driving(2) and not t.place.drives(1)
    t.driver.stop(2)


@CHECKS.add("set_position_reference")
def a_position_reference_is_counted_from_and_drives_nothing(t: Trial) -> None:
    assert t.driver.set_position_reference(1, 100) == 100
    assert t.place.drives() == []
    t.driver.move_to(1, 98)
    t.driver.wait_move()
    assert t.place.driven_ms(1) == [-STEP_MS] * 2
    assert t.driver.get_position() == [98, 0, 0, 0]


@CHECKS.add("set_motor_type")
def an_axis_without_a_motor_does_not_drive(t: Trial) -> None:
    assert t.driver.get_motor_type() == ["standard", "standard", "none", "none"]
    assert t.driver.set_motor_type(1, "none") == "none"
    t.driver.move_by(1, 2)
    t.driver.move_by(2, 1)
    t.driver.wait_move()
    assert t.place.driven_ms(1) == [] and t.place.driven_ms(2) == [STEP_MS]
    assert t.errors() == [108]
    assert t.driver.set_motor_type(1, "standard") == "standard"
    t.driver.move_by(1, 1)
    t.driver.wait_move()
    assert t.place.driven_ms(1) == [STEP_MS]


@CHECKS.add("autodetect_motors")
def autodetect_motors_drives_nothing(t: Trial) -> None:
    assert t.driver.autodetect_motors() == ["standard", "standard", "none", "none"]
    assert t.place.drives() == []
    assert t.driver.get_position() == [0, 0, 0, 0]


@CHECKS.add("save_parameters, power off and on")
def saved_parameters_are_there_after_a_power_cut(t: Trial) -> None:
    t.driver.setup_velocity(1, speed=5)
    t.driver.set_motor_type(2, "none")
    t.driver.save_parameters()
    t.driver.setup_velocity(1, speed=9)
    try:
        t.restart()
        assert t.driver.get_velocity_parameters(1)[0] == 5
        t.driver.move_by("all", 2)
        t.driver.wait_move()
        assert len(t.place.driven_ms(1)) == 2 and t.place.periods_ms(1) == {200}
        assert t.place.driven_ms(2) == []
        assert t.errors() == [208, 308, 408]
    finally:
        t.driver.setup_velocity(1, speed=_VELOCITY)
        t.driver.set_motor_type(2, "standard")
        t.driver.save_parameters()


@CHECKS.add("restore_parameters('memory')")
def restored_parameters_are_the_saved_ones(t: Trial) -> None:
    t.driver.setup_velocity(1, speed=5)
    t.driver.restore_parameters()
    assert t.driver.get_velocity_parameters(1)[0] == _VELOCITY
    t.driver.move_by(1, 2)
    t.driver.wait_move()
    assert t.place.driven_ms(1) == [STEP_MS] * 2
    assert t.place.periods_ms(1) == {PERIOD_MS}


@CHECKS.add("restore_parameters('factory')")
def factory_parameters_are_steps_of_200_ms_two_a_second(t: Trial) -> None:
    t.driver.restore_parameters("factory")
    assert t.driver.get_velocity_parameters(2)[0] == 2
    t.driver.move_by(2, 2)
    t.driver.wait_move()
    assert t.place.driven_ms(2) == [200, 200]
    assert t.place.periods_ms(2) == {500}


@CHECKS.add("reset in a jog", slow=True)
def reset_stops_the_motors_and_comes_back_with_the_saved_settings(t: Trial) -> None:
    t.driver.setup_velocity(2, speed=9)
    t.driver.jog(1, "+")
    wait_for(t.place.driving, "the motor to run")
    assert t.driver.reset().startswith("mirrormount,")
    (jogged,) = t.place.drives(1)
    assert jogged.sign == 1 and jogged.ms < 5000  # it sleeps for 5 s after the command
    assert t.driver.get_velocity_parameters(2)[0] == _VELOCITY
    t.driver.move_by(2, 1)
    t.driver.wait_move()
    assert t.place.driven_ms(2) == [STEP_MS]


# ---- who and what is there


@CHECKS.add("get_id, get_device_info")
def the_mount_names_itself(t: Trial) -> None:
    assert t.driver.get_id().startswith("mirrormount,")
    assert t.driver.get_device_info().id == t.driver.get_id()
    assert t.place.drives() == []


@CHECKS.add("get_full_info")
def a_full_dump_has_every_answer_and_drives_nothing(t: Trial) -> None:
    info = t.driver.get_full_info("all")
    assert info["position"] == [0, 0, 0, 0]
    assert info["moving"] == [False] * 4
    assert info["motor_type"] == ["standard", "standard", "none", "none"]
    assert info["velocity_parameters"] == [(_VELOCITY, _ACCELERATION)] * 2 + [(0, 0)] * 2
    assert info["ethernet_parameters"] == _NO_NETWORK
    assert info["addr_map"] == ([1], False)
    assert info["device_info"].id == t.driver.get_id()
    assert info.keys() - {"device_info", "cls", "conn", "axes"} == t.driver.get_full_status("all").keys()
    assert t.place.drives() == []


@CHECKS.add("get_full_info, setup_ethernet in a move")
def a_full_dump_and_network_settings_leave_a_move_alone(t: Trial) -> None:
    t.driver.move_by(1, 40)
    info = t.driver.get_full_info("all")
    assert t.driver.setup_ethernet(**_A_NETWORK) == _NO_NETWORK
    assert info["moving"] == [True, False, False, False] and t.driver.is_moving(1)
    t.driver.wait_move()
    assert t.place.driven_ms(1) == [STEP_MS] * 40
    assert t.place.periods_ms(1) == {PERIOD_MS}
    assert t.place.driven_ms(2) == []
    assert t.line("1XE?").startswith("1,40,")
    assert t.driver.get_position() == [40, 0, 0, 0]


@CHECKS.add("scan_devices, set_addr")
def a_scan_finds_one_controller_at_address_1_and_drives_nothing(t: Trial) -> None:
    for reassign in ("none", "conflict", "all"):
        assert t.driver.scan_devices(reassign) == ([1], False)
    assert t.driver.set_addr(3) == 1
    assert t.place.drives() == []


@CHECKS.add("multiaddr=True")
def with_addresses_it_moves_jogs_and_stops_the_same(t: Trial) -> None:
    t.connect(multiaddr=True)
    t.driver.move_by(1, 2, addr=1)
    t.driver.wait_move(addr=1)
    assert t.driver.get_position(addr="all") == {1: [2, 0, 0, 0]}
    t.driver.jog(2, "-", addr=1)
    wait_for(lambda: t.place.driving(2), "the motor to run")
    t.driver.stop(immediate=True, addr=1)
    assert not t.place.driving()
    assert t.place.driven_ms(1) == [STEP_MS] * 2
    assert [drive.sign for drive in t.place.drives(2)] == [-1]
    assert t.driver.get_full_status()["motor_type"] == {1: ["standard", "standard", "none", "none"]}
    t.connect()
