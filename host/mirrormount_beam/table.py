"""The table of a loop: mounts that this program drives itself (LocalTable) or shares (SharedTable), and its cameras.

with Table.open() as table, table.loop("my loop") as loop:   # the table of table.toml: what align and hold need
    loop.take_control()
"""

import contextlib
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from functools import partial
from types import TracebackType
from typing import Any, Self

from mirrormount.device import table_file
from mirrormount.device.axis import Axis
from mirrormount.device.mount import Mount
from mirrormount.device.table_file import CameraEntry, CameraSettings
from mirrormount.errors import BadFile, MountError, MoveEnded, NoAnswer, NotCalibrated
from mirrormount.supervise.motions import Motion
from mirrormount.supervise.supervisor import Program, Supervised, Supervisor, supervised
from mirrormount.transport.link import Link
from mirrormount.values import PATIENCE_S
from mirrormount_beam import scale
from mirrormount_beam.camera import Camera, Image, Size
from mirrormount_beam.cameras import open_camera
from mirrormount_beam.errors import CameraError, CameraGone, CameraSizeChanged
from mirrormount_beam.live import LiveView
from mirrormount_beam.observe import Finder
from mirrormount_beam.spot.find import NoSpot, Spot, find_spot
from mountfw import codes as wire

_ANSWER_S = 3.0  # A supervisor answers a question within this time.
_BEAT_S = 0.1  # The time between two signs of life while a motor runs.
_OLD_S = 3.0  # The age of a picture that is no longer of now: a loop that corrects takes no image for about a second.


class TargetCamera:
    """A camera of a table under its name there, with its target, as a loop needs it.

    um_per_px: of x and y. distance_m: from the last mirror along the beam, None where it is not known. reopen: opens
    the camera again after it was unplugged; None for one that comes back by itself. view: what pages see, in which each
    image is shown that the loop has looked for a spot in.
    """

    def __init__(
        self,
        name: str,
        camera: Camera,
        target_px: tuple[float, float],
        um_per_px: tuple[float, float],
        distance_m: float | None,
        *,
        find: Finder = find_spot,
        reopen: Callable[[], Camera] | None = None,
    ) -> None:
        self.name = name
        self.camera = camera  # the one that is open now
        self.target_px = target_px
        self.um_per_px = um_per_px
        self.distance_m = distance_m
        self.size: Size = camera.size
        self.view = LiveView(name, _OLD_S, "the loop has looked at no picture")
        self._find = find
        self._reopen = reopen
        self._failed = False

    def monotonic(self) -> float:
        """The clock of Image.time_s, in seconds."""
        return self.camera.monotonic()

    def frames(self) -> Iterator[Image]:
        """As Camera.frames(); after CameraError it may be called again. Raises CameraError while there is none."""
        try:
            if self._failed and self._reopen:
                self.camera.close()
                self.camera = _opened_again(self.name, self._reopen)
            if self.camera.size != self.size:
                raise CameraSizeChanged(f"{self.name}: the camera came back with {self.camera.size}, not {self.size}")
            self._failed = False
            yield from self.camera.frames()
        except CameraError as e:
            self._failed = True
            self.view.fail(str(e))
            raise

    def find(self, frame: Image) -> Spot | NoSpot:
        """The spot in an image, or why there is none; pages see both."""
        found = self._find(frame)
        self.view.show(frame, found, self.monotonic() - frame.time_s)
        return found

    def close(self) -> None:
        """Release the camera."""
        self.camera.close()


def _opened_again(name: str, reopen: Callable[[], Camera]) -> Camera:
    """reopen(). Raises CameraError whatever stands in the way, such as a table.toml that somebody edits just now."""
    try:
        return reopen()
    except CameraError:
        raise
    except MountError as e:
        raise CameraGone(f"{name}: it is not opened again: {e}") from e


# ---- a table that this program drives itself


class LocalActuator:
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


