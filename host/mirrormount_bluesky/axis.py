"""One axis of a supervised mount, as Bluesky moves and reads it."""

import asyncio
import contextlib
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from bluesky.protocols import Location
from ophyd_async.core import (
    DEFAULT_TIMEOUT,
    DeviceMock,
    MovableLogic,
    NotConnectedError,
    StandardMovable,
    StandardReadable,
    StandardReadableFormat,
    TimeoutCalculator,
    soft_signal_r_and_setter,
    soft_signal_rw,
)

from mirrormount.device.status import Status
from mirrormount.errors import BadValue, NotInControl
from mirrormount.supervise import Program, Supervisor
from mirrormount.values import PATIENCE_S, STEPS

_BEAT_S = PATIENCE_S / 3


@dataclass
class AxisLogic(MovableLogic[float]):
    """How the axis moves. Its moves are awaited, and its signs of life given, by the loop that runs the plan."""

    program: Program
    axis: str
    under_way: bool = False

    async def stop(self) -> None:
        """End the motion of this axis. Without control there is none of ours: whoever ended it has stopped it."""
        with contextlib.suppress(NotInControl):
            self.program.halt(self.axis)

    async def check_move(self, new_position: float) -> None:
        """Raises BadValue for what is no finite number. The board checks its limits."""
        if not math.isfinite(new_position):
            raise BadValue(f"a position is a finite number, not {new_position}")

    async def move(self, new_position: float, timeout: TimeoutCalculator) -> None:
        """Go to the nearest whole step. Raises MountError, TimeoutError; the motion is ended then."""
        loop, over = asyncio.get_running_loop(), asyncio.Event()
        async with asyncio.timeout(timeout()):
            motion = self.program.move_to(self.axis, round(new_position))
            self.under_way = True
            motion.future.add_done_callback(lambda _: loop.call_soon_threadsafe(over.set))
            try:
                await self.setpoint.set(new_position)
                while not over.is_set():
                    self.program.beat()
                    with contextlib.suppress(TimeoutError):
                        await asyncio.wait_for(over.wait(), _BEAT_S)
            except BaseException:
                await self.stop()
                raise
            finally:
                self.under_way = False
        motion.future.result()


class MountAxis(StandardReadable, StandardMovable[float]):
    """An axis in steps. program: needs control (take_control()), and again after each stop by anybody else.

    Readings: the position under the device's own name, nan while the board is not there, and its certainty.
    """

    def __init__(self, supervisor: Supervisor, program: Program, axis: str, name: str = "") -> None:
        self._supervisor, self._program, self._axis = supervisor, program, axis
        self._loop: asyncio.AbstractEventLoop | None = None
        self._there = asyncio.Event()
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.readback, self._set_readback = soft_signal_r_and_setter(float, math.nan, units=STEPS, precision=3)
        with self.add_children_as_readables():
            self.certainty, self._set_certainty = soft_signal_r_and_setter(str, "unknown")
        self.setpoint = soft_signal_rw(float, math.nan, units=STEPS, precision=3)
        super().__init__(name)

    @cached_property
    def movable_logic(self) -> AxisLogic:
        """What StandardMovable moves it by."""
        return AxisLogic(self.setpoint, self.readback, self._program, self._axis)

    async def connect(
        self, mock: bool | DeviceMock[Any] = False, timeout: float = DEFAULT_TIMEOUT, force_reconnect: bool = False
    ) -> None:
        """Follow the mount's status from now on. Raises NotConnectedError if the board is not there."""
        await super().connect(mock=mock, timeout=timeout, force_reconnect=force_reconnect)
        if mock:
            return
        if self._loop is None:
            self._loop = asyncio.get_running_loop()
            self._supervisor.listen(self._on_status)
        try:
            await asyncio.wait_for(self._there.wait(), timeout)
        except TimeoutError:
            raise NotConnectedError(f"{self._axis}: the mount tells no position") from None

    async def locate(self) -> Location[float]:
        """The target and the place. At rest they are the same: somebody else may have moved it since."""
        located = await super().locate()
        if not self.movable_logic.under_way:
            located["setpoint"] = located["readback"]
        return located

    def _on_status(self, status: Status | None) -> None:
        """In the mount's thread, before the outcome of a motion: so the readback is true when a move completes."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody reads any more
                self._loop.call_soon_threadsafe(self._show, status)

    def _show(self, status: Status | None) -> None:
        axis = status.by_name[self._axis] if status else None
        self._set_readback(axis.position if axis else math.nan)
        self._set_certainty(axis.certainty if axis else "unknown")
        if axis:
            self._there.set()
