"""Direction buttons that go down and come up: one steps or runs, others wait for their turn. Pure.

How they move the mount: pad.py.
"""

from collections import deque
from dataclasses import dataclass

from mirrormount.supervise.lease import Client
from mirrormount.supervise.requests import Press

HOLD_S = 0.7  # a button that is held longer runs; released before, it made a step
MOST = 10  # presses that wait: 2 s of steps


@dataclass(eq=False)
class Hold:
    """A button that is down, or was."""

    client: Client
    press: Press
    stops: int  # stops requested before it: after one more it is not begun
    ready_s: float  # when it could have begun: when it went down, or when those before it were done
    begun_s: float | None = None  # when its step was begun, and not refused
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
        """Mark those that wait as not late: a step before them is under way."""
        for hold in list(self._waiting):
            hold.ready_s = now_s

    def pop(self) -> Hold | None:
        """Take the next press; it becomes the current one."""
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
