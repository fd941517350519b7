"""The one thread that speaks to the mount, and the brake beside it. Knows pages by their Desk, and no web.

The thread looks at the board twenty times a second, and each look is what keeps a motion alive there. It looks
only while the page that asked for the motion is alive; if that page is closed, frozen or cut off, it stops the
mount instead. And if this thread, or this whole program, hangs, the board hears nothing and stops by itself.

A stop never waits for the thread: it has one of its own (brake.py). After a stop nothing that was
asked for before it is begun any more, and that includes presses that wait for their turn (presses.py).
"""

import contextlib
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from mirrormount.common.errors import BadValue, BoardError, ConnectionLost, MountError, MoveEnded, NoAnswer, PanelFault
from mirrormount.device.mount import Mount
from mirrormount.device.status import Status
from mirrormount.supervise import scales
from mirrormount.supervise.brake import Brake
from mirrormount.supervise.lease import Desk, Page
from mirrormount.supervise.notices import Notices, ToNotices
from mirrormount.supervise.presses import Hold, Presses
from mirrormount.supervise.requests import Drive, GoTo, Home, Order, Press, Steps, Zero
from mirrormount.supervise.wire_log import WireLog
from mirrormount.transport.find import find_one
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_port
from mirrormount.transport.port import Port
from mirrormount.transport.stop_socket import Stoppable
from mirrormount.transport.tap import TappedPort

LOOK_S = 0.05  # between two looks at the board
_SOON_S = 0.01  # the same while a press waits for a step to end
LATE_S = 0.5  # an order that could not be begun for so long is not begun any more
_KNOWN_S = 0.6  # a status that is older is not what the board does now
_RETRY_S = 1.0  # between two attempts to find the board
_KEPT_S = 120.0  # of the positions, for the plot

T = TypeVar("T")
Point = tuple[float, float | None, float | None]  # when, x, y; None where it is not known
_log = logging.getLogger("mirrormount.panel")


