"""What has happened, in words, for all pages: the last of it. Any thread may add and read."""

import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

_KEPT = 50
_SAME_S = 1.0  # the same text within this time is one event: a STOP comes two ways at once


@dataclass(frozen=True)
class Notice:
    """Something that has happened. error: the number (board) or the type (host) of it, or ""."""

    number: int
    at_s: float  # the wall's time
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
        """Keep it, unless it is what was added a moment ago."""
        now_s = time.time()
        with self._lock:
            last = self._kept[-1] if self._kept else None
            if last is None or last.text != text or now_s - last.at_s > _SAME_S:
                self._kept.append(Notice(next(self._numbers), now_s, text, error))


class ToNotices(logging.Handler):
    """What the client logs and raises nowhere: errors of the board that waited from before."""

    def __init__(self, notices: Notices) -> None:
        super().__init__(logging.WARNING)
        self._notices = notices

    def emit(self, record: logging.LogRecord) -> None:
        self._notices.add(record.getMessage())