class LocalTable:
    """Mounts and cameras of this program, in lockstep or in real time. now_s, sleep: of the table's clock.

    Each move is watched by its caller, who asks is_moving() until it is over: that feeds the board's keep-alive. A loop
    that dies or hangs stops asking, and the board switches its motors off within half a second.
    """

    taken_over = ""  # nobody else drives these mounts; a stop by another program ends a move, which trips an interlock
    lost_board = ""  # a motion tells it

    def __init__(
        self,
        mounts: Mapping[str, Mount],
        cameras: Sequence[TargetCamera],
        now_s: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self.actuators = [
            LocalActuator(name, mount, mount.axis(axis))
            for name, mount in mounts.items()
            for axis in in_order(mount.by_name)
        ]
        self.cameras = list(cameras)
        self.now_s = now_s
        self._sleep = sleep
        self._mounts = list(mounts.values())

    @classmethod
    def of_virtual(cls, table: Any, mounts: Mapping[str, Mount] | None = None) -> Self:
        """Of a virtual table. Each camera's target is the middle of its picture.

        mounts: those that are open already; None: all are opened, as first and second.
        """
        if mounts is None:
            mounts = {name: Mount(Link(port)) for name, port in zip(("first", "second"), table.ports, strict=False)}
        cameras = []
        for camera in table.cameras:
            middle, um = ((camera.size.width - 1) / 2, (camera.size.height - 1) / 2), 1000 * camera.scale.mm_per_px
            cameras.append(TargetCamera(camera.name, camera, middle, (um, um), camera.distance_m))
        return cls(mounts, cameras, table.now_s, table.sleep)

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


# ---- a table that is shared


class SharedActuator:
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


class SharedTable:
    """Mounts with supervisors, and cameras; time is that of this computer. As LoopTable. Use `with`.

    The loop is one client of each mount, beside a panel's pages and other programs: a person takes over at any moment,
    a stop is a stop, and a loop that hangs is stopped (docs/supervise.md).
    mounts: name, supervisor (open) and the names of its axes x and y, in the order of the beam; two mounts on one board
    have one supervisor. name: of the loop, as a person reads it on the panel.
    """

    def __init__(
        self,
        name: str,
        mounts: Sequence[tuple[str, Supervisor, tuple[str, str]]],
        cameras: Sequence[TargetCamera],
    ) -> None:
        self.cameras = tuple(cameras)
        self._changed = threading.Event()
        self._lost = self._lost_board = ""
        self._programs: dict[Supervisor, Program] = {}
        for _, supervisor, _ in mounts:
            if supervisor not in self._programs:
                self._programs[supervisor] = supervisor.join(name, partial(self._lose, supervisor))
        self.actuators = [
            SharedActuator(f"{mount}.{word}", self._programs[supervisor], supervisor, axis)
            for mount, supervisor, axes in mounts
            for word, axis in zip(("x", "y"), axes, strict=True)
        ]

    def __enter__(self) -> "SharedTable":
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


# ---- the table of table.toml


class Table:
    """An open table. supervisors: by the name of the mount; two mounts on one board share one. cameras: by name.

    Use open(), and close() or `with`.
    """

    def __init__(self, mounts: Mapping[str, Supervised], cameras: Mapping[str, TargetCamera]) -> None:
        self.supervisors = {name: supervisor for name, (supervisor, _) in mounts.items()}
        self.axes = {name: axes for name, (_, axes) in mounts.items()}
        self.cameras = dict(cameras)
        self._closing = contextlib.ExitStack()

    @classmethod
    def open(
        cls,
        patience_s: float = PATIENCE_S,
        settings: CameraSettings = CameraSettings(),  # noqa: B008
        *,
        with_cameras: bool = True,
    ) -> Self:
        """Open all mounts and cameras of the table's file; motors that moved are stopped.

        patience_s: silence of a loop after which what it moves is stopped. settings: of all cameras, before what the
        file says of each. with_cameras: for a loop that sees no spots, False.
        Raises BadFile if it names none, NotCalibrated for a camera without a scale, CameraError, and as Mount.open().
        """
        table = table_file.read()
        wanted = table.cameras if with_cameras else {}
        needed = {"mount": table.mounts} | ({"camera": wanted} if with_cameras else {})
        for what, entries in needed.items():
            if not entries:
                raise BadFile(f"{table_file.path()} names no {what}: `mirrormount table {what} NAME` gives it a name")
        with contextlib.ExitStack() as opened:
            cameras = {}
            for name, entry in wanted.items():
                cameras[name] = _target_camera(name, entry, settings)
                opened.callback(cameras[name].close)
            mounts = supervised(table.mounts, patience_s)
            for supervisor in dict.fromkeys(supervisor for supervisor, _ in mounts.values()):
                opened.enter_context(supervisor)
            made = cls(mounts, cameras)
            made._closing = opened.pop_all()
            return made

    def loop(self, name: str) -> SharedTable:
        """A client of all mounts under a name that people read."""
        mounts = [(mount, supervisor, self.axes[mount]) for mount, supervisor in self.supervisors.items()]
        return SharedTable(name, mounts, tuple(self.cameras.values()))

    def stop(self, cause: str = "the program asked for it") -> None:
        """All motors of all mounts off, now; returns at once. Any thread."""
        for supervisor in dict.fromkeys(self.supervisors.values()):
            supervisor.stop(cause)

    def close(self) -> None:
        """Motors off, ports and cameras closed. Raises MountError if motors did not stop."""
        self._closing.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _target_camera(name: str, entry: CameraEntry, settings: CameraSettings) -> TargetCamera:
    reopen = partial(open_camera, entry.camera, settings=settings.over(entry.settings))
    camera = reopen()
    try:
        mm_per_px = scale.read(camera).mm_per_px
    except NotCalibrated as e:
        camera.close()
        raise NotCalibrated(f"{name}: {e}; errors are told in um, so it is needed: `mirrormount camera scale`") from e
    except BaseException:
        camera.close()
        raise
    middle = (camera.size.width - 1) / 2, (camera.size.height - 1) / 2
    um = 1000 * mm_per_px
    distance_m = None if entry.distance_mm is None else entry.distance_mm / 1000
    return TargetCamera(name, camera, entry.target_px or middle, (um, um), distance_m, reopen=reopen)
