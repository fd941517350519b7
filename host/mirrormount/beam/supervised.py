"""A table whose mounts have supervisors: the loop is one client of each, beside a panel's pages and other programs.

A person takes over at any moment, a stop is a stop, and a loop that hangs is stopped (docs/supervise.md).
"""

import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from functools import partial
from typing import Any

from mirrormount.beam.loop_table import Eye
from mirrormount.common.errors import MountError, NoAnswer
from mirrormount.device.mount import Mount
from mirrormount.supervise import Motion, Program, Supervisor

_ANSWER_S = 3.0  # of a supervisor to a question
_BEAT_S = 0.1  # between two signs of life while something moves


class SupervisedActuator:
    """One axis of a supervised mount. name: such as "first.x"."""

    def __init__(self, name: str, program: Program, supervisor: Supervisor, axis: str) -> None:
        self.name = name
        self._program = program
        self._supervisor = supervisor
        self._axis = axis
        self._motion: Motion | None = None

    @property
    def board_id(self) -> str:
        """Of the board that is there now."""
        return answer(self._supervisor.ask(lambda mount: mount.board_id))

    @property
    def step_us(self) -> int:
        """The length of one step's pulse, as the board has it now."""
        return answer(self._supervisor.ask(lambda mount: mount.axis(self._axis).ask_whole("XP?")[0]))

    def pulse(self, us: int) -> None:
        """As Actuator.pulse()."""
        self._motion = self._program.pulse(self._axis, us, by_sight=True)

    def step(self, n: int) -> None:
        """As Actuator.step()."""
        self._motion = self._program.step(self._axis, n, by_sight=True)

    def is_moving(self) -> bool:
        """As Actuator.is_moving(): each question is a sign of life."""
        motion = self._motion
        if motion is None:
            return False
        self._program.beat()
        if not motion.done:
            return True
        self._motion = None
        motion.future.result()
        return False

    def stop(self) -> None:
        """All motors of its board off, at once. Control stays."""
        self._motion = None
        self._program.stop(keep_control=True)


class SupervisedTable:
    """Mounts and eyes; time is that of this computer. As LoopTable. Use `with`.

    mounts: name, supervisor (open) and the names of its axes x and y, in the order of the beam; two mounts on one board
    have one supervisor. name: of the loop, as a person reads it on the panel.
    """

    def __init__(
        self,
        name: str,
        mounts: Sequence[tuple[str, Supervisor, tuple[str, str]]],
        eyes: Sequence[Eye],
    ) -> None:
        self.eyes = tuple(eyes)
        self._changed = threading.Event()
        self._lost = self._lost_board = ""
        self._programs: dict[Supervisor, Program] = {}
        for _, supervisor, _ in mounts:
            if supervisor not in self._programs:
                self._programs[supervisor] = supervisor.join(name, partial(self._lose, supervisor))
        self.actuators = [
            SupervisedActuator(f"{mount}.{word}", self._programs[supervisor], supervisor, axis)
            for mount, supervisor, axes in mounts
            for word, axis in zip(("x", "y"), axes, strict=True)
        ]

    def __enter__(self) -> "SupervisedTable":
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()

    def leave(self) -> None:
        """End control of all mounts; what moves is stopped. The supervisors stay open."""
        for program in self._programs.values():
            program.leave()

    def _lose(self, of: Supervisor, cause: str) -> None:
        """Control of one mount has ended: the others stand still, too. The one is somebody else's now."""
        if self._lost:
            return
        self._lost = cause
        if of.worker.gone:
            self._lost_board = cause
        self._changed.set()
        for supervisor, program in self._programs.items():
            if supervisor is not of:
                program.stop()

    def now_s(self) -> float:
        """This computer's clock."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let time pass, with signs of life. It ends early when control is lost."""
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0 and not self._changed.wait(min(left_s, _BEAT_S)):
            for program in self._programs.values():
                program.beat()

    def stop(self) -> None:
        """As LoopTable.stop(). Control stays with the loop, unless somebody else has it."""
        for program in self._programs.values():
            program.stop(keep_control=True)
        asked = [supervisor.ask(Mount.stop) for supervisor in self._programs]  # confirms it
        failures: list[MountError] = []
        for future in asked:
            try:
                answer(future)
            except MountError as e:
                failures.append(e)
        if failures:
            raise failures[-1]

    @property
    def taken_over(self) -> str:
        """As LoopTable.taken_over."""
        if self._lost:
            return self._lost
        for supervisor, program in self._programs.items():
            if not program.in_control:
                return f"stopped: {supervisor.worker.stop_cause or 'control was not taken yet'}"
        return ""

    @property
    def lost_board(self) -> str:
        """As LoopTable.lost_board."""
        return self._lost_board or next((each.worker.gone for each in self._programs if each.worker.gone), "")

    def take_control(self) -> None:
        """As LoopTable.take_control(): of all mounts, or of none."""
        for asked in [supervisor.ask(lambda mount: mount.board_id) for supervisor in self._programs]:
            answer(asked)
        taken: list[Program] = []
        try:
            for program in self._programs.values():
                program.take_control()
                taken.append(program)
        except MountError:
            for program in taken:
                program.stop()  # which ends its control
            raise
        self._lost = self._lost_board = ""
        self._changed.clear()


def answer(future: "Future[Any]") -> Any:
    """The outcome of a question to a supervisor. Raises what it raises, NoAnswer."""
    try:
        return future.result(_ANSWER_S)
    except TimeoutError as e:
        raise NoAnswer(f"the board did not answer within {_ANSWER_S:g} s") from e
