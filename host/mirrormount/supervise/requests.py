"""Requests to move the mount, as plain data; parse() checks those that arrive as JSON. Pure."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mirrormount import values
from mirrormount.errors import BadValue
from mirrormount.values import real_number, whole_number
from mountfw.settings import MAX_STEPS

MOST_STEPS = MAX_STEPS
FULL = 255
MOST_PRESS_STEPS = 100  # of one press of a direction button
FINE = 4  # A fine press is one step, and its run has the speed divided by this.


@dataclass(frozen=True)
class Press:
    """A direction button goes down: some steps at once, and a run at `speed` (1 … 255) while it is held.

    ways: the axes that take part, each with its direction 1 or -1. steps: of each of them.
    """

    ways: Mapping[str, int]
    speed: int
    steps: int = 1


@dataclass(frozen=True)
class Steps:
    """Move by n steps. by_sight: as Axis.step()."""

    axis: str
    n: int
    by_sight: bool = False


@dataclass(frozen=True)
class Pulse:
    """Give one pulse of |us| microseconds in the direction of its sign. by_sight: as Axis.step()."""

    axis: str
    us: int
    by_sight: bool = False


@dataclass(frozen=True)
class GoTo:
    """Move to a position, in steps."""

    axis: str
    position: int


@dataclass(frozen=True)
class MoveBy:
    """Move by an amount of one of values.UNITS: whole steps, then one pulse for the rest."""

    axis: str
    amount: float
    unit: str


@dataclass(frozen=True)
class MoveTo:
    """Move to a position in one of values.UNITS, as MoveBy. Its scale is the mean of both directions.

    parts: with a pulse for the part of a step; else to the nearest whole step.
    """

    axis: str
    position: float
    unit: str
    parts: bool = True


@dataclass(frozen=True)
class Jog:
    """Run at speed, -1 … 1 and not 0, until stopped."""

    axis: str
    speed: float


@dataclass(frozen=True)
class Drive:
    """Run x and y at -255 … 255."""

    x: int
    y: int


@dataclass(frozen=True)
class Home:
    """Find an axis's home."""

    axis: str


@dataclass(frozen=True)
class Zero:
    """Define an axis's present position as 0."""

    axis: str


Request = Press | Steps | Pulse | GoTo | MoveBy | MoveTo | Jog | Drive | Home | Zero


def parse(message: Mapping[str, Any], axes: Sequence[str] = ("x", "y")) -> Request:
    """The request in a message; axes: the mount's. Raises BadValue, in words for the person who typed it."""
    what = message.get("do")
    if what == "drive":
        return Drive(_whole(message, "x", FULL, "the speed of X"), _whole(message, "y", FULL, "the speed of Y"))
    if what == "press":
        return _press(message, axes)
    axis = message.get("axis")
    if not isinstance(axis, str) or axis not in axes:
        raise BadValue(f"an axis is {' or '.join(axes)}, not {axis!r}")
    if what == "steps":
        way, n, unit = _way(message), _real(message, "n", "how far"), _unit(message)
        if n <= 0:
            raise BadValue(f"how far is more than 0, not {n:g}: the button says which way")
        n *= way
        return Steps(axis, n) if isinstance(n, int) and unit == values.STEPS else MoveBy(axis, n, unit)
    if what == "goto":
        to, unit = _real(message, "to", f"the target of {axis}"), _unit(message)
        return GoTo(axis, to) if isinstance(to, int) and unit == values.STEPS else MoveTo(axis, to, unit)
    if what == "home":
        return Home(axis)
    if what == "zero":
        return Zero(axis)
    raise BadValue(f"there is no order {what!r}")


def _press(message: Mapping[str, Any], axes: Sequence[str]) -> Press:
    ways = {axis: _whole(message, axis, 1, "a direction") for axis in axes if axis in message}
    if not any(ways.values()):
        raise BadValue("a press has a direction")
    moved = {axis: way for axis, way in ways.items() if way}
    speed = _counted(message, "speed", FULL, "the speed")
    if message.get("fine") is True:
        return Press(moved, max(1, speed // FINE))
    return Press(moved, speed, _counted(message, "steps", MOST_PRESS_STEPS, "the step of a press"))


def _counted(message: Mapping[str, Any], key: str, most: int, what: str) -> int:
    """A whole number from 1 on."""
    number = _whole(message, key, most, what)
    if number < 1:
        raise BadValue(f"{what} is 1 … {most}, not {number}")
    return number


def _way(message: Mapping[str, Any]) -> int:
    way = _whole(message, "way", 1, "a direction")
    if way == 0:
        raise BadValue("a direction is 1 or -1, not 0")
    return way


def _unit(message: Mapping[str, Any]) -> str:
    return values.check(str(message.get("unit", values.STEPS))[:40])


def _real(message: Mapping[str, Any], key: str, what: str) -> int | float:
    """A number, whole or with a decimal point, an int if it is whole. Typed text is converted; nothing is rounded."""
    value = message.get(key)
    if isinstance(value, str):
        text = value.strip().replace("\N{MINUS SIGN}", "-")
        if not text:
            raise BadValue(f"{what}: type a number")
        if not re.fullmatch(r"[+-]?([0-9]{1,9}\.?[0-9]{0,9}|\.[0-9]{1,9})", text):
            raise BadValue(f"{what} is a number such as 3 or 0.25, not {text[:40]!r}")
        value = float(text)
    return real_number(value, MOST_STEPS, what)


def _whole(message: Mapping[str, Any], key: str, most: int, what: str) -> int:
    """A whole number. Typed text is converted; nothing is rounded."""
    value = message.get(key)
    if isinstance(value, str):
        text = value.strip().replace("\N{MINUS SIGN}", "-")
        if not text:
            raise BadValue(f"{what}: type a number")
        value = int(text) if re.fullmatch(r"[+-]?[0-9]{1,9}", text) else text[:40]
    return whole_number(value, most, what)
