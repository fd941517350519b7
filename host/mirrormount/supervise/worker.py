"""The one thread that uses the mount, the brake beside it, and the direction buttons.

Clients of the lease ask from any thread; their requests wait in a queue (Tasks) for the worker's thread, those of
programs in a Mailbox with one place for each axis. The worker polls the board's status twenty times a second, or fifty
while it moves, and each poll feeds the board's keep-alive. It polls on only while the client that asked for the motion
is alive; if that client has gone, hangs or is cut off, it stops the mount. If this thread or its whole program hangs,
the board stops by its own keep-alive.

A stop has a thread of its own (Brake) and waits for no other use of the mount. No request from before a stop is begun
after it, waiting presses included.

A press of a direction button is a step; a button that is held longer runs until it is released. Presses has the buttons
that are down or wait for their turn, and knows no mount; Pad moves the mount by them.
"""

import contextlib
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TypeVar

from mirrormount.device.mount import Mount
from mirrormount.device.settings import Settings
from mirrormount.device.status import Status
from mirrormount.errors import (
    BoardError,
    ConnectionLost,
    MountError,
    MoveEnded,
    NoAnswer,
    NotInControl,
    NotStoppable,
    SupervisorFault,
)
from mirrormount.supervise.connection import MOVING_POLL_S, POLL_S, Address, Connection, State
from mirrormount.supervise.lease import Client, Lease
from mirrormount.supervise.log import Notices, ToNotices, WireLog
from mirrormount.supervise.motions import REPLACING, Asked, Motion, Motions, start
from mirrormount.supervise.requests import FULL, Press, Request
from mountfw import codes as wire

T = TypeVar("T")


def _ignore(_why: MountError) -> None:
    """The outcome is not awaited."""


# ---- the queue


