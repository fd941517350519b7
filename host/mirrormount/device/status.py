"""What a board reports of itself and of its axes, as plain data.

AxisStatus, Status and their neighbours are single answers. Board is what a session knows of its board so far: identity,
axes, last status. Nothing here reads or writes a port.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from mirrormount.errors import REASONS, BadValue, BoardError, NotAMount
from mirrormount.markup import html_table
from mirrormount.terminal import printable
from mirrormount.values import axis_name, paired, whole_numbers
from mountfw import codes as wire

_AXIS_NUMBER = re.compile(r"\bAXIS ([1-9])\b")

CERTAINTY = dict(enumerate(wire.CERTAINTY))


@dataclass(frozen=True)
class AxisStatus:
    """State of one axis. position in steps; limits bit 0 positive, 1 negative, 2 home."""

    position: float
    moving: bool
    direction: int
    limits: int
    reason: int
    certainty: str

    def __str__(self) -> str:
        return f"{self.position:+.3f} steps ({self.certainty}), {'moving' if self.moving else 'at rest'}"

    def _repr_html_(self) -> str:
        return table({"": self})


@dataclass(frozen=True)
class Status:
    """State of a board. axes: in the board's order; x_axis: the number of the one that is called x."""

    boot_id: int
    uptime_s: float
    errors_waiting: int
    axes: tuple[AxisStatus, ...]
    x_axis: int

    @property
    def x(self) -> AxisStatus:
        """The horizontal axis."""
        return self.axes[self.x_axis - 1]

    @property
    def y(self) -> AxisStatus:
        """The vertical axis."""
        return self.axes[paired(self.x_axis) - 1]

    @property
    def by_name(self) -> dict[str, AxisStatus]:
        """All axes by their names: x, y, axis3 …"""
        numbered = {axis_name(i, self.x_axis): axis for i, axis in enumerate(self.axes, 1)}
        return {"x": self.x, "y": self.y, **numbered}

    @property
    def moving(self) -> bool:
        """True while any axis moves."""
        return any(axis.moving for axis in self.axes)

    def __str__(self) -> str:
        return "; ".join(f"{name}: {axis}" for name, axis in self.by_name.items())

    def _repr_html_(self) -> str:
        return table(self.by_name)


@dataclass(frozen=True)
class Ended:
    """How a move ended: the board's reason number, steps made (signed), time under drive in seconds."""

    reason: int
    steps: int
    on_time_s: float


@dataclass(frozen=True)
class Homed:
    """How homing ended. discrepancy_steps: by how much the count was off; None if no earlier home was known."""

    discrepancy_steps: float | None


@dataclass(frozen=True)
class Limits:
    """Soft limits, in steps: a move beyond them is refused, and a run ends there, while they are checked."""

    minimum: int
    maximum: int
    checked: bool = True


@dataclass(frozen=True)
class QueuedError:
    """One error of the board's queue: its number (docs/errors.md has cause and remedy) and its text.

    The text has the user's name of an axis where the board's has its number: "x POSITIVE END-STOP REACHED".
    """

    code: int
    text: str

    def __str__(self) -> str:
        return f"{self.code}: {self.text.lower()}"


def table(axes: Mapping[str, AxisStatus], caption: str = "") -> str:
    """Axes as an HTML table, for a notebook; the caption is text."""
    rows = [
        (
            name,
            f"{axis.position:+.3f}",
            axis.certainty,
            "moving" if axis.moving else "at rest",
            REASONS.get(axis.reason, axis.reason),
        )
        for name, axis in axes.items()
    ]
    return html_table(("axis", "steps", "certainty", "now", "last move"), rows, caption)


