"""A table whose mounts this program drives itself, in lockstep or in real time. Imports mount, loop_table.

Each move is watched by its caller, who asks is_moving() until it is over: that feeds the board's keep-alive. A loop
that dies or hangs stops asking, and the board switches its motors off within half a second.
"""

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence

from mirrormount.beam.loop_table import Eye
from mirrormount.common.errors import MountError, MoveEnded
from mirrormount.device.axis import Axis
from mirrormount.device.mount import Mount
from mountfw import codes as wire


class DirectAxis:
    """An axis of a mount of this program."""

    def __init__(self, mount_name: str, mount: Mount, axis: Axis) -> None:
        self.name = f"{mount_name}.{axis.name}"
        self.board_id = mount.board_id
        self.step_us = axis.ask_whole("XP?")[0]
        self._mount, self._axis = mount, axis
        self._begun = False

    def pulse(self, us: int) -> None:
        """As Actuator.pulse()."""
        self._axis.pulse(us, wait=False, feed=False, by_sight=True)
        self._begun = True

    def step(self, n: int) -> None:
        """As Actuator.step()."""
        self._axis.step(n, wait=False, feed=False, by_sight=True)
        self._begun = True

    def is_moving(self) -> bool:
        """As Actuator.is_moving()."""
        if self._axis.status().moving:
            return True
        if self._begun:
            self._begun = False
            ended = self._axis.last_move()
            if ended.reason != wire.DONE:
                errors = self._mount.errors()
                codes = tuple(error.code for error in errors)
                raise MoveEnded(self.name, ended.reason, ended.steps, None, list(map(str, errors)), codes)
        return False

    def stop(self) -> None:
        """All motors of the board off."""
        self._begun = False
        self._mount.stop()


class DirectTable:
    """Mounts and eyes of this program. now_s, sleep: of the table's clock."""

    taken_over = ""  # nobody else drives these mounts; a stop by another program ends a move, and closes a gate
    lost_board = ""  # a motion tells it

    def __init__(
        self,
        mounts: Mapping[str, Mount],
        eyes: Sequence[Eye],
        now_s: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self.actuators = [
            DirectAxis(name, mount, mount.axis(axis))
            for name, mount in mounts.items()
            for axis in in_order(mount.by_name)
        ]
        self.eyes = list(eyes)
        self.now_s = now_s
        self._sleep = sleep
        self._mounts = list(mounts.values())

    def stop(self) -> None:
        """As LoopTable.stop(). A board that has gone, or is slow to confirm it, keeps no other one from its stop."""
        for mount in self._mounts:
            with contextlib.suppress(MountError):  # told by what follows
                mount.halt()
        failures: list[MountError] = []
        for actuator in self.actuators:
            try:
                actuator.stop()
            except MountError as e:
                failures.append(e)
        if failures:
            raise failures[-1]

    def sleep(self, seconds: float) -> None:
        """Let the table's time pass."""
        self._sleep(seconds)

    def take_control(self) -> None:
        """There is nobody to ask."""


def in_order(axes: Iterable[str]) -> list[str]:
    """x before y, then further axes by their names."""
    return sorted(axes, key=lambda name: (name not in ("x", "y"), name))