class Tasks:
    """Any thread adds tasks, one thread runs them in their order."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[Callable[[], None], Callable[[MountError], None]]] = queue.SimpleQueue()
        self._closed: MountError | None = None

    def add(self, run: Callable[[], None], fail: Callable[[MountError], None] = _ignore) -> None:
        """fail(why): called instead of run() if it cannot be run any more."""
        self._waiting.put((run, fail))
        if self._closed:
            self.close(self._closed)

    def ask(self, connection: Connection, work: Callable[[Mount], T], then: Callable[[Mount], None]) -> "Future[T]":
        """Run work(mount), then then(mount). The future raises MountError, also if another board has come meanwhile."""
        future: Future[T] = Future()
        asked = connection.mount

        def run() -> None:
            if not future.set_running_or_notify_cancel():
                return
            mount = connection.mount
            if mount is None or mount is not asked:
                why = connection.trouble or "the board had gone meanwhile"
                future.set_exception(ConnectionLost(f"nothing was done: {why}"))
                return
            try:
                result = work(mount)
                then(mount)
                future.set_result(result)
            except (ConnectionLost, NoAnswer) as e:
                future.set_exception(e)
                raise
            except Exception as e:
                future.set_exception(e)

        def fail(why: MountError) -> None:
            if future.set_running_or_notify_cancel():
                future.set_exception(why)

        self.add(run, fail)
        return future

    def run_next(self, timeout_s: float) -> None:
        """Wait for a task for at most timeout_s, and run it. Raises what it raises."""
        with contextlib.suppress(queue.Empty):
            run, _ = self._waiting.get(timeout=timeout_s)
            run()

    def close(self, why: MountError) -> None:
        """Run no more: those that wait, and all that are added later, fail."""
        self._closed = why  # set before the queue is emptied, so that add() sees it and empties the queue again
        with contextlib.suppress(queue.Empty):
            while True:
                self._waiting.get_nowait()[1](why)


class Mailbox:
    """The latest order of programs for each axis: a motion, and a halt before it. Any thread posts, one takes.

    A flood of orders waits as one: the latest motion wins. A halt drops the motion that waits, and is never lost.
    wake(): called when something has come into the box since deliver() began.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._lock = threading.Lock()
        self._woken = False
        self._motions: dict[str, Asked] = {}
        self._halts: dict[str, Future[object]] = {}

    def post(self, axis: str, asked: Asked) -> None:
        """A motion; the one that waits is superseded."""
        with self._lock:
            before = self._motions.pop(axis, None)
            self._motions[axis] = asked
        if before:
            before.end(wire.SUPERSEDED)
        self._call()

    def follow(self, axis: str, rest: Asked) -> None:
        """The rest of a motion, which any order that waits supersedes."""
        with self._lock:
            first = axis not in self._halts and self._motions.setdefault(axis, rest) is rest
        if not first:
            rest.end(wire.SUPERSEDED)
        self._call()

    def halt(self, axis: str) -> "Future[object]":
        """End what moves, and begin nothing that waits. Halts that wait are one."""
        with self._lock:
            before = self._motions.pop(axis, None)
            halted = self._halts.setdefault(axis, Future())
        if before:
            before.end(wire.STOPPED)
        self._call()
        return halted

    def open(self) -> list[str]:
        """The axes that have orders. What is posted from here on wakes again."""
        with self._lock:
            self._woken = False
            return [*self._halts, *(axis for axis in self._motions if axis not in self._halts)]

    def waiting(self, axis: str) -> Asked | None:
        """The motion that waits."""
        return self._motions.get(axis)

    def take(self, axis: str) -> Asked | None:
        """The motion that waits, which is the taker's now."""
        with self._lock:
            return self._motions.pop(axis, None)

    def take_halt(self, axis: str) -> "Future[object] | None":
        """The halt that waits, which is the taker's now."""
        with self._lock:
            halt = self._halts.pop(axis, None)
        return halt if halt and halt.set_running_or_notify_cancel() else None

    def fail(self, why: MountError) -> None:
        """Refuse all that waits."""
        for axis in self.open():
            if halt := self.take_halt(axis):
                halt.set_exception(why)
            if asked := self.take(axis):
                asked.refuse(why)

    def _call(self) -> None:
        with self._lock:
            woken, self._woken = self._woken, True
        if not woken:
            self._wake()  # without the lock: after close() it fails at once, and empties the box


_log = logging.getLogger("mirrormount.supervise")


# ---- stops


class Brake:
    """Stops the mount that mount() returns; None: there is none."""

    def __init__(self, mount: Callable[[], Mount | None]) -> None:
        self._mount = mount
        # A signal handler may put into this queue, for it is reentrant, unlike Event.set().
        self._asked: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._closing = False
        self._thread = threading.Thread(target=self._send_stops, name="brake", daemon=True)

    def start(self) -> None:
        """Begin to send stops."""
        self._thread.start()

    def pull(self) -> None:
        """Send a stop; returns at once. Any thread, and a signal handler."""
        self._asked.put(None)

    def close(self) -> None:
        """End the thread."""
        self._closing = True
        self._asked.put(None)
        if self._thread.is_alive():
            self._thread.join(5)

    def _send_stops(self) -> None:
        while not self._closing:
            self._asked.get()
            with contextlib.suppress(queue.Empty):  # One halt serves all stops that were asked for before it.
                while True:
                    self._asked.get_nowait()
            mount = self._mount()
            if mount:
                try:
                    mount.halt()
                except Exception:  # the worker's next poll finds the cause
                    _log.warning("a stop could not be sent", exc_info=True)


# ---- direction buttons

HOLD_S = 0.7  # A button that is held longer than this runs; one that is released before makes only its step.
MOST = 10  # presses that may wait


@dataclass(eq=False)
class Hold:
    """A button that is down, or was."""

    client: Client
    press: Press
    stops: int  # how many stops were requested before it; after one more the press is not begun
    ready_s: float  # when it could have begun: when it went down, or when the presses before it were done
    begun_s: float | None = None  # when its step began; None while it waits, or if it was refused
    running: bool = False
    released: bool = False

    def is_run(self, now_s: float) -> bool:
        """True if it was held for long enough to run."""
        return self.begun_s is not None and now_s - self.begun_s >= HOLD_S


