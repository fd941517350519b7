"""The one thread that speaks to the mount, and the brake beside it. Knows pages by their Desk, and no web.

The thread looks at the board twenty times a second, and each look is what keeps a motion alive there. It looks
only while the page that asked for the motion is alive; if that page is closed, frozen or cut off, it stops the
mount instead. And if this thread, or this whole program, hangs, the board hears nothing and stops by itself.

A stop never waits for the thread: the brake is another one, which does nothing else.
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

from mirrormount.client import Mount
from mirrormount.errors import BadValue, BoardError, ConnectionLost, MountError, MoveEnded, NoAnswer, PanelFault
from mirrormount.link import Link, Port, find_one, open_port
from mirrormount.panel import scales
from mirrormount.panel.desk import Desk, Page
from mirrormount.panel.orders import Drive, GoTo, Home, Order, Press, Steps, Zero
from mirrormount.panel.wire_log import TappedPort, WireLog
from mirrormount.status import Status

LOOK_S = 0.05  # between two looks at the board
LATE_S = 0.5  # an order that could not be begun for so long is not begun any more
HOLD_S = 0.4  # a button held for longer is a run; let go before, it was a step
_RETRY_S = 1.0  # between two attempts to find the board
_KEPT_S = 120.0  # of the positions, for the plot
_NOTICES = 50

T = TypeVar("T")
_log = logging.getLogger("mirrormount.panel")


@dataclass(frozen=True)
class Notice:
    """Something that has happened, for all pages. error: the number (board) or the type (host) of it, or ""."""

    number: int
    at_s: float  # the wall's time
    text: str
    error: str = ""


@dataclass
class _Hold:
    """A direction button that is down, or was a moment ago."""

    page: Page
    press: Press
    since_s: float
    begun: bool = False  # its step was not refused
    running: bool = False
    released: bool = False


class Pilot:
    """Owns the mount. order() … call() may be called from any thread, and return at once.

    address: a port, or None for the one board there is. Attributes to be read by any thread: mount (None while
    there is no board), status, trouble (why there is no board, "" if there is one), driver (whose motion it is).
    """

    def __init__(self, address: str | None, desk: Desk) -> None:
        self._address = address
        self._desk = desk
        self.log = WireLog()
        self.port: Port | None = None
        self.mount: Mount | None = None
        self.status: Status | None = None
        self.trouble = "not connected yet"
        self.driver: Page | None = None
        self.scales: scales.Scales = {}
        self.targets: dict[str, int | None] = {"x": None, "y": None}
        self.positions: deque[tuple[float, float, float]] = deque(maxlen=round(_KEPT_S / LOOK_S))
        self.notices: deque[Notice] = deque(maxlen=_NOTICES)
        self._noticed = 0
        self._orders: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._hold: _Hold | None = None
        self._stops = 0  # asked for
        self._confirmed = 0  # of them, those that the board has been seen to obey
        self._brake: queue.SimpleQueue[None] = queue.SimpleQueue()  # an Event's set() may not be interrupted by itself
        self._closing = False
        self._threads = [
            threading.Thread(target=self._live, name="pilot", daemon=True),
            threading.Thread(target=self._stand_by, name="brake", daemon=True),
        ]

    def open(self) -> None:
        """Connect and begin. Raises MountError if there is no mount at the address."""
        self._connect()
        logging.getLogger("mirrormount").addHandler(_ToNotices(self))
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Motors off, port closed. Raises MountError if they did not stop."""
        self._closing = True
        self._brake.put(None)
        for thread in self._threads:
            if thread.is_alive():
                thread.join(5)
        mount, self.mount = self.mount, None
        if mount:
            try:
                mount.stop()
            finally:
                mount.close()

    # ---- for the pages: any thread

    def order(self, page: Page, order: Order) -> None:
        """Do what the page asks for. What cannot be done is told to that page."""
        stops, asked_s = self._stops, time.monotonic()
        if isinstance(order, Press):
            if self._hold and not self._hold.released:
                return  # one hand at a time
            self._hold = hold = _Hold(page, order, asked_s)
            self._orders.put(lambda: self._begin(page, stops, asked_s, lambda mount: self._press(mount, hold)))
        else:
            self._orders.put(lambda: self._begin(page, stops, asked_s, lambda mount: self._move(mount, order)))

    def release(self, page: Page) -> None:
        """The button is up: a run ends now, a step that has just begun is made."""
        hold = self._hold
        if hold and hold.page is page and not hold.released:
            hold.released = True
            if hold.running or time.monotonic() - hold.since_s >= HOLD_S:
                self.stop()

    def stop(self) -> None:
        """Both motors off, now."""
        self._stops += 1
        if self._hold:
            self._hold.released = True
        self._brake.put(None)

    def gone(self, page: Page) -> None:
        """The page's connection has ended: what it drove stops."""
        if self.driver is page or (self._hold and self._hold.page is page and not self._hold.released):
            self.stop()

    def call(self, work: Callable[[Mount], T]) -> "Future[T]":
        """Have work(mount) done in the mount's thread. The future raises MountError; nobody else is told."""
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
                self.scales = scales.read(self.mount)  # it may have changed what a step is
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
        world = getattr(self.port, "world", None)
        return world.bench.spot_mm() if world and self.mount else None

    def mrad_text(self, name: str, steps: float) -> str:
        """A position in mrad of the mirror; "" where no scale is known."""
        scale = self.scales.get(name)
        return "" if scale is None else f"≈ {steps * scale:+.2f} mrad".replace("-", "−")

    def say(self, text: str, error: str = "") -> None:
        """Tell all pages."""
        self._noticed += 1
        self.notices.append(Notice(self._noticed, time.time(), text, error))

    # ---- the brake's thread

    def _stand_by(self) -> None:
        while not self._closing:
            self._brake.get()
            with contextlib.suppress(queue.Empty):  # one halt serves all stops asked for before it
                while True:
                    self._brake.get_nowait()
            mount = self.mount
            if mount:
                try:
                    mount.halt()
                except Exception:  # the pilot's next look finds out, and says so; the brake stands by
                    _log.warning("a stop could not be sent", exc_info=True)

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
            self._orders.get(timeout=LOOK_S if self.mount else _RETRY_S)()

    def _begin(self, page: Page, stops: int, asked_s: float, start: Callable[[Mount], None]) -> None:
        """Start a motion for a page, unless there was a stop since it was asked for, or it was too long ago."""
        mount = self.mount
        if mount is None:
            page.notices.append(f"nothing was done: {self.trouble}")
            return
        if time.monotonic() - asked_s > LATE_S:
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

    def _press(self, mount: Mount, hold: _Hold) -> None:
        axis = getattr(mount, hold.press.axis)
        self.targets[hold.press.axis] = None
        axis.step(hold.press.steps, wait=False, feed=False)
        hold.begun = True

    def _move(self, mount: Mount, order: Order) -> None:
        match order:
            case Steps(axis, n):
                self.targets[axis] = None
                getattr(mount, axis).step(n, wait=False, feed=False)
            case GoTo(axis, position):
                getattr(mount, axis).move_to(position, wait=False, feed=False)
                self.targets[axis] = position
            case Drive(m1, m2):
                self.targets = {"x": None, "y": None}
                mount.drive(m1, m2, feed=False)
            case Home(axis):
                self.targets[axis] = None
                getattr(mount, axis).start_homing()
            case Zero(axis):
                self.targets[axis] = None
                getattr(mount, axis).zero()

    def _look(self, mount: Mount) -> None:
        """See how the mount is; go on with what is held; stop what nobody is there for any more."""
        hold, driver = self._hold, self.driver
        if hold and not self._desk.alive(hold.page):
            hold.released = True
        if driver and not self._desk.alive(driver):
            self.driver = None
            self.stop()
            self.say(f"stopped: {driver.name}, which had asked for the motion, is out of touch")
        if self._stops != self._confirmed:
            self._confirm(mount)
        self._go_on(mount)
        status = mount.status()
        self.positions.append((time.monotonic(), status.x.position, status.y.position))
        self.status = status
        if status.errors_waiting:
            for error in mount.errors():
                self.say(f"the board says {error.code}: {error.text.lower()}", str(error.code))
        if self.driver and not status.moving and (not hold or hold.released):
            self.driver = None

    def _go_on(self, mount: Mount) -> None:
        """A button that is held long enough becomes a run."""
        hold = self._hold
        if not hold or not hold.begun or hold.released or hold.running or time.monotonic() - hold.since_s < HOLD_S:
            return
        hold.running = True  # before it is: a release from here on stops it
        if self.driver is hold.page:
            try:
                with mount.unless_stopped():
                    if not hold.released:
                        getattr(mount, hold.press.axis).jog(hold.press.run, feed=False)
            except (ConnectionLost, NoAnswer):
                raise
            except MoveEnded:
                pass
            except MountError as e:
                self._refused(hold.page, e)

    def _confirm(self, mount: Mount) -> None:
        """Make sure that the stops asked for so far have stopped the mount."""
        stops = self._stops
        mount.stop()
        self._confirmed = stops
        self.driver = None

    # ---- coming and going of the board

    def _connect(self) -> None:
        port = open_port(find_one() if self._address is None else self._address)
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
        self.driver = self._hold = None
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
        self.status = self.driver = self._hold = None
        self._stops += 1  # what was asked for before is not done after
        self.trouble = str(why)
        self.say(f"{why}; the panel looks for the board, and will not resume what it did", type(why).__name__)
        if mount:
            for last in (mount.halt, mount.close):  # in case it only did not answer
                with contextlib.suppress(MountError, OSError):  # OSError: the driver of a port that has gone
                    last()


class _ToNotices(logging.Handler):
    """What the client logs, it tells nobody else: errors of the board that waited from before."""

    def __init__(self, pilot: Pilot) -> None:
        super().__init__(logging.WARNING)
        self._pilot = pilot

    def emit(self, record: logging.LogRecord) -> None:
        self._pilot.say(record.getMessage())
