"""The one thread that uses the mount, with the brake beside it. Carries out the requests of the lease's clients.

The thread polls the board's status twenty times a second, and each poll feeds the board's keep-alive. It polls on
only while the client that asked for the motion is alive; if that client has gone, hangs or is cut off, it stops the
mount. If this thread or its whole program hangs, the board stops by its own keep-alive.

A stop has a thread of its own (brake.py). No request from before a stop is begun after it, waiting presses included.
"""

import contextlib
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from mirrormount.common.errors import (
    BoardError,
    ConnectionLost,
    MountError,
    MoveEnded,
    NoAnswer,
    NotInControl,
    SupervisorFault,
)
from mirrormount.device.mount import Mount
from mirrormount.supervise.brake import Brake
from mirrormount.supervise.lease import Client, Lease
from mirrormount.supervise.motions import Asked, Motion, Motions, start
from mirrormount.supervise.notices import Notices, ToNotices
from mirrormount.supervise.pad import Pad
from mirrormount.supervise.presses import Hold, Presses
from mirrormount.supervise.reconnect import Address, Connection
from mirrormount.supervise.requests import Press, Request
from mirrormount.supervise.state import POLL_S, State
from mirrormount.supervise.tasks import Tasks
from mirrormount.supervise.wire_log import WireLog

_SOON_S = 0.01  # instead of POLL_S while a press waits for a step to end
LATE_S = 0.5  # a request that could not be begun for so long is not begun
_RETRY_S = 1.0  # between two attempts to open the port

T = TypeVar("T")
_log = logging.getLogger("mirrormount.supervise")


class Worker:
    """Owns the mount. request() … call() may be called from any thread, and return at once.

    address: a port, or None for the only board. Attributes for any thread to read: connection, state, notices, log,
    driver (the client whose motion it is), stop_cause (of the last stop), gone (why the board is lost, "" while not).
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
        self.notices = Notices()
        self._clock = clock
        self._pad = Pad(self.state, clock, self.stop)
        self._motions = Motions(clock, lambda rest: self._tasks.add(lambda: self._begin(rest), rest.refuse))
        self._tasks = Tasks()
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
        """Motors off, port closed. Raises MountError if they did not stop."""
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

    # ---- for clients: any thread

    def take_control(self, client: Client) -> None:
        """Give a client control; motion of the client before it is stopped. Raises NotInControl, as Lease.claim()."""
        if self.lease.claim(client):
            self.stop(f"{client.name} took control", counted=True)

    def hand_over(self, person: Client, number: object) -> None:
        """Give control to the program that asked by that question. Raises NotInControl, as Lease.hand_over()."""
        question = self.lease.hand_over(person, number)
        self.stop(f"{person.name} handed control to {question.client.name}", counted=True)
        question.outcome.set_result(None)

    def request(self, client: Client, request: Request, motion: Motion | None = None, stops: int | None = None) -> None:
        """Carry out a request; a later refusal becomes the motion's outcome, or a notice of the client.

        A press during a step waits for its turn. stops: lease.stops when it was decided. Raises NotInControl.
        """
        asked = Asked(client, request, self.lease.stops if stops is None else stops, self._clock(), motion)
        self.lease.check(client)  # behind the count: control is claimed before the motion of its last holder is stopped
        if not isinstance(request, Press):
            self._tasks.add(lambda: self._begin(asked), asked.refuse)
        elif self._pad.add(Hold(client, request, asked.stops, asked.at_s)):
            self._tasks.add(self._begin_next_press)

    def release(self, client: Client) -> None:
        """The button is up: a run ends now; a step that was begun is made, and so is one that waits."""
        if self._pad.release(client):
            self.stop("the button was let go", tell=False)

    def stop(self, cause: str, *, tell: bool = True, counted: bool = False) -> None:
        """All motors off, now. cause: in a few words. counted: the lease has counted this stop.

        tell: add it to the notices; not from a signal handler, for that takes a lock.
        """
        self.stop_cause = cause
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
        return self._tasks.ask(self.connection, work, self.state.read_scales if changes else lambda _: None)

    def report(self, text: str, error: str = "") -> None:
        """Add a notice for all clients."""
        self.notices.add(text, error)

    # ---- the mount's thread

    def _run(self) -> None:
        while not self._closing:
            try:
                soon_s = _SOON_S if self.presses else POLL_S
                self._tasks.run_next(soon_s if self.mount else _RETRY_S)
                if self.mount is None:
                    self._reconnect()
                if self.mount:
                    self._poll(self.mount)
            except MountError as e:
                self._lose(e)
            except Exception as e:  # a fault of this program: the motors are stopped in any case
                _log.exception("the worker has a fault")
                self._lose(SupervisorFault(f"this program has a fault ({type(e).__name__}: {e}); motors were stopped"))

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
            with mount.unless_stopped():  # by the brake; a stop from before this is seen next
                if asked.stops != self.lease.stops:
                    asked.drop()
                    return
                if not self.lease.alive(client):
                    asked.refuse(NotInControl(f"nothing was done: {client.name} was out of touch; ask again"))
                    return
                self.driver = client
                if hold:
                    self._pad.step(mount, hold)
                else:
                    start(mount, asked, self.state)
        except (ConnectionLost, NoAnswer) as e:
            asked.drop(e)
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
        if self.lease.stops != self._confirmed:
            self._confirm(mount)
        self._run_held(mount)
        status = mount.status()
        self.state.update(status, self.stop_cause)
        errors = mount.errors() if status.errors_waiting else []
        for error in errors:
            self.report(f"the board says {error.code}: {error.text.lower()}", str(error.code))
        if errors:
            self._pad.report_errors(status.moving)
        self._motions.poll(mount, status, errors)
        if not status.moving and self._pad.rest():
            self.driver = None
        self._begin_next_press()

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
        self._motions.poll(mount, mount.status(), ())  # before another motion of the same axis begins
        self._confirmed, self.driver = stops, None
        self._pad.reset()
        self.state.targets = {}
        self.lease.end_stopped(f"stopped: {self.stop_cause}")

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
        self._motions.fail(why)
