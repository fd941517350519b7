"""quartiq's `newfocus8742` (GitHub), over TCP: the driver behind ARTIQ's controller for the 8742.

Its methods are coroutines, or write and return; here each is called as a program without a loop of its own would.
"""

import asyncio
import importlib
from typing import Any

from checks import Checks, Trial
from place import PERIOD_MS, STEP_MS, wait_for

NAME = "newfocus8742"
WAYS = ("tcp",)
CHECKS = Checks()

_VELOCITY, _USUAL_VELOCITY = 1000 // PERIOD_MS, 1750  # here, and of its own controllers


class Blocking:
    """Its driver with a loop that runs while a method does."""

    def __init__(self, host: str, port: int) -> None:
        tcp = importlib.import_module("newfocus8742.tcp")
        self._loop = asyncio.new_event_loop()
        self._driver = self._run(tcp.NewFocus8742TCP.connect(host, port))

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._driver, name)
        return lambda *arguments: self._run(self._call(method, arguments))

    def end(self) -> None:
        """Close the driver, and the loop."""
        self.close()
        self._loop.close()

    def _run(self, what: Any) -> Any:
        return self._loop.run_until_complete(what)

    async def _call(self, method: Any, arguments: tuple) -> Any:
        result = method(*arguments)
        if asyncio.iscoroutine(result):
            return await result
        await asyncio.sleep(0)  # lets the transport write
        return result


def connect(address: str, way: str, **_options: Any) -> Any:
    """An open driver."""
    assert way == "tcp"
    host, port = address.split(":")
    return Blocking(host, int(port))


def disconnect(driver: Any) -> None:
    """Close it."""
    driver.end()


def send(driver: Any, line: str) -> str:
    """A line of its own; the answer if it asks for one."""
    if line.endswith("?"):
        return driver.ask(line)
    driver.do(line)
    return ""


@CHECKS.add("set_relative, finish")
def set_relative_makes_as_many_pulses_as_it_was_told(t: Trial) -> None:
    t.driver.set_relative(1, 3)
    t.driver.finish(1)
    t.driver.set_relative(2, -2)
    t.driver.finish(2)
    assert t.place.driven_ms(1) == [STEP_MS] * 3
    assert t.place.driven_ms(2) == [-STEP_MS] * 2
    assert [t.driver.position(axis) for axis in (1, 2, 3, 4)] == [3, -2, 0, 0]
    assert t.driver.get_relative(1) == 3


@CHECKS.add("set_position")
def set_position_goes_on_from_where_it_is(t: Trial) -> None:
    for position in (2, -1):
        t.driver.set_position(2, position)
        t.driver.finish(2)
        assert t.driver.position(2) == t.driver.get_position(2) == position
    assert t.place.driven_ms(2) == [STEP_MS] * 2 + [-STEP_MS] * 3
    assert t.place.driven_ms(1) == []


@CHECKS.add("abort")
def abort_cuts_the_pulses_of_both_axes(t: Trial) -> None:
    t.line("1XP2000000;2XP2000000")
    t.driver.set_relative(1, 50)
    t.driver.set_relative(2, -50)
    wait_for(lambda: t.place.driving(1) and t.place.driving(2), "both motors to run")
    t.driver.abort()
    t.driver.done(1)
    assert not t.place.driving()
    for axis in (1, 2):
        assert t.line(f"{axis}XE?").startswith("3,")


@CHECKS.add("stop")
def stop_ends_a_long_move_after_a_pulse(t: Trial) -> None:
    t.driver.set_relative(1, 999_999)
    wait_for(lambda: t.place.driving(1), "the motor to run")
    t.driver.stop(1)
    t.driver.finish(1)
    assert set(t.place.driven_ms(1)) == {STEP_MS}
    assert t.driver.position(1) == len(t.place.driven_ms(1))


@CHECKS.add("set_velocity")
def velocity_is_read_as_a_whole_number_also_where_the_pulses_bound_it(t: Trial) -> None:
    assert t.driver.get_velocity(1) == _VELOCITY
    t.driver.set_velocity(1, 10)
    t.driver.set_relative(1, 3)
    t.driver.finish(1)
    assert t.place.periods_ms(1) == {100}
    t.driver.set_velocity(1, _USUAL_VELOCITY)
    assert t.driver.get_velocity(1) == 1000 // (STEP_MS + 1)
    assert t.driver.error_message() == "110, AXIS 1 VELOCITY TOO HIGH"


@CHECKS.add("set_home, get_home")
def a_home_is_counted_from_and_drives_nothing(t: Trial) -> None:
    t.driver.set_home(1, 7)
    assert t.driver.get_home(1) == t.driver.position(1) == 7
    assert t.place.drives() == []


@CHECKS.add("identify, error_code, get_type, get_acceleration")
def what_it_asks_is_answered(t: Trial) -> None:
    assert t.driver.identify().startswith("mirrormount,")
    assert t.driver.error_code() == 0
    assert [t.driver.get_type(axis) for axis in (1, 2, 3, 4)] == [3, 3, 0, 0]
    assert t.driver.get_acceleration(1) == 100_000
    assert t.place.drives() == []
