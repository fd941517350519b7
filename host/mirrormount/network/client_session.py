"""One network client of a served board: its bytes for the board, and the replies that it has not read yet."""

import contextlib
import socket
import time

from mirrormount.transport.first_bytes import FirstBytes
from mirrormount.transport.telnet import Inlet

_UNREAD_MOST = 1 << 16  # bytes of replies that may wait for it
_LINE_MOST = 4096  # a longer line is not the firmware's: its beginning is forgotten


class ClientSession:
    """A client, waiting or in control. pending: bytes for the board, received after its token."""

    def __init__(self, client: socket.socket, name: str, inlet: Inlet) -> None:
        self.socket, self.name, self.inlet = client, name, inlet
        self.since_s = time.monotonic()
        self.pending = b""
        self.address = ""  # of its computer, without the port
        self.first: FirstBytes | None = None  # until it has shown that it is no web browser
        self.unread = bytearray()
        self._line = b""
        self._dropping = False

    def sent(self, data: bytes) -> bytes:
        """The part of data that is for the board. Raises NotAClient."""
        return self.inlet.feed(self.first.feed(data) if self.first else data)

    def answer(self, data: bytes) -> bool:
        """Queue replies of the board, whole lines only. True when dropping begins.

        A client that does not read loses replies, as on the board's own port. It is not disconnected: some software
        never reads the echoes of its frames.
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
        """Send as much as the client's socket accepts now."""
        with contextlib.suppress(OSError):  # it does not read, or it has gone: recv() tells
            while self.unread:
                del self.unread[: self.socket.send(self.unread)]
