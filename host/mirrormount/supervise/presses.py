"""Direction buttons that go down and come up: one is held or just stepping, others wait for their turn. Pure."""

from collections import deque
from dataclasses import dataclass

from mirrormount.supervise.lease import Page
from mirrormount.supervise.requests import Press

HOLD_S = 0.7  # a button held for longer is a run; let go before, it was a step
MOST = 10  # presses that wait: 2 s of steps


@dataclass(eq=False)
class Hold:
    """A button that is down, or was."""

    page: Page
    press: Press
    stops: int  # asked for before it: after one more it is not begun
    ready_s: float  # when it could have begun: when it went down, or when those before it were done
    begun_s: float | None = None  # when its step was begun, and not refused
    running: bool = False
    released: bool = False

    def is_run(self, now_s: float) -> bool:
        """Has it been down for long enough?"""
        return self.begun_s is not None and now_s - self.begun_s >= HOLD_S


class Presses:
    """current: the one that is stepping, running or was last. One thread begins them, any thread adds and drops."""

    def __init__(self) -> None:
        self.current: Hold | None = None
        self._waiting: deque[Hold] = deque()

    def __len__(self) -> int:
        """How many wait."""
        return len(self._waiting)

    @property
    def full(self) -> bool:
        """True if there is no room for one more."""
        return len(self._waiting) >= MOST

    @property
    def last(self) -> Hold | None:
        """The one that went down last."""
        try:
            return self._waiting[-1]
        except IndexError:
            return self.current

    def add(self, hold: Hold) -> None:
        """It has gone down."""
        self._waiting.append(hold)

    def postpone(self, now_s: float) -> None:
        """Those that wait do so for a step before them: they are not late."""
        for hold in list(self._waiting):
            hold.ready_s = now_s

    def next(self) -> Hold | None:
        """The one whose turn it is; it becomes the current one."""
        if not self._waiting:
            return None
        try:
            self.current = hold = self._waiting[0]  # before it leaves the queue: a release must find it at any moment
            self._waiting.popleft()
        except IndexError:  # another thread has dropped them meanwhile
            self.drop()
            return None
        return hold

    def drop(self) -> None:
        """None waits any more, and none is held."""
        self._waiting.clear()
        if self.current:
            self.current.released = True

    def of(self, page: Page) -> bool:
        """Does this page hold a button, or wait for its steps?"""
        current = self.current
        return any(h.page is page for h in list(self._waiting)) or (
            current is not None and current.page is page and not current.released
        )
