"""A table whose mounts this program drives itself: in lockstep with a virtual table, where time passes in calls only.

On real boards a loop is a client beside the panel's: supervised.py.
"""

from collections.abc import Callable, Sequence

from mirrormount.beam.loop_table import Eye
from mirrormount.common.errors import MountError, MoveEnded
from mirrormount.device.axis import Axis
from mirrormount.device.mount import Mount
from mountfw import codes as wire


class DirectActuator:
    """One axis of a mount. name: such as "first.x"."""

    def __init__(self, name: str, mount: Mount, axis: Axis) -> None:
        self.name = name
        self.board_id = mount.board_id
        self._mount = mount
        self._axis = axis
        self._begun = False

    @property
    def step_us(self) -> int:
        """The length of one step's pulse, as the board has it now."""
        return self._axis.ask_whole("XP?")[0]

    def pulse(self, us: int) -> None:
        """As Actuator.pulse()."""
        self._axis.pulse(us, wait=False, feed=False)
        self._begun = True

    def step(self, n: int) -> None:
        """As Actuator.step()."""
        self._axis.step(n, wait=False, feed=False)
        self._begun = True

    def is_moving(self) -> bool:
        """As Actuator.is_moving(): each question keeps the motion alive."""
        if not self._begun:
            return False
        if self._axis.status().moving:
            return True
        self._begun = False
        ended = self._axis.last_move()
        if ended.reason != wire.DONE:
            errors = self._mount.errors()
            codes = tuple(error.code for error in errors)
            raise MoveEnded(self.name, ended.reason, ended.steps, None, list(map(str, errors)), codes)
        return False

    def stop(self) -> None:
        """All motors of its board off, at once."""
        self._begun = False
        self._mount.halt()


class DirectTable:
    """Mounts and eyes with one clock. As LoopTable.

    mounts: by name, in the order of the beam. now_s, sleep: the table's clock; sleep() must let the boards' time pass.
    """

    def __init__(
        self,
        mounts: Sequence[tuple[str, Mount]],
        eyes: Sequence[Eye],
        now_s: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self._mounts = [mount for _, mount in mounts]
        self.actuators = [
            DirectActuator(f"{name}.{axis.name}", mount, axis) for name, mount in mounts for axis in (mount.x, mount.y)
        ]
        self.eyes = tuple(eyes)
        self._now_s = now_s
        self._sleep = sleep
        self.taken_over = ""

    def now_s(self) -> float:
        """The table's time."""
        return self._now_s()

    def sleep(self, seconds: float) -> None:
        """Let time pass. The loop asks what moves in between, which keeps it alive."""
        if seconds > 0:
            self._sleep(seconds)

    def stop(self) -> None:
        """As LoopTable.stop(): first every board is sent its stop, then each confirms it."""
        failures: list[MountError] = []
        for work in (Mount.halt, Mount.stop):
            for mount in self._mounts:
                try:
                    work(mount)
                except MountError as e:
                    failures.append(e)
        if failures:
            raise failures[-1]

    def take_control(self) -> None:
        """Nobody else can have it."""
