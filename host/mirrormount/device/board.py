"""State that a board has reported: identity, axes, last status. No I/O. Imports errors, status."""

from mirrormount.common.axis_names import axis_name, paired
from mirrormount.common.errors import BadValue, BoardError, NotAMount
from mirrormount.device.status import QueuedError, Status, parse_error, parse_status
from mountfw import codes as wire

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
