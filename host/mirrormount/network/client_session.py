"""One network client of a served board: what it sent, and the answers that it has not taken yet."""

import contextlib
import socket
import time

from mirrormount.transport.first_bytes import FirstBytes
from mirrormount.transport.telnet import Inlet

_UNREAD_MOST = 1 << 16  # bytes of answers that may wait for it
_LINE_MOST = 4096  # a longer line is not the firmware's: its beginning is forgotten


class Guest:
    """A client, at the door or in control. held: what it sent after its token, for the board."""

    def __init__(self, client: socket.socket, name: str, inlet: Inlet) -> None:
        self.socket, self.name, self.inlet = client, name, inlet
        self.since_s = time.monotonic()
        self.held = b""
        self.address = ""  # where it comes from, without its port
        self.first: FirstBytes | None = None  # until it has shown that it is no web browser
        self.unread = bytearray()
        self._line = b""
        self._dropping = False

    def sent(self, data: bytes) -> bytes:
        """What of data is for the board. Raises NotAClient."""
        return self.inlet.feed(self.first.feed(data) if self.first else data)

    def answer(self, data: bytes) -> bool:
        """Queue answers of the board, whole lines only. True when it begins to drop them.

        A client that does not read loses answers, as it would on the board's own port, but it is not cut
        off: software that never reads the echoes of its frames is none the worse for it.
        """
        whole, end, self._line = (self._line + data).rpartition(b"\n")
        self._line = self._line[-_LINE_MOST:]
        dropped = len(self.unread) + len(whole) > _UNREAD_MOST
        begins = dropped and not self._dropping
        self._dropping = dropped
        if not dropped:
            self.unread += whole + end
        return begins

    def flush(self) -> None:
        """Hand over what the client takes now."""
        with contextlib.suppress(OSError):  # it does not read, or it has gone: recv() tells
            while self.unread:
                del self.unread[: self.socket.send(self.unread)]
