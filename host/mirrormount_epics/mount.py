"""A supervised board with its axes as motor records, and a mount record for each pair of axes.

Control is taken at the start, and later only by a put of Go to .SPMG: after a stop by anybody else no client of EPICS
moves a motor before that.
"""

import contextlib
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from functools import partial
from typing import Any

from mirrormount.device import settings
from mirrormount.device.status import AxisStatus, Ended, Status
from mirrormount.errors import MountError, MoveEnded
from mirrormount.supervise import Motion, Program, Supervisor
from mirrormount.supervise.worker import Settings
from mirrormount_epics.autosave import Saved
from mirrormount_epics.base import Record
from mirrormount_epics.motor import COMM, INVALID, NO_ALARM, Axis, Motor, Setup
from mirrormount_epics.pump import Pump
from mountfw import codes as wire

_CHECKED = 8  # the bit of `checking` for soft limits
_CERTAINTY: list[str] = list(wire.CERTAINTY)


class MountRecord:
    """The record of a mount."""

    def __init__(self, record: Record) -> None:
        self.record = record
        self.board: Board | None = None

    def before(self, field: str) -> None:
        """Nothing to keep."""

    def put(self, field: str) -> bool:
        """A 1 to .STOP stops the board."""
        if field == "STOP" and self.record["STOP"]:
            self.record["STOP"] = 0
            if self.board is None:
                return False
            self.board.stop()
        return True

    def process(self) -> None:
        """Nothing is under way in this record."""
        connected = self.board is not None and self.board.connected
        self.record.settle(*((NO_ALARM, 0) if connected else (COMM, INVALID)))
        self.record.done()


class BoardAxis:
    """One axis of a board, as its motor sees it: motor.py's Drive."""

    def __init__(self, board: "Board", name: str, motor: Motor, record: Record) -> None:
        self.name = name
        self.motor = motor
        self.record = record
        self._board = board

    @property
    def connected(self) -> bool:
        """Is the board there?"""
        return self._board.connected

    @property
    def in_control(self) -> bool:
        """Would an order be carried out?"""
        return self._board.program.in_control

    def take_control(self) -> None:
        """Raises NotInControl."""
        self._board.program.take_control()

    def move_to(self, steps: int) -> object:
        """Go to a position. Raises MountError."""
        return self._awaited(self._board.program.move_to(self.name, steps))

    def jog(self, way: int) -> object:
        """Run at the board's run duty. Raises MountError."""
        duty = self._board.settings[self.name]["run_duty"]
        return self._awaited(self._board.program.jog(self.name, way * duty / 255))

    def home(self) -> object:
        """Find the home. Raises MountError."""
        return self._awaited(self._board.program.home(self.name))

    def define(self, steps: int) -> object:
        """The present position is this one. Raises MountError."""
        future = self._board.program.call(lambda mount: (mount.axis(self.name).zero(steps), mount.status())[1])
        future.add_done_callback(lambda done: self._board.pump.put(lambda: self._defined(future, done)))
        return future

    def halt(self) -> None:
        """End what is under way. Without control, all of the board stops."""
        try:
            self._board.program.halt(self.name)
        except MountError:
            self._board.program.stop()

    def limit(self, low: int, high: int) -> None:
        """Set the soft limits. Raises MountError."""
        checking = int(self._board.settings[self.name]["checking"])
        self._apply({"soft_minimum": low, "soft_maximum": high, "checking": checking | _CHECKED})

    def velocity(self, steps_per_s: float) -> None:
        """Set the velocity; the board takes hundredths. Raises MountError."""
        self._apply({"velocity": round(steps_per_s, 2)})

    def _apply(self, wanted: dict[str, Any]) -> None:
        now = self._board.settings[self.name]
        wanted = {self.name: {name: value for name, value in wanted.items() if now[name] != value}}
        settings.check(wanted)
        settings.check_together({self.name: now}, wanted)
        future = self._board.program.call(lambda mount: mount.apply(wanted), changes=True)
        self._board.applying += 1
        future.add_done_callback(lambda done: self._board.pump.put(lambda: self._applied(done)))

    def _applied(self, done: "Future[None]") -> None:
        self._board.applying -= 1
        error = _error_of(done)
        if error:
            with self.record:
                self.motor.fault(str(error))
        self._board.read_settings()

    def _awaited(self, motion: Motion) -> Motion:
        motion.future.add_done_callback(lambda done: self._board.pump.put(lambda: self._ended(motion, done)))
        return motion

    def _ended(self, motion: Motion, done: "Future[Ended]") -> None:
        error = _error_of(done)
        reason = error.reason if isinstance(error, MoveEnded) else 0 if error else done.result().reason
        with self.record:
            self.motor.ended(motion, reason, str(error or ""))

    def _defined(self, token: object, done: "Future[Status]") -> None:
        error = _error_of(done)
        with self.record:
            if not error:
                self.motor.show(axis_of(done.result().by_name[self.name]))
            self.motor.ended(token, 0 if error else wire.DONE, str(error or ""))


def _error_of(done: "Future[Any]") -> BaseException | None:
    try:
        return done.exception()
    except CancelledError as e:
        return e


