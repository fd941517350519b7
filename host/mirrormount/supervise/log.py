"""The last events in words, and the last lines on the wire, for all clients to show. Any thread may add and read."""

import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

# ---- events

_KEPT = 50  # notices
_SAME_S = 1.0  # The same text within this time is one event, for a STOP arrives by two ways.


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


# ---- lines on the wire

_KEPT_LINES = 2000
_LONGEST = 400  # bytes of a line; the rest of a longer one is the next line


@dataclass(frozen=True)
class Entry:
    """One line: a running number, the wall's time in seconds, to the board or from it, its text."""

    number: int
    at_s: float
    to_board: bool
    text: str
    poll: bool  # a question for the status or its answer, of which there are many every second


class WireLog:
    """Takes in bytes, gives lines. Any thread may write and read."""

    def __init__(self) -> None:
        self._entries: deque[Entry] = deque(maxlen=_KEPT_LINES)
        self._numbers = itertools.count(1)
        self._parts = {True: b"", False: b""}
        self._lock = threading.Lock()  # the brake writes to the board, too

    def add(self, data: bytes, *, to_board: bool) -> None:
        """Bytes that have just gone over the wire."""
        with self._lock:
            *lines, rest = (self._parts[to_board] + data).split(b"\n")
            if len(rest) > _LONGEST:
                lines, rest = [*lines, rest], b""
            self._parts[to_board] = rest
            for line in lines:
                self._line(line.rstrip(b"\r").decode("ascii", "backslashreplace"), to_board)

    def since(self, number: int) -> list[Entry]:
        """The lines after that number, oldest first."""
        return [entry for entry in list(self._entries) if entry.number > number]

    def _line(self, text: str, to_board: bool) -> None:
        poll = text == "XS?" if to_board else text.count("|") >= 2
        self._entries.append(Entry(next(self._numbers), time.time(), to_board, text, poll))
