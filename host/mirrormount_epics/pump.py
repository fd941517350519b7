"""The one thread that tells the records what has happened, in the order in which it did, and gives signs of life.

A mount's own threads and EPICS's threads put events; none of them waits. If this thread hangs, the signs of life of its
programs end, and their supervisors stop what they move; if the whole process does, the boards do.
"""

import logging
import queue
import time
from collections.abc import Callable

BEAT_S = 0.1
PATIENCE_S = 1.0  # of the mounts with this thread, which feeds many of them, and with the loop beside it
_SLOW_S = 1.0

_log = logging.getLogger("mirrormount.epics")


class Pump:
    """Events, and two rhythms: often for each sign of life, seldom for what has time."""

    def __init__(self) -> None:
        self._events: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self.beats = 0  # counts while this thread does not hang
        self.often: list[Callable[[], object]] = []
        self.seldom: list[Callable[[], object]] = []

    def put(self, event: Callable[[], object]) -> None:
        """Have event() called by the pump's thread. Any thread."""
        self._events.put(event)

    def run(self) -> None:
        """Until an exception of a signal. What is done seldom is done once more then: what was set last is kept."""
        try:
            self._run()
        finally:
            self._call(*self.seldom)

    def _run(self) -> None:
        beat_s = slow_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            if now_s >= beat_s:
                beat_s = now_s + BEAT_S
                self.beats += 1
                self._call(*self.often)
            if now_s >= slow_s:
                slow_s = now_s + _SLOW_S
                self._call(*self.seldom)
            try:
                event = self._events.get(timeout=max(0.0, beat_s - time.monotonic()))
            except queue.Empty:
                continue
            self._call(event)

    def _call(self, *events: Callable[[], object]) -> None:
        for event in events:
            try:
                event()
            except Exception:  # of one mount: the others go on
                _log.exception("the pump has a fault")