class Pilot:
    """Owns the mount. order() … call() may be called from any thread, and return at once.

    address: a port, or None for the one board there is. Attributes to be read by any thread: mount (None while
    there is no board), status (None while it is not known), last (the last that was known), seen_s (when, monotonic),
    trouble (why there is no board, "" if there is one), driver (whose motion it is), why (of the last stop).
    """

    def __init__(self, address: str | None, desk: Desk, clock: Callable[[], float] = time.monotonic) -> None:
        self._address = address
        self._desk = desk
        self.log = WireLog()
        self.port: Port | None = None
        self.mount: Mount | None = None
        self.status: Status | None = None
        self.last: Status | None = None
        self.seen_s = 0.0
        self.why = ""
        self.trouble = "not connected yet"
        self.driver: Page | None = None
        self.scales: scales.Scales = {}
        self.targets: dict[str, int | None] = {"x": None, "y": None}
        self.positions: deque[Point] = deque(maxlen=round(_KEPT_S / LOOK_S))
        self.notices = Notices()
        self.presses = Presses()
        self._clock = clock
        self._stepping = False  # by a press, and not seen to be over
        self._stoppable: Stoppable | None = None
        self._orders: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._stops = 0  # asked for
        self._confirmed = 0  # of them, those that the board has been seen to obey
        self._brake = Brake(lambda: self.mount)
        self._closing = False
        self._thread = threading.Thread(target=self._live, name="pilot", daemon=True)

    def open(self) -> None:
        """Connect and begin. Raises MountError if there is no mount at the address."""
        self._connect()
        logging.getLogger("mirrormount").addHandler(ToNotices(self.notices))
        self._thread.start()
        self._brake.start()

    def close(self) -> None:
        """Motors off, port closed. Raises MountError if they did not stop."""
        self._closing = True
        if self._thread.is_alive():
            self._thread.join(5)
        self._brake.close()
        mount, self.mount = self.mount, None
        if self._stoppable:
            self._stoppable.close()
        if mount:
            try:
                mount.stop()
            finally:
                mount.close()

    # ---- for the pages: any thread

    def order(self, page: Page, order: Order) -> None:
        """Do what the page asks for. What cannot be done is told to that page.

        A press while a step of an earlier press is under way waits for its turn.
        """
        stops, asked_s = self._stops, self._clock()
        if not isinstance(order, Press):
            self._orders.put(lambda: self._begin(page, stops, asked_s, lambda mount: self._move(mount, order)))
            return
        last = self.presses.last
        if last and not last.released:
            return  # one hand at a time
        if self.presses.full:
            page.notices.append(f"this press was not counted: {len(self.presses)} steps wait already")
            return
        self.presses.add(Hold(page, order, stops, asked_s))
        self._orders.put(self._press_next)

    def release(self, page: Page) -> None:
        """The button is up: a run ends now, a step that has just begun is made, and so is one that waits."""
        hold = self.presses.last
        if hold and hold.page is page and not hold.released:
            hold.released = True
            if hold.running or hold.is_run(self._clock()):
                self.stop("the button was let go", tell=False)

    def stop(self, why: str, *, tell: bool = True) -> None:
        """Both motors off, now. why: in a few words, for the pages.

        tell: list it as something that has happened; not from a handler of a signal, for that takes a lock.
        """
        self._stops += 1
        self._brake.pull()
        self.presses.drop()
        self.why = why
        if tell:
            self.say(f"stopped: {why}")

    def gone(self, page: Page) -> None:
        """The page's connection has ended: what it drove stops."""
        if self.driver is page or self.presses.of(page):
            self.stop(f"{page.name}, which had asked for the motion, has gone")

    def call(self, work: Callable[[Mount], T], *, changes: bool = False) -> "Future[T]":
        """Have work(mount) done in the mount's thread. The future raises MountError; nobody else is told.

        changes: it may change settings, and with them what a step is.
        """
        future: Future[T] = Future()
        asked = self.mount

        def run() -> None:
            if not future.set_running_or_notify_cancel():
                return  # whoever asked has gone
            if self.mount is None or self.mount is not asked:  # another board may have come meanwhile
                why = self.trouble or "the board had gone meanwhile"
                future.set_exception(ConnectionLost(f"nothing was done: {why}"))
                return
            try:
                result = work(self.mount)
                if changes:
                    self.scales = scales.read(self.mount)
                future.set_result(result)
            except (ConnectionLost, NoAnswer) as e:
                future.set_exception(e)
                raise
            except Exception as e:
                future.set_exception(e)

        self._orders.put(run)
        return future

    def spot_mm(self) -> tuple[float, float] | None:
        """Where the spot is on a virtual board's screen: (right, up) in mm. None with a real board."""
        simulation = getattr(self.port, "simulation", None)
        return simulation.bench.spot_mm() if simulation and self.mount else None

    def mrad_text(self, name: str, steps: float) -> str:
        """A position in mrad of the mirror; "" where no scale is known."""
        scale = self.scales.get(name)
        return "" if scale is None else f"≈ {steps * scale:+.2f} mrad".replace("-", "−")

    @property
    def is_known(self) -> bool:
        """True while the status is that of a moment ago."""
        return self.status is not None and time.monotonic() - self.seen_s < _KNOWN_S

    @property
    def seen_at(self) -> str:
        """When the last status came, by the wall's clock."""
        return time.strftime("%H:%M:%S", time.localtime(time.time() - (time.monotonic() - self.seen_s)))

    def say(self, text: str, error: str = "") -> None:
        """Tell all pages."""
        self.notices.add(text, error)

    # ---- the mount's thread

    def _live(self) -> None:
        while not self._closing:
            try:
                self._obey_next()
                self._connect_again()
                if self.mount:
                    self._look(self.mount)
            except MountError as e:
                self._lose(e)
            except Exception as e:  # a fault of this program: the mount rests, whatever it was
                _log.exception("the panel has a fault")
                self._lose(PanelFault(f"the panel has a fault ({type(e).__name__}: {e}); the motors were stopped"))

    def _obey_next(self) -> None:
        """Wait for an order until the next look is due, and carry it out."""
        with contextlib.suppress(queue.Empty):
            pause_s = _SOON_S if self.presses else LOOK_S
            self._orders.get(timeout=pause_s if self.mount else _RETRY_S)()

    def _press_next(self) -> None:
        """Begin the press whose turn it is, if the step before it is over."""
        now_s, before = self._clock(), self.presses.current
        if self._stepping or (before and not before.released and before.begun_s is not None):
            self.presses.postpone(now_s)
            return
        hold = self.presses.next()
        if hold is None:
            return
        self._begin(hold.page, hold.stops, hold.ready_s, lambda mount: self._press(mount, hold))
        if hold.begun_s is None:  # refused: those behind it are not made either
            self.presses.drop()

    def _begin(self, page: Page, stops: int, asked_s: float, start: Callable[[Mount], None]) -> None:
        """Start a motion for a page, unless there was a stop since it was asked for, or it was too long ago."""
        mount = self.mount
        if mount is None:
            page.notices.append(f"nothing was done: {self.trouble}")
            return
        if self._clock() - asked_s > LATE_S:
            page.notices.append("nothing was done: the board was busy for too long; ask again")
            return
        if self._stops != self._confirmed:
            self._confirm(mount)
        try:
            with mount.unless_stopped():  # by the brake; what was asked of the brake before this is seen next
                if stops != self._stops:
                    return
                if not self._desk.alive(page):
                    page.notices.append("nothing was done: this page was out of touch; ask again")
                    return
                self.driver = page
                start(mount)
        except (ConnectionLost, NoAnswer):
            raise
        except MoveEnded:
            pass  # stopped before it began: as asked
        except MountError as e:
            self._refused(page, e)

    def _refused(self, page: Page, why: MountError) -> None:
        """Tell the page that asked, and list it with cause and remedy."""
        page.notices.append(str(why))
        self.say(str(why), str(why.code) if isinstance(why, BoardError) else type(why).__name__)

    def _press(self, mount: Mount, hold: Hold) -> None:
        for name, steps in hold.press.steps.items():
            self.targets[name] = None
            try:
                getattr(mount, name).step(steps, wait=False, feed=False)
            except BoardError:
                if len(hold.press.steps) > 1:  # one axis of two
                    self.stop("one axis of a diagonal step was refused")
                raise
        self._stepping = True
        hold.begun_s = self._clock()

    def _move(self, mount: Mount, order: Order) -> None:
        match order:
            case Steps(axis, n):
                self.targets[axis] = None
                getattr(mount, axis).step(n, wait=False, feed=False)
            case GoTo(axis, position):
                getattr(mount, axis).move_to(position, wait=False, feed=False)
                self.targets[axis] = position
            case Drive(x, y):
                self.targets = {"x": None, "y": None}
                duty = {mount.x.number: x, mount.y.number: y}
                mount.drive(duty[1], duty[2], feed=False)
            case Home(axis):
                self.targets[axis] = None
                getattr(mount, axis).start_homing()
            case Zero(axis):
                self.targets[axis] = None
                getattr(mount, axis).zero()

    def _look(self, mount: Mount) -> None:
        """See how the mount is; go on with what is held; stop what nobody is there for any more."""
        driver, hold = self.driver, self.presses.current
        away = next(
            (p for p in (driver, hold and not hold.released and hold.page) if p and not self._desk.alive(p)), None
        )
        if away:
            self.driver = None
            self.stop(f"{away.name}, which had asked for the motion, is out of touch")
        if self._stops != self._confirmed:
            self._confirm(mount)
        self._go_on(mount)
        status = mount.status()
        self.seen_s = time.monotonic()
        self.positions.append((self.seen_s, status.x.position, status.y.position))
        self.status = self.last = status
        if status.errors_waiting:
            for error in mount.errors():
                self.say(f"the board says {error.code}: {error.text.lower()}", str(error.code))
            if hold and hold.running and not hold.released and status.moving:
                self.stop("the board reported an error in a run")  # drop() alone would lose the release
            self.presses.drop()
        if not status.moving:
            self._stepping = False
            if not self.presses and (not hold or hold.released):
                self.driver = None
        self._press_next()

    def _go_on(self, mount: Mount) -> None:
        """A button that is held long enough becomes a run."""
        hold = self.presses.current
        if not hold or hold.released or hold.running or not hold.is_run(self._clock()):
            return
        hold.running = True  # before it is: a release from here on stops it
        if self.driver is hold.page:
            try:
                with mount.unless_stopped():
                    for name, speed in hold.press.run.items():
                        if not hold.released:
                            getattr(mount, name).jog(speed, feed=False)
            except (ConnectionLost, NoAnswer):
                raise
            except MoveEnded:
                pass
            except MountError as e:
                self.stop("a run was refused", tell=False)
                self._refused(hold.page, e)

    def _confirm(self, mount: Mount) -> None:
        """Make sure that the stops asked for so far have stopped the mount."""
        stops = self._stops
        mount.stop()
        self._confirmed = stops
        self.driver = None
        self._stepping = False
        self.targets = {"x": None, "y": None}

    def _stop_for_another_program(self, mount: Mount) -> str:
        """`mirrormount stop` in another terminal."""
        self.stop("another program of this computer asked for it (mirrormount stop)")
        return mount._stop_for_another_program()

    # ---- coming and going of the board

    def _connect(self) -> None:
        address = find_one() if self._address is None else self._address
        port = open_port(address)
        try:
            if port.lockstep:
                raise BadValue("the panel needs a board at its own pace: speed=max is for use in one process")
            mount = Mount(Link(TappedPort(port, self.log)))
            self.scales = scales.read(mount)
        except BaseException:
            port.close()
            raise
        self.port = port
        self.mount = mount
        self.driver = None
        self._stepping = False
        self.presses = Presses()
        self._stoppable = Stoppable([address], lambda: self._stop_for_another_program(mount))
        self.targets = {"x": None, "y": None}
        self._confirmed = self._stops  # opening has stopped what moved
        self.trouble = ""

    def _connect_again(self) -> None:
        if self.mount:
            return
        try:
            self._connect()
            self.say("the board is back; nothing moves until you ask for it")
        except MountError as e:
            self.trouble = str(e)

    def _lose(self, why: MountError) -> None:
        """The board has gone. What it was doing ended with it, or by its keep-alive; nothing of it is resumed."""
        mount, self.mount = self.mount, None
        self.status = self.driver = None
        self._stops += 1  # what was asked for before is not done after
        self.presses.drop()
        self.positions.append((time.monotonic(), None, None))
        if self._stoppable:
            self._stoppable.close()
        self.trouble = str(why)
        self.say(f"{why}; the panel looks for the board, and will not resume what it did", type(why).__name__)
        if mount:
            for last in (mount.halt, mount.close):  # in case it only did not answer
                with contextlib.suppress(MountError, OSError):  # OSError: the driver of a port that has gone
                    last()
