"""`Supervisor` and `Program`: one owner of a mount, many clients.

A Supervisor owns one mount for several programs of a process, with or without a panel. A Program is one of them: a
camera loop, a scan, a record of a control system. supervised() makes a Supervisor for each board of table.toml.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from types import TracebackType
from typing import Self, TypeVar

from mirrormount.device.axis import pulse_length
from mirrormount.device.mount import Mount
from mirrormount.device.status import Status
from mirrormount.device.table_file import MountEntry
from mirrormount.errors import BadValue
from mirrormount.supervise.connection import Address
from mirrormount.supervise.lease import Client, Lease
from mirrormount.supervise.motions import Motion
from mirrormount.supervise.requests import MOST_STEPS, GoTo, Home, Jog, MoveTo, Pulse, Steps
from mirrormount.supervise.worker import Worker
from mirrormount.values import (
    MOST_AMOUNT,
    PATIENCE_S,
    STEPS,
    axis_name,
    check,
    jog_duty,
    paired,
    real_number,
    whole_number,
)

T = TypeVar("T")


class Program(Client):
    """A client that asks from this process; Supervisor.join() makes it. Any thread may use it.

    It has control from take_control() to the next stop by anybody, to a person's claim, or to leave(). It must beat
    within the patience while it moves something: every request, every call of Motion.wait() and beat() does. A
    program that does not is taken for dead, and its motion is stopped. Beat in the loop that thinks, not in a thread
    of its own.

    lost(cause): called when control ends otherwise than by leave(); any thread, must return at once. patience_s: its
    own, None: the supervisor's.
    """

    def __init__(
        self,
        name: str,
        worker: Worker,
        lost: Callable[[str], object] | None = None,
        patience_s: float | None = None,
    ) -> None:
        super().__init__(name, patience_s=patience_s)
        self._worker = worker
        self._lost = lost
        worker.lease.join(self, self)

    def take_control(self) -> None:
        """Ask for control. Raises NotInControl if a person or another live program has it."""
        self.beat()
        self._worker.take_control(self)

    def ask_for_control(self) -> "Future[None]":
        """Ask the person who has control to hand it over; without such a person, take it. Control is the outcome.

        The question stands on the panel until it is answered, cancelled, or this program leaves. The future raises
        NotInControl if the person keeps control, and is cancelled by leave(). Raises NotInControl if another live
        program has control.
        """
        holder = self._worker.lease.holder
        if holder is not None and holder.is_person:
            return self._worker.lease.ask(self)
        self.take_control()
        outcome: Future[None] = Future()
        outcome.set_result(None)
        return outcome

    @property
    def in_control(self) -> bool:
        """True if a request would be carried out now."""
        return self._worker.lease.has_control(self)

    def beat(self) -> None:
        """Give a sign of life."""
        self._worker.lease.beat(self)

    def step(self, axis: str, n: int, *, by_sight: bool = False) -> Motion:
        """Move an axis ("x", "y") by n steps. by_sight: as Axis.step().

        Raises BadValue, NotInControl; the motion's outcome has the rest.
        """
        n = whole_number(n, MOST_STEPS, "steps")
        return self._ask(Steps(self._checked(axis), n, by_sight), n)

    def pulse(self, axis: str, us: int, *, by_sight: bool = False) -> Motion:
        """Give one pulse of |us| microseconds, 200 … 2 000 000, in the direction of its sign. Raises as step()."""
        return self._ask(Pulse(self._checked(axis), pulse_length(us), by_sight))

    def move_to(self, axis: str, position: float, unit: str = STEPS, *, parts: bool = False) -> Motion:
        """Move an axis to a position in one of values.UNITS; of an axis that moves, to the latest one.

        To the nearest whole step, and in steps the position is whole; with parts also between two steps, by a pulse of
        its own length, which makes the position an estimate. Raises as step().
        """
        if check(unit) == STEPS and not parts:
            return self._ask(GoTo(self._checked(axis), whole_number(position, MOST_STEPS, "position")))
        position = real_number(position, MOST_AMOUNT, f"a position in {unit}")
        return self._ask(MoveTo(self._checked(axis), position, unit, parts))

    def jog(self, axis: str, speed: float) -> Motion:
        """Run an axis at speed, -1 … 1 of full duty and not 0, until halt(), a stop, a limit, or no beat.

        Raises as step().
        """
        jog_duty(speed)
        return self._ask(Jog(self._checked(axis), speed))

    def home(self, axis: str) -> Motion:
        """Find an axis's home. Raises as step()."""
        return self._ask(Home(self._checked(axis)))

    def halt(self, axis: str) -> "Future[object]":
        """End the motion of one axis soon: a step that is nearly done is finished. Control stays.

        A motion that waits for the axis is dropped. Raises BadValue, NotInControl; the future has the rest.
        """
        self.beat()
        return self._worker.halt(self, self._checked(axis))

    def stop(self, *, keep_control: bool = False) -> None:
        """All motors off, now. With or without control; a program has to take it again afterwards.

        keep_control: a program that has control keeps it through this stop, unless somebody else stops as well.
        """
        kept = keep_control and self._worker.lease.count_own_stop(self)
        self._worker.stop(f"{self.name} asked for it", counted=kept)

    def call(self, work: Callable[[Mount], T], *, changes: bool = False) -> "Future[T]":
        """Run work(mount), which must neither wait nor move, between two polls: settings, zero.

        changes: it may change settings. Raises NotInControl; the future raises MountError.
        """
        self.beat()
        self._worker.lease.check(self)
        return self._worker.call(work, changes=changes)

    def leave(self) -> None:
        """End control; what this program moves is stopped."""
        if self._worker.lease.leave(self, self):
            self._worker.client_left(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.leave()

    def lost_control(self, cause: str) -> None:
        """As Client.lost_control()."""
        if self._lost:
            self._lost(cause)

    def _checked(self, axis: str) -> str:
        axes = self._worker.state.axes
        if axis not in axes:
            raise BadValue(f"an axis is {' or '.join(axes)}, not {axis!r}")
        return axis

    def _ask(self, request: "Steps | Pulse | GoTo | MoveTo | Jog | Home", wanted: int | None = None) -> Motion:
        self.beat()
        every_s = self._worker.lease.patience_of(self) / 3
        motion = Motion(request.axis, wanted, self.beat, every_s, jog=isinstance(request, Jog))
        self._worker.request(self, request, motion)
        return motion


class Supervisor:
    """Opens a mount, and carries out the requests of the client that has control. Use `with`.

    address: as Mount.open(); None: the only board that is plugged in; or what opens a port. patience_s: silence of a
    client after which its motion is stopped. A board that goes away is opened again when it is back; no motion is
    resumed.
    worker: for a server of its own, such as the panel.
    """

    def __init__(self, address: Address = None, *, patience_s: float = PATIENCE_S) -> None:
        self.worker = Worker(address, Lease(patience_s=patience_s))

    def open(self, *, absent: bool = False) -> Self:
        """Connect; motors that moved are stopped. Raises MountError if there is no mount at the address.

        absent: begin without it then; it is looked for every second, and status is None.
        """
        try:
            self.worker.open(absent=absent)
        except BaseException:
            self.worker.close()
            raise
        return self

    def close(self) -> None:
        """Motors off, port closed; outcomes that are awaited become ConnectionLost. Raises MountError."""
        self.worker.close()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def join(
        self, name: str, lost: Callable[[str], object] | None = None, *, patience_s: float | None = None
    ) -> Program:
        """A new client, without control. lost(cause): called when its control ends; must return at once.

        patience_s: its own, for one that feeds many mounts or a slow network; None: the supervisor's.
        """
        return Program(name, self.worker, lost, patience_s)

    @property
    def status(self) -> Status | None:
        """The last status, at most POLL_S old; None while it is not known."""
        return self.worker.state.status if self.worker.state.is_known else None

    def stop(self, cause: str = "the program asked for it") -> None:
        """All motors off, now; returns at once. Any thread, with or without control."""
        self.worker.stop(cause)

    def listen(self, listener: Callable[[Status | None], object]) -> None:
        """listener(status): called with each status, and with None when the board has gone.

        In the mount's thread, always before the outcome of a motion that has ended with it; it returns at once and
        raises nothing. Loss of control is told to the program that had it: join().
        """
        self.worker.listeners.append(listener)

    def ask(self, question: Callable[[Mount], T]) -> "Future[T]":
        """Run question(mount), which must neither wait nor move, between two polls. The future raises MountError."""
        return self.worker.call(question)


# ---- the mounts of table.toml

Supervised = tuple[Supervisor, tuple[str, str]]  # the names that its axes x and y have there


def supervised(entries: Mapping[str, MountEntry], patience_s: float) -> dict[str, Supervised]:
    """Supervisors, not open yet: one for each board, under the name of its first mount, which finds it on any port."""
    boards: dict[str, tuple[Supervisor, int]] = {}
    mounts: dict[str, Supervised] = {}
    for name, entry in entries.items():
        key = entry.board.upper() if entry.board else f"port {entry.port}"
        supervisor, x_axis = boards.setdefault(key, (Supervisor(name, patience_s=patience_s), entry.x_axis))
        axes = axis_name(entry.x_axis, x_axis), axis_name(paired(entry.x_axis), x_axis)
        mounts[name] = supervisor, axes
    return mounts
