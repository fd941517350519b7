"""Orders stops and starts of all threads: no motion starts after a stop that came later than its request."""

import contextlib
import itertools
import threading
from collections.abc import Iterator

from mirrormount.common.errors import MoveEnded
from mountfw import codes as wire


def not_begun() -> MoveEnded:
    """Of a motion that a stop has kept from starting."""
    return MoveEnded("mount", wire.ABORTED, 0, None, ["stopped before it began"])


class StopGate:
    """Held while a stop is written, and while a line that starts a motion is written.

    stops = gate.last_stop()           # when the motion is requested
    with gate.starting(stops): ...     # MoveEnded if there was a stop since
    with gate.stopping(): ...          # around the writing of a stop
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._numbers = itertools.count(1)
        self._last = 0  # each stop has its own number, so that none is lost between two threads
        self._blocks = threading.local()  # since: the last stop before this thread's outermost unless_stopped() began

    def last_stop(self) -> int:
        """The number of the last stop: in a block of unless_stopped() the last one before the block."""
        since: int | None = getattr(self._blocks, "since", None)
        return self._last if since is None else since

    @contextlib.contextmanager
    def starting(self, last_stop: int) -> Iterator[None]:
        """Inside, no other thread writes a stop. Raises MoveEnded if there was one after last_stop."""
        with self._lock:
            if last_stop != self._last:
                raise not_begun()
            yield

    @contextlib.contextmanager
    def stopping(self, longest_s: float | None = None) -> Iterator[None]:
        """Register a stop; inside, it is written. Waits longest_s at most for another thread's line, then goes on."""
        self._last = next(self._numbers)
        is_alone = self._lock.acquire(timeout=-1 if longest_s is None else longest_s)
        try:
            yield
        finally:
            if is_alone:
                self._lock.release()

    @contextlib.contextmanager
    def unless_stopped(self) -> Iterator[None]:
        """A motion of this thread inside starts only if no thread has stopped since the outermost such block began."""
        before: int | None = getattr(self._blocks, "since", None)
        self._blocks.since = self._last if before is None else before
        try:
            yield
        finally:
            self._blocks.since = before
