"""Splits a stream of bytes into the board's messages, and parses its command lines. No I/O.

The parser is the firmware's own, so that host and board split the same bytes in the same way.
"""

from collections.abc import Iterator
from typing import NamedTuple

from mountfw.dialect.line import COMMAND, QUERY, Line, key
from mountfw.wire.frame import Frame, pack
from mountfw.wire.receiver import FRAME, LINE, NEED_BYTES, Receiver

__all__ = ["FRAME", "LINE", "NEED_BYTES", "Command", "Messages"]


class Command(NamedTuple):
    """A command of a line. axis is 0 if there was none; value is 0 if it was no number."""

    axis: int
    name: int
    is_query: bool
    value: int

    def is_a(self, *names: bytes) -> bool:
        """True if its name is one of these mnemonics."""
        return self.name in [key(name) for name in names]


class Messages:
    """Follows a stream. frame and line are those of the last message that was one."""

    def __init__(self) -> None:
        self._frame, self._line = Frame(pack), Line()
        self._receiver = Receiver(self._frame, self._line, pack, 64)

    def feed(self, c: int) -> int:
        """Parse a byte. Returns the kind of the message that it ends, or NEED_BYTES."""
        self._receiver.receive(c)
        message = NEED_BYTES
        while self._receiver.waits():
            message = self._receiver.next() or message
        return message

    @property
    def gap_s(self) -> float:
        """The longest silence before the board drops the unfinished message; 0 between messages."""
        return self._receiver.gap_us() * 1e-6

    def gap(self) -> None:
        """The board has dropped the unfinished message: drop it here."""
        self._receiver.gap()

    def frame_drives(self) -> bool:
        """True if the last frame drives a motor."""
        return any(c not in b"0+-" for c in self._frame.text)

    def address(self) -> bytes:
        """The last line's address with its `>`, or nothing."""
        return bytes(self._line.text[: self._line.address_length])

    def commands(self) -> Iterator[Command]:
        """The commands of the last line."""
        line = self._line
        line.rewind()
        while line.more():
            if line.advance() == COMMAND and line.name:
                yield Command(max(line.axis, 0), line.name, line.kind == QUERY, line.rounded())
