"""What a loop needs of a table: actuators that give pulses, cameras with targets, one clock. Protocols only.

LocalTable of mirrormount_beam/table.py drives its mounts itself; SharedTable is a client beside a panel's pages.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from mirrormount_beam.table import TargetCamera


class Actuator(Protocol):
    """One axis of one mount. Moves return at once; the loop asks is_moving() until it is at rest.

    name: such as "first.x", of mount and axis. board_id, step_us: to which a calibration belongs.
    Methods raise MountError: BoardError (refused), MoveEnded (it ended early), NotInControl, ConnectionLost, NoAnswer.
    """

    @property
    def name(self) -> str: ...

    @property
    def board_id(self) -> str: ...

    @property
    def step_us(self) -> int: ...

    def pulse(self, us: int) -> None:
        """Begin one pulse of |us| microseconds, 200 … 2 000 000, in the direction of its sign."""
        ...

    def step(self, n: int) -> None:
        """Begin n steps."""
        ...

    def is_moving(self) -> bool:
        """Ask, and keep the motion alive. Raises what ended it early, once."""
        ...

    def stop(self) -> None:
        """All motors of its board off, at once."""
        ...


class LoopTable(Protocol):
    """Actuators in the order of the beam (first.x, first.y, second.x …), cameras in the order of the beam."""

    @property
    def actuators(self) -> Sequence[Actuator]: ...

    @property
    def cameras(self) -> "Sequence[TargetCamera]": ...

    def now_s(self) -> float: ...

    def sleep(self, seconds: float) -> None:
        """Let time pass, with motions kept alive."""
        ...

    def stop(self) -> None:
        """All motors off, at once. Raises ConnectionLost, NoAnswer if a board did not confirm it."""
        ...

    @property
    def taken_over(self) -> str:
        """Why the loop has no control: a person took it, somebody stopped, or a board has gone; "" while it has."""
        ...

    @property
    def lost_board(self) -> str:
        """Why, if it has no control because a board has gone or did not answer; else "". Until take_control()."""
        ...

    def take_control(self) -> None:
        """Ask for control again, after a person has told the loop to go on.

        Raises NotInControl; ConnectionLost, NoAnswer while a board is not there.
        """
        ...