class Presses:
    """current: the press that steps, runs or was last. One thread begins presses, any thread adds and drops them."""

    def __init__(self) -> None:
        self.current: Hold | None = None
        self._waiting: deque[Hold] = deque()

    def __len__(self) -> int:
        """Number of presses that wait."""
        return len(self._waiting)

    @property
    def full(self) -> bool:
        """True if no more may wait."""
        return len(self._waiting) >= MOST

    @property
    def last(self) -> Hold | None:
        """The press that was added last."""
        try:
            return self._waiting[-1]
        except IndexError:
            return self.current

    def add(self, hold: Hold) -> None:
        """Append a press."""
        self._waiting.append(hold)

    def postpone(self, now_s: float) -> None:
        """Restart the time-out of presses that wait, while a step is running."""
        for hold in list(self._waiting):
            hold.ready_s = now_s

    def pop(self) -> Hold | None:
        """Take the next press; it becomes the current one."""
        if not self._waiting:
            return None
        try:
            # It becomes the current one before it leaves the queue, for release() must find it at any moment.
            self.current = hold = self._waiting[0]
            self._waiting.popleft()
        except IndexError:  # another thread has dropped all presses meanwhile
            self.drop()
            return None
        return hold

    def drop(self) -> None:
        """Drop those that wait, release the current one."""
        self._waiting.clear()
        if self.current:
            self.current.released = True

    def involve(self, client: Client) -> bool:
        """True if this client holds a button, or a press of it waits."""
        current = self.current
        return any(h.client is client for h in list(self._waiting)) or (
            current is not None and current.client is client and not current.released
        )


class Pad:
    """presses: those under way. Methods say which thread calls them. stop(cause): stops all motors."""

    def __init__(self, state: State, clock: Callable[[], float], stop: Callable[[str], None]) -> None:
        self.presses = Presses()
        self._state = state
        self._clock = clock
        self._stop = stop
        self._stepping = False  # by a press, and not seen to be over

    # ---- any thread

    def add(self, hold: Hold) -> bool:
        """A button has gone down. True if its press waits now; a refusal becomes a notice of its client."""
        last = self.presses.last
        if last and not last.released:
            return False  # one hand at a time
        if self.presses.full:
            waiting = len(self.presses)
            hold.client.notices.append(
                f"this press was not counted: {waiting} presses wait already; wait for them, or drop them by STOP"
            )
            return False
        self.presses.add(hold)
        return True

    def release(self, client: Client) -> bool:
        """The client's button is up. True if it ran: its run must be stopped."""
        hold = self.presses.last
        if not hold or hold.client is not client or hold.released:
            return False
        hold.released = True
        return hold.running or hold.is_run(self._clock())

    # ---- the mount's thread

    @property
    def held(self) -> Hold | None:
        """The button that is down."""
        hold = self.presses.current
        return hold if hold and not hold.released else None

    def pop(self) -> Hold | None:
        """The press that may begin now; None while the step of one before it is under way."""
        now_s, before = self._clock(), self.presses.current
        if self._stepping or (before and not before.released and before.begun_s is not None):
            self.presses.postpone(now_s)
            return None
        return self.presses.pop()

    def step(self, mount: Mount, hold: Hold) -> None:
        """Begin the steps of a press. Raises MountError."""
        for name, way in hold.press.ways.items():
            self._state.targets[name] = None
            try:
                mount.axis(name).step(way * hold.press.steps, wait=False, feed=False)
            except BoardError:
                if len(hold.press.ways) > 1:  # one axis of two
                    self._stop("one axis of a diagonal step was refused")
                raise
            self._state.began(name)
        self._stepping = True
        hold.begun_s = self._clock()

    def hold_to_run(self) -> Hold | None:
        """The button that has just been held for long enough to run."""
        hold = self.held
        if not hold or hold.running or not hold.is_run(self._clock()):
            return None
        hold.running = True  # set before it runs: a release from here on stops it
        return hold

    def run(self, mount: Mount, hold: Hold) -> None:
        """Begin the run of a button that is held. Raises MountError."""
        for name, way in hold.press.ways.items():
            if not hold.released:
                mount.axis(name).jog(way * hold.press.speed / FULL, feed=False)

    def report_errors(self, moving: bool) -> None:
        """The board has reported errors: no press goes on."""
        hold = self.held
        if hold and hold.running and moving:
            self._stop("the board reported an error in a run")  # drop() alone would lose the release
        self.presses.drop()

    def rest(self) -> bool:
        """Nothing moves. True if no button is down and no press waits."""
        self._stepping = False
        return not self.presses and self.held is None

    def reset(self) -> None:
        """After a stop: no step is under way."""
        self._stepping = False


