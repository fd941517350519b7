"""The last events in words, for all clients. Any thread may add and read."""

import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

_KEPT = 50
_SAME_S = 1.0  # the same text within this time is one event: a STOP arrives by two ways


@dataclass(frozen=True)
class Notice:
    """An event. error: its number (board) or type (host), "" if it is no error."""

    number: int
    at_s: float  # wall-clock time
    text: str
    error: str = ""


class Notices:
    """The last notices, oldest first."""

    def __init__(self) -> None:
        self._kept: deque[Notice] = deque(maxlen=_KEPT)
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()

    def __iter__(self) -> Iterator[Notice]:
        return iter(list(self._kept))

    def add(self, text: str, error: str = "") -> None:
        """Append a notice, unless the last one has the same text and is recent."""
        now_s = time.time()
        with self._lock:
            last = self._kept[-1] if self._kept else None
            if last is None or last.text != text or now_s - last.at_s > _SAME_S:
                self._kept.append(Notice(next(self._numbers), now_s, text, error))


class ToNotices(logging.Handler):
    """Adds warnings of the log to the notices: errors of the board that no call raises."""

    def __init__(self, notices: Notices) -> None:
        super().__init__(logging.WARNING)
        self._notices = notices

    def emit(self, record: logging.LogRecord) -> None:
        self._notices.add(record.getMessage())
