"""What a page may ask the mount to do: plain data, checked here and nowhere else. Pure.

Every order comes as one JSON object; parse() turns it into one of these, or says what is wrong with it.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mirrormount.common.errors import BadValue
from mirrormount.common.validation import whole_number

MOST_STEPS = 1_000_000
FINE_STEPS = 1
COARSE_STEPS = 10
FULL = 255


@dataclass(frozen=True)
class Press:
    """A direction button goes down: some steps at once, and a run at `speed` (1 … 255) if it is held.

    x, y: which way, -1, 0 or 1; both for a diagonal.
    """

    x: int
    y: int
    speed: int
    coarse: bool

    @property
    def ways(self) -> dict[str, int]:
        """The axes that take part, each with its way."""
        return {axis: way for axis, way in (("x", self.x), ("y", self.y)) if way}

    @property
    def steps(self) -> dict[str, int]:
        """Steps made at once, signed."""
        return {axis: way * (COARSE_STEPS if self.coarse else FINE_STEPS) for axis, way in self.ways.items()}

    @property
    def run(self) -> dict[str, float]:
        """Speeds of the run, -1 … 1; a coarse one goes at full speed."""
        return {axis: way * (1.0 if self.coarse else self.speed / FULL) for axis, way in self.ways.items()}


@dataclass(frozen=True)
class Steps:
    """Move by n steps."""

    axis: str
    n: int


@dataclass(frozen=True)
class GoTo:
    """Move to a position, in steps."""

    axis: str
    position: int


@dataclass(frozen=True)
class Drive:
    """Run both axes at -255 … 255."""

    x: int
    y: int


@dataclass(frozen=True)
class Home:
    """Find an axis's home."""

    axis: str


@dataclass(frozen=True)
class Zero:
    """Call an axis's present position 0."""

    axis: str


Order = Press | Steps | GoTo | Drive | Home | Zero


def parse(message: Mapping[str, Any]) -> Order:
    """The order in a message. Raises BadValue in words for the person who typed it."""
    what = message.get("do")
    if what == "drive":
        return Drive(_whole(message, "x", FULL, "the speed of X"), _whole(message, "y", FULL, "the speed of Y"))
    if what == "press":
        return _press(message)
    axis = message.get("axis")
    if axis not in ("x", "y"):
        raise BadValue(f"an axis is x or y, not {axis!r}")
    if what == "steps":
        way = _way(message)
        n = _whole(message, "n", MOST_STEPS, "the number of steps")
        if n < 1:
            raise BadValue(f"the number of steps is 1 or more, not {n}: the button says which way")
        return Steps(axis, way * n)
    if what == "goto":
        return GoTo(axis, _whole(message, "to", MOST_STEPS, f"the target of {axis}"))
    if what == "home":
        return Home(axis)
    if what == "zero":
        return Zero(axis)
    raise BadValue(f"there is no order {what!r}")


def _press(message: Mapping[str, Any]) -> Press:
    x, y = (_whole(message, axis, 1, "a direction") for axis in ("x", "y"))
    if not (x or y):
        raise BadValue("a press has a direction")
    speed = _whole(message, "speed", FULL, "the speed")
    if speed < 1:
        raise BadValue(f"the speed is 1 … {FULL}, not {speed}")
    return Press(x, y, speed, message.get("coarse") is True)


def _way(message: Mapping[str, Any]) -> int:
    way = _whole(message, "way", 1, "a direction")
    if way == 0:
        raise BadValue("a direction is 1 or -1, not 0")
    return way


def _whole(message: Mapping[str, Any], key: str, most: int, what: str) -> int:
    """A whole number; text as it was typed is understood, and nothing is rounded."""
    value = message.get(key)
    if isinstance(value, str):
        text = value.strip().replace("\N{MINUS SIGN}", "-")
        if not text:
            raise BadValue(f"{what}: type a number")
        value = int(text) if re.fullmatch(r"[+-]?[0-9]{1,9}", text) else text[:40]
    return whole_number(value, most, what)