# ---- the worker

_SOON_S = 0.01  # instead of POLL_S while a press waits for a step to end
LATE_S = 0.5  # A request that could not be begun within this time is refused.
_RETRY_S = 1.0  # between two attempts to open the port


class Worker:
    """Owns the mount. request() … call() may be called from any thread, and return at once.

    address: a port, or None for the only board. Attributes for any thread to read: connection, state, notices, log,
    driver (the client whose motion it is), stop_cause (of the last stop), gone (why the board is lost, "" while not).
    listeners: called in the mount's thread with each status, and with None when the board has gone; each returns at
    once and raises nothing. ways: ways for a stop beside the stop socket; each tells why it is shut, "" if it is open.
    """

    def __init__(self, address: Address, lease: Lease, clock: Callable[[], float] = time.monotonic) -> None:
        self.lease = lease
        self.log = WireLog()
        self.connection = Connection(
            address, self.log, lambda: self.stop("another program of this computer asked for it (mirrormount stop)")
        )
        self.state = State()
        self.stop_cause = self.gone = ""
        self.driver: Client | None = None
        self._unbegun: Asked | None = None  # in whose begin the board has gone: it is told after those who listen
        self.notices = Notices()
        self._clock = clock
        self._pad = Pad(self.state, clock, self.stop)
        self._tasks = Tasks()
        self._mail = Mailbox(lambda: self._tasks.add(self._deliver, self._refuse_mail))
        self._motions = Motions(clock, self._mail.follow)
        self._settings: tuple[Mount, Settings] | None = None  # as they were read, and of which mount
        self.listeners: list[Callable[[Status | None], object]] = []
        self.ways: list[Callable[[], str]] = []
        self._confirmed = 0  # stops after which the board was seen at rest
        self._brake = Brake(lambda: self.mount)
        self._to_notices = ToNotices(self.notices)
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)

    @property
    def presses(self) -> Presses:
        """The direction buttons that are down, and the presses that wait."""
        return self._pad.presses

    @property
    def mount(self) -> Mount | None:
        """None while there is no board."""
        return self.connection.mount

    def open(self, *, absent: bool = False) -> None:
        """Connect and begin. Raises MountError if there is no mount, unless absent: then it is looked for."""
        with contextlib.suppress(*[MountError] if absent else []):
            self._connect()
        logging.getLogger("mirrormount").addHandler(self._to_notices)
        self._thread.start()
        self._brake.start()

    def close(self) -> None:
        """Motors off, port closed. Raises MountError if the motors did not stop."""
        self._closing = True
        if self._thread.is_alive():
            self._thread.join(5)
        self._brake.close()
        logging.getLogger("mirrormount").removeHandler(self._to_notices)
        try:
            self.connection.close()
        finally:
            self._motions.fail(ConnectionLost("the motion was stopped: the supervisor was closed"))
            self._tasks.close(ConnectionLost("nothing was done: the supervisor was closed"))
            self._mail.fail(ConnectionLost("nothing was done: the supervisor was closed"))

    # ---- for clients: any thread

    def take_control(self, client: Client) -> None:
        """Give a client control; motion of the client before it is stopped. Raises NotInControl, as Lease.claim().

        A holder whose control a stop has ended is told first, also if it is this client: it must never go on as if
        nothing had happened.
        """
        self.lease.end_stopped(f"stopped: {self.stop_cause}")
        if self.lease.claim(client):
            self.stop(f"{client.name} took control", counted=True)

    def hand_over(self, person: Client, number: object) -> None:
        """Give control to the program that asked by that question. Raises NotInControl, as Lease.hand_over()."""
        question = self.lease.hand_over(person, number)
        self.stop(f"{person.name} handed control to {question.client.name}", counted=True)
        question.outcome.set_result(None)

    def request(self, client: Client, request: Request, motion: Motion | None = None, stops: int | None = None) -> None:
        """Carry out a request; a later refusal becomes the motion's outcome, or a notice of the client.

        A press during a step waits for its turn. A motion whose outcome is awaited replaces the one of its axis that
        waits, and if it is one of REPLACING, the one under way, too. stops: lease.stops when it was decided.
        Raises NotInControl.
        """
        asked = Asked(client, request, self.lease.stops if stops is None else stops, self._clock(), motion)
        self.lease.check(client)  # behind the count: control is claimed before the motion of its last holder is stopped
        if motion:
            self._mail.post(motion.axis, asked)
        elif not isinstance(request, Press):
            self._tasks.add(lambda: self._begin(asked), asked.refuse)
        elif self._pad.add(Hold(client, request, asked.stops, asked.at_s)):
            self._tasks.add(self._begin_next_press)

    def halt(self, client: Client, axis: str) -> "Future[object]":
        """End the motion of one axis, and drop what waits for it. Raises NotInControl; the future MountError."""
        self.lease.check(client)
        return self._mail.halt(axis)

    def release(self, client: Client) -> None:
        """The button is up: a run ends now; a step that was begun is made, and so is one that waits."""
        if self._pad.release(client):
            self.stop("the button was let go", tell=False)

    def stop(self, cause: str, *, tell: bool = True, counted: bool = False) -> None:
        """All motors off, now. cause: in a few words. counted: the lease has counted this stop.

        tell: add it to the notices; not from a signal handler, for that takes a lock.
        """
        self.stop_cause = cause
        mount = self.mount
        if mount and mount.session.motion_log:
            mount.session.motion_log.stopping(cause)
        if not counted:
            self.lease.stops += 1
        self._brake.pull()
        self.presses.drop()
        if tell:
            self.report(f"stopped: {cause}")

    def client_left(self, client: Client) -> None:
        """The client's connection has ended: its motion is stopped."""
        if self.driver is client or self.presses.involve(client):
            self.driver = None  # its silence is no second cause
            self.stop(self.lease.silence_of(client))

    def call(self, work: Callable[[Mount], T], *, changes: bool = False) -> "Future[T]":
        """Run work(mount) in the mount's thread. The future raises MountError; no notice is added.

        changes: it may change settings, and with them the size of a step.
        """

        def change(mount: Mount) -> T:
            try:
                return work(mount)
            finally:
                self._settings = None

        if changes:
            return self._tasks.ask(self.connection, change, self.state.read_scales)
        return self._tasks.ask(self.connection, work, lambda _: None)

    def settings(self) -> "Future[Settings]":
        """The board's settings, read once and again after a change. The future raises MountError."""

        def read(mount: Mount) -> Settings:
            known = self._settings
            if known is None or known[0] is not mount:  # else another client has asked for them meanwhile
                self._settings = known = mount, mount.settings()
            return known[1]

        known = self._settings
        if known is None or known[0] is not self.mount:
            return self.call(read)
        done: Future[Settings] = Future()
        done.set_result(known[1])
        return done

    def report(self, text: str, error: str = "") -> None:
        """Add a notice for all clients."""
        self.notices.add(text, error)

    # ---- the mount's thread

    def _run(self) -> None:
        while not self._closing:
            try:
                self._tasks.run_next(self._until_poll_s())
                if self.mount is None:
                    self._reconnect()
                if self.mount:
                    self._poll(self.mount)
            except MountError as e:
                self._lose(e)
            except Exception as e:  # a fault of this program: the motors are stopped in any case
                _log.exception("the worker has a fault")
                self._lose(SupervisorFault(f"this program has a fault ({type(e).__name__}: {e}); motors were stopped"))

    def _until_poll_s(self) -> float:
        if self.mount is None:
            return _RETRY_S
        if self.presses:
            return _SOON_S
        return MOVING_POLL_S if self.state.status and self.state.status.moving else POLL_S

    def _deliver(self) -> None:
        """Carry out the orders in the mailbox. One that replaces what is under way waits for the end of that."""
        for axis in self._mail.open():
            halt, asked = self._mail.take_halt(axis), self._mail.waiting(axis)
            replaces = asked is not None and isinstance(asked.request, REPLACING) and axis in self._motions
            first = replaces and self._motions.supersede(axis)
            if halt or first:
                self._halt(axis, halt)
            if asked and replaces:
                asked.at_s = self._clock()
            elif asked := self._mail.take(axis):
                self._begin(asked)

    def _halt(self, axis: str, halt: "Future[object] | None") -> None:
        """Let the board end the motion of one axis. Raises ConnectionLost, NoAnswer."""
        try:
            if self.mount is None:
                raise ConnectionLost(f"nothing was done: {self.connection.trouble}")
            self.mount.send(f"{self.mount.axis(axis).number}ST")
        except MountError as e:
            if halt:
                halt.set_exception(e)
            if self.mount and isinstance(e, ConnectionLost | NoAnswer):
                raise
        else:
            if halt:
                halt.set_result(None)

    def _refuse_mail(self, why: MountError) -> None:
        self._mail.fail(why)

    def _begin_next_press(self) -> None:
        hold = self._pad.pop()
        if hold:
            self._begin(Asked(hold.client, hold.press, hold.stops, hold.ready_s), hold)
            if hold.begun_s is None:  # refused: those behind it are not made either
                self.presses.drop()

    def _begin(self, asked: Asked, hold: Hold | None = None) -> None:
        """Start a motion, unless a stop came since it was requested, or that is too long ago."""
        mount, client = self.mount, asked.client
        if mount is None:
            asked.refuse(ConnectionLost(f"nothing was done: {self.connection.trouble}"))
            return
        if self._clock() - asked.at_s > LATE_S:
            asked.refuse(NoAnswer("nothing was done: the board was busy for too long; ask again"))
            return
        try:
            if self.lease.stops != self._confirmed:
                self._confirm(mount)
            if why := self._why_unstoppable(mount):
                raise NotStoppable(f"nothing was done: {why}")
            with mount.unless_stopped():  # by the brake; a stop from before this is seen next
                if asked.stops != self.lease.stops:
                    asked.drop()
                    return
                if not self.lease.alive(client):
                    asked.refuse(NotInControl(f"nothing was done: {client.name} was out of touch; ask again"))
                    return
                self.driver = client
                if mount.session.motion_log:
                    mount.session.motion_log.client = client.name
                if hold:
                    self._pad.step(mount, hold)
                else:
                    start(mount, asked, self.state)
        except (ConnectionLost, NoAnswer):
            self._unbegun = asked
            raise
        except MoveEnded:
            asked.drop()
        except MountError as e:
            self._refuse(asked, e)
        else:
            self._motions.begin(asked)

    def _refuse(self, asked: Asked, why: MountError) -> None:
        """Tell the client, and add a notice with cause and remedy."""
        asked.refuse(why)
        self.report(str(why), str(why.code) if isinstance(why, BoardError) else type(why).__name__)

    def _poll(self, mount: Mount) -> None:
        """Read the status; go on with the button that is held; stop the motion of a client that is not alive."""
        held = self._pad.held
        for client in (self.driver, held and held.client):
            if client and not self.lease.alive(client):
                self.driver = None
                self.stop(self.lease.silence_of(client))
                break
        if self.driver and (why := self._why_unstoppable(mount)):
            self.driver = None
            self.stop(why)
        if self.lease.stops != self._confirmed:
            self._confirm(mount)
        self._run_held(mount)
        status = self._see(mount)
        errors = mount.errors() if status.errors_waiting else []
        for error in errors:
            self.report(f"the board says {error.code}: {error.text.lower()}", str(error.code))
        if errors:
            self._pad.report_errors(status.moving)
        self._motions.poll(mount, status, errors)
        if not status.moving and self._pad.rest():
            self.driver = None  # before the next one: what begins here is not in this status yet
        self._deliver()
        self._begin_next_press()

    def _why_unstoppable(self, mount: Mount) -> str:
        """Why a stop from outside would not get in, "" if it would: what nobody can stop must not be kept alive."""
        listener = mount.session.stop_listener
        ways = [listener.why_deaf, *self.ways] if listener else self.ways
        return next(filter(None, (way() for way in ways)), "")

    def _see(self, mount: Mount) -> Status:
        """Read the status, and tell who listens: before the outcomes of motions, so that their positions are known."""
        status = mount.status()
        self.state.update(status, self.stop_cause)
        self._tell(status)
        return status

    def _tell(self, status: Status | None) -> None:
        for listener in self.listeners:
            listener(status)

    def _run_held(self, mount: Mount) -> None:
        """A button that is held long enough runs."""
        hold = self._pad.hold_to_run()
        if hold and self.driver is hold.client:
            try:
                with mount.unless_stopped():
                    self._pad.run(mount, hold)
            except (ConnectionLost, NoAnswer):
                raise
            except MoveEnded:
                pass
            except MountError as e:
                self.stop("a run was refused", tell=False)
                self._refuse(Asked(hold.client, hold.press, hold.stops, hold.ready_s), e)

    def _confirm(self, mount: Mount) -> None:
        """Make sure that the stops requested so far have stopped the mount."""
        stops = self.lease.stops
        mount.stop()
        self.lease.end_stopped(f"stopped: {self.stop_cause}")  # first: an outcome may make its client take control
        self._motions.poll(mount, self._see(mount), ())  # before another motion of the same axis begins
        self._confirmed, self.driver = stops, None
        self._pad.reset()
        self.state.targets = {}

    # ---- coming and going of the board

    def _connect(self) -> None:
        mount = self.connection.open()
        self.state.connect(mount)
        self.driver, self.gone = None, ""
        self._pad = Pad(self.state, self._clock, self.stop)
        self._confirmed = self.lease.stops  # opening has stopped what moved

    def _reconnect(self) -> None:
        with contextlib.suppress(MountError):
            self._connect()
            self.report("the board is back; nothing moves until you ask for it")

    def _lose(self, why: MountError) -> None:
        """The board has gone. Its motion ended with it, or by its keep-alive; nothing of it is resumed."""
        self.driver, self.gone = None, str(why)  # before control ends: who asks why gets the cause
        self.state.lose()
        self.lease.stops += 1  # requests from before are not carried out after
        self.lease.end_stopped(str(why))  # before the port is closed, which may take long: other mounts are to stop
        self.presses.drop()
        self.report(f"{why}; the port is tried every second, and no motion is resumed", type(why).__name__)
        self.connection.lose(why)
        self._tell(None)
        self._motions.fail(why)
        if unbegun := self._unbegun:
            self._unbegun = None
            unbegun.drop(why)
        self._mail.fail(why)