def parse_status(line: str, x_axis: int) -> Status:
    """The answer to XS?, of two axes or more; x_axis is the number of x. Raises NotAMount."""
    try:
        head, *axes = line.split("|")
        boot_id, uptime_ms, errors_waiting = whole_numbers(head, 3)
        by_number = tuple(
            AxisStatus(position / 1000, bool(moving), direction, limits, reason, CERTAINTY[certainty])
            for position, moving, direction, limits, reason, certainty in (whole_numbers(axis, 6) for axis in axes)
        )
        if len(by_number) < 2:
            raise NotAMount("a mount has two axes or more")
        return Status(boot_id, uptime_ms / 1000, errors_waiting, by_number, x_axis)
    except (KeyError, NotAMount) as e:
        raise NotAMount(f"not a mount's status: {line[:80]!r}") from e


def parse_error(line: str, x_axis: int) -> QueuedError:
    """The answer to TB?: "62, KEEP-ALIVE LOST", of a board whose axis x_axis is called x. Raises NotAMount."""
    code, _, text = line.partition(",")
    text = _AXIS_NUMBER.sub(lambda m: axis_name(int(m[1]), x_axis), printable(text.strip()))
    try:
        return QueuedError(int(code), text)
    except ValueError as e:
        raise NotAMount(f"not an error of a mount: {line[:80]!r}") from e


RESET_CAUSES = {
    str(wire.POWER): "power, or its reset pin",
    str(wire.ASKED): "it was told to",
    str(wire.WATCHDOG): "its watchdog: the firmware had hung",
}


def check_x_axis(x_axis: object) -> None:
    """Raises BadValue for a number that x cannot have on any board."""
    if isinstance(x_axis, bool) or not isinstance(x_axis, int) or not 1 <= x_axis <= AXES_MOST:
        raise BadValue(f"x_axis is the number of an axis, 1 to {AXES_MOST}, not {x_axis!r}")


AXES_MOST = 4


# ---- what a session knows of its board


def check_same_board(before: str, now: str) -> None:
    """Raise NotAMount if two answers to *IDN? are of two boards: kind and id differ; the firmware's version may."""
    if before.split(",")[:3] != now.split(",")[:3]:
        raise NotAMount(f"another board is there: {now}; to drive it, start this program again")


class Board:
    """A board with two axes or more. identity: its answer to *IDN?; x_axis: the number of the axis called x.

    last: when the last status came (on the clock of receive_status()), and the status; None before the first.
    """

    def __init__(self, identity: str, x_axis: int) -> None:
        self.identity = identity
        self.x_axis = x_axis
        self.last: tuple[float, Status] | None = None
        self.encoders: dict[int, bool] = {}  # by number: has the axis one? As far as it was asked
        self.numbers: dict[str, int] = {}  # of the axes, by name: x, y, axis3 …
        self._boot_id: int | None = None

    @property
    def id(self) -> str:
        """The board's unique id."""
        return self.identity.rsplit(",", 2)[1]

    def receive_status(self, line: str, now_s: float) -> Status:
        """Parse an answer to XS?. Raises NotAMount, also for another number of axes than before."""
        status = parse_status(line, self.x_axis)
        count = len(status.axes)
        if max(self.x_axis, paired(self.x_axis)) > count:
            raise BadValue(f"the board has {count} axes: {self.x_axis} and {paired(self.x_axis)} are no pair of them")
        if not self.last:
            names = {axis_name(number, self.x_axis): number for number in range(1, count + 1)}
            self.numbers = {name: names[name] for name in status.by_name}
        elif count != len(self.numbers):
            raise NotAMount(f"the board had {len(self.numbers)} axes and has {count} now: open it again")
        self.last = now_s, status
        return status

    def has_restarted(self, status: Status) -> bool:
        """True for the first status after a restart that was not expected."""
        before, self._boot_id = self._boot_id, status.boot_id
        return before is not None and before != status.boot_id

    def expect_restart(self) -> None:
        """The next status may have another boot id."""
        self._boot_id = None

    def parse_error(self, line: str) -> QueuedError:
        """An entry of the error queue, with the names of the axes. Raises NotAMount."""
        return parse_error(line, self.x_axis)

    def exception(self, line: str) -> BoardError:
        """An entry of the error queue as an exception. Raises NotAMount."""
        error = self.parse_error(line)
        return BoardError(error.code, error.text)
