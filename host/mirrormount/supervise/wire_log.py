"""The last lines of both directions of the wire, for people to read. Imports nothing of ours."""

import itertools
import threading
import time
from collections import deque
from dataclasses import dataclass

_KEPT = 2000  # lines
_LONGEST = 400  # bytes of one line


@dataclass(frozen=True)
class Entry:
    """One line: a running number, the wall's time in seconds, to the board or from it, its text."""

    number: int
    at_s: float
    to_board: bool
    text: str
    poll: bool  # it asks for the state, or tells it: what the panel does many times a second


class WireLog:
    """Takes in bytes, gives lines. Any thread may write and read."""

    def __init__(self) -> None:
        self._entries: deque[Entry] = deque(maxlen=_KEPT)
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
