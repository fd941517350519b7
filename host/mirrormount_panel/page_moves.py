"""Ways of several motions that a page has asked for by one button: to a kept position, or of the spot to a place.

The motions are requests of that page to the worker, one after the other, so that control, STOP, its ticks and the
board's keep-alive hold for them as for its buttons. There is one way at a time of a mount. Any other request of a
person ends it, and stops what it moves.
"""

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import TimeoutError as NotYet
from typing import TypeVar

from mirrormount.device.mount import Mount
from mirrormount.errors import MountError, MoveEnded, NoAnswer, NotInControl
from mirrormount.supervise.lease import Client
from mirrormount.supervise.motions import Motion
from mirrormount.supervise.requests import Request
from mirrormount.supervise.worker import Worker

T = TypeVar("T")

_CHECK_S = 0.05  # The time between two checks whether the way was ended.
_ANSWER_S = 5.0

_log = logging.getLogger("mirrormount_panel")


def ask_board(worker: Worker, work: Callable[[Mount], T]) -> T:
    """Run work(mount) in the mount's thread, and wait for it; not for asyncio's thread. Raises MountError."""
    future = worker.call(work)
    try:
        return future.result(_ANSWER_S)
    except NotYet:
        if future.cancel():
            raise NoAnswer("the board was busy for too long; ask again") from None
        return future.result()  # it has begun, so how it ends must be known


class PageMoves:
    """The ways of one mount. For the panel's asyncio loop."""

    def __init__(self, worker: Worker) -> None:
        self.worker = worker
        self._last: PageMove | None = None

    def begin(self, page: Client, what: str, work: "Callable[[PageMove], str]", say: Callable[[str], object]) -> None:
        """Run work(move) in a thread of its own; what was under way ends first.

        what: the way, in words. work returns what is told at its end, "" for nothing. say: shows what it does, in a
        line; "" at its end.
        """
        before = self._last
        self.give_way()
        move = PageMove(self.worker, page, before.thread if before else None, what, work, say)
        move.thread.start()
        self._last = move

    def give_way(self) -> None:
        """A person asks for something else: what goes on here ends."""
        if self._last:
            self._last.end("something else was asked for")


class PageMove:
    """One way. Methods raise NotInControl as soon as it was ended, by whomever."""

    def __init__(
        self,
        worker: Worker,
        page: Client,
        before: threading.Thread | None,
        what: str,
        work: Callable[["PageMove"], str],
        say: Callable[[str], object],
    ) -> None:
        self.page = page
        self._worker = worker
        self._stops = worker.lease.stops  # from here on any stop ends it
        self._before = before
        self._what = what
        self._work = work
        self._say = say
        self._ended = ""
        self._over = threading.Event()  # set by end()
        self._lock = threading.Lock()  # no request is made after end()
        self._motion: Motion | None = None
        self.thread = threading.Thread(target=self._run, name=what, daemon=True)

    def end(self, why: str) -> None:
        """Ask for no further motion, and stop the one that is under way. Any thread."""
        with self._lock:
            if self._motion and not self._motion.done and not self._ended:
                self._worker.stop(why, tell=False)
            self._ended = self._ended or why
            self._over.set()

    def _run(self) -> None:
        if self._before:
            self._before.join()
        try:
            told = self._work(self)
        except (NotInControl, MoveEnded) as e:
            told = f"{self._what} has ended: {self._why() or e}"
        except MountError as e:
            told = f"{self._what} has ended: {e}"
        except Exception as e:
            _log.exception("%s has failed", self._what)
            told = f"{self._what} has failed ({type(e).__name__}): ask again; more in the panel's log"
        self._say("")
        if told:
            self._worker.report(told)

    def _why(self) -> str:
        if self._ended:
            return self._ended
        if self._worker.lease.stops != self._stops:
            return f"stopped: {self._worker.stop_cause}"
        return "" if self._worker.lease.alive(self.page) else f"{self.page.name} is out of touch"

    def check(self) -> None:
        """Raises NotInControl if it was ended."""
        why = self._why()
        if why:
            raise NotInControl(why)

    def announce(self, text: str, for_s: float = 0.0) -> None:
        """Tell what comes, and wait."""
        self._worker.report(f"{self.page.name}: {text}; STOP ends it")
        self.say(f"{text}; STOP ends it")
        until_s = time.monotonic() + for_s
        while time.monotonic() < until_s:
            self.check()
            self._over.wait(_CHECK_S)  # a stop, or a page that is out of touch, is seen by check()

    def say(self, text: str) -> None:
        """What it does, in a line."""
        self.check()
        self._say(text)

    def ask(self, work: Callable[[Mount], T]) -> T:
        """As ask_board()."""
        self.check()
        return ask_board(self._worker, work)

    def make(self, request: Request, axis: str, wanted: int | None = None, *, longest_s: float | None = None) -> None:
        """Make a motion of that axis, and wait for its end. Raises MoveEnded, MountError.

        longest_s: after so long all is stopped; None: it lasts as long as the board lets it.
        """
        with self._lock:
            self.check()
            self._motion = motion = Motion(axis, wanted, lambda: None, _CHECK_S, jog=False)
            self._worker.request(self.page, request, motion, stops=self._stops)
        try:
            motion.wait(longest_s)
        except TimeoutError:
            self._worker.stop(f"{self._what} was not over in time")
            raise NotInControl(f"{axis}: not over within {longest_s:g} s") from None