class Board:
    """One supervised board. axes: its motors, by the board's names. records: of its mounts.

    For the pump's thread, but for stop() and what clients of EPICS do through a BoardAxis.
    """

    def __init__(
        self, supervisor: Supervisor, pump: Pump, records: list[MountRecord], motors: Mapping[str, tuple[Motor, Record]]
    ) -> None:
        self.supervisor = supervisor
        self.pump = pump
        self.records = records
        self.axes = {name: BoardAxis(self, name, *motor) for name, motor in motors.items()}
        self.connected = False
        self.settings: Settings = {}
        self.applying = 0  # settings that are on their way to the board
        self.id = ""
        self._known: tuple[Settings, object] | None = None  # the settings and scales that the records show
        self._latest: Status | None = None
        self._told = self._gone = self._arriving = False
        self.program: Program = supervisor.join("EPICS", self._on_loss)
        for record in records:
            record.board = self
        pump.often.append(self._beat)
        pump.seldom.append(self.read_settings)
        supervisor.listen(self._on_status)
        with contextlib.suppress(MountError):  # a page has control: .SPMG says so when the board has come
            self.program.take_control()

    def stop(self) -> None:
        """All motors off, now. The control that EPICS has stays. Any thread."""
        self.program.stop(keep_control=True)
        self.pump.put(self._stopped)

    # ---- from other threads

    def _on_status(self, status: Status | None) -> None:
        """However late the pump is, one event waits."""
        self._latest = status
        self._gone = self._gone or status is None
        if not self._told:
            self._told = True
            self.pump.put(self._show)

    def _on_loss(self, cause: str) -> None:
        self.pump.put(lambda: self._lost(cause))

    # ---- the pump's thread

    def _beat(self) -> None:
        if self.program.in_control:
            self.program.beat()

    def _show(self) -> None:
        self._told = False
        if self._gone:
            self._gone = False
            self._leave()
        status = self._latest
        if status is None:
            return
        if not self.connected:
            self._arrive()
            return
        for name, axis in self.axes.items():
            with axis.record:
                axis.motor.show(axis_of(status.by_name[name]))

    def _arrive(self) -> None:
        """A board has come: ask what has to be known of it before clients may use it."""
        if self._arriving:
            return
        self._arriving = True
        asked = self.supervisor.ask(lambda mount: (mount.settings(), mount.board_id, mount.identity, mount.status()))
        asked.add_done_callback(lambda done: self.pump.put(lambda: self._arrived(done)))

    def _arrived(self, done: "Future[Any]") -> None:
        self._arriving = False
        if _error_of(done):
            return  # the next status asks again
        self.settings, self.id, identity, status = done.result()
        self.connected = True
        self._known = self.settings, dict(self.supervisor.worker.state.scales)
        saved = Saved(self.id)
        for name, axis in self.axes.items():
            with axis.record:
                axis.motor.attach(axis, axis_of(status.by_name[name]), self._setup(name))
                saved.restore(name, axis.record, axis.motor)
                if not self.program.in_control:
                    axis.motor.lost()
        self._tell("", CONN=1, VAL=1, IDN=identity)

    def _leave(self) -> None:
        self.connected = False
        for axis in self.axes.values():
            with axis.record:
                axis.motor.lost()
                axis.motor.connected()
        self._tell(self.supervisor.worker.gone or "the board has gone", CONN=0, VAL=0)

    def _lost(self, cause: str) -> None:
        self._tell(cause)
        for axis in self.axes.values():
            with axis.record:
                axis.motor.lost()

    def _stopped(self) -> None:
        self._tell("stopped: a client of EPICS asked for it")
        for axis in self.axes.values():
            with axis.record:
                axis.motor.stopped()

    def _tell(self, message: str, **values: Any) -> None:
        for mount in self.records:
            with mount.record:
                mount.record.update(MSG=message, **values)
                mount.process()

    # ---- settings

    def read_settings(self) -> None:
        """Look whether they have changed, by whomever."""
        if self.connected:
            self.supervisor.worker.settings().add_done_callback(
                lambda done: self.pump.put(partial(self._configure, done))
            )

    def _configure(self, done: "Future[Settings]") -> None:
        if _error_of(done) or not self.connected or self.applying:
            return
        known = done.result(), dict(self.supervisor.worker.state.scales)
        if known != self._known:
            self._known = known
            self.settings = known[0]
            for name, axis in self.axes.items():
                with axis.record:
                    axis.motor.configure(self._setup(name))

    def _setup(self, name: str) -> Setup:
        own = self.settings[name]
        scale = self.supervisor.worker.state.scales.get(name)
        checked = int(own["checking"]) & _CHECKED
        limits = {"low": int(own["soft_minimum"]), "high": int(own["soft_maximum"])} if checked else {}
        fastest = 100_000_000 // (own["pulse_us"] + 1000) / 100  # as the board limits it (docs/protocol.md, VA)
        unit: dict[str, Any] = {} if scale is None else {"egu": "mrad", "per_step": scale.mirror_mrad}
        return Setup(
            velocity=min(own["velocity"], fastest),
            fastest=fastest,
            take_up_s=own["take_up_us"] * 1e-6,
            **limits,
            **unit,
        )


def axis_of(status: AxisStatus) -> Axis:
    """The state of an axis as a motor takes it."""
    certainty = _CERTAINTY.index(status.certainty)
    return Axis(status.position, status.moving, status.direction, status.limits, status.reason, certainty)


def saver(boards: list[Board]) -> Callable[[], None]:
    """What writes down, now and then, what a person has set on the records."""

    def save() -> None:
        for board in boards:
            if board.connected:
                Saved(board.id).keep({name: (axis.record, axis.motor) for name, axis in board.axes.items()})

    return save
