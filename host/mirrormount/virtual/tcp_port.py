"""A virtual board's port on loopback TCP."""

import contextlib
import socket
import time

from mirrormount.transport.first_bytes import FirstBytes, NotAClient
from mirrormount.transport.refusals import TAKEN, refusal_line
from mirrormount.transport.rejected import GRACE_S, Rejected
from mirrormount.transport.tcp_port import acknowledge
from mirrormount.transport.telnet import Inlet
from mirrormount.virtual.ports import WAITING_MOST, Waiting


class TcpPort:
    """A listening socket on the loopback interface, for commands. Any user of this computer can connect, and so can
    a web page: therefore it has no prompt and none of its keys (Ctrl-C is a stop), and a web browser is rejected.

    Bytes that the board has no room for wait here. A stop overtakes them, and makes those before it void.
    A second client is rejected after GRACE_S only: the first one may have disconnected unnoticed.
    """

    prompt = False

    def __init__(self, port: int) -> None:
        self._server = socket.create_server(("127.0.0.1", port))
        self._server.setblocking(False)
        self._client: socket.socket | None = None
        self._begin()
        self._second: socket.socket | None = None
        self._since = 0.0
        self._queued = False  # the second one came while the first was served
        self._waited = False  # the client has waited for another one, and was not served yet
        self._rejected = Rejected()
        self.address = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def _begin(self) -> None:
        """Forget the input of the client before."""
        self._first, self._inlet = FirstBytes(), Inlet(telnet=False)
        self._waiting = Waiting()
        self._ended = False  # the client sends no more

    def watched(self) -> list[int]:
        self._accept()
        reads = self._client if not self._ended else None
        return [s.fileno() for s in (None if self._second else self._server, reads) if s]

    @property
    def waits(self) -> bool:
        return bool(self._waiting.bytes) or self._ended

    def connected(self) -> bool:
        return self._client is not None

    def plug(self, there: bool) -> None:
        if not there:
            self._leave()

    def _leave(self) -> None:
        if self._client:
            self._client.close()
        self._client = None
        self._begin()

    def take(self, most: int, *, at_prompt: bool = False) -> bytes:
        if self._client and not self._ended:
            self._receive(self._client)
        data = self._waiting.take(most)
        if self._ended and not self._waiting.bytes:
            self._leave()
        return data

    def _receive(self, client: socket.socket) -> None:
        received = 0
        while not self._ended and received <= WAITING_MOST:  # everything received: the last byte may be a stop
            try:
                data = client.recv(1 << 16)
                received += len(data)
                acknowledge(client)
                self._waiting.add(self._inlet.feed(self._first.feed(data)))
            except BlockingIOError:
                break
            except (OSError, NotAClient):
                data = b""
            self._ended = not data
        if self._ended and self._waited:
            self._waiting.keep_stop()
        self._waited = False
        if len(self._waiting.bytes) > WAITING_MOST:  # too much to find a stop behind it in time
            self._waiting.bytes[:] = b"!\n"
            self._ended = True

    def give(self, data: bytes) -> int:
        if not self._client:
            return 0
        try:
            return self._client.send(data)
        except OSError:
            return 0

    def refuse(self, line: bytes) -> None:
        client, self._client = self._client, None
        self._begin()
        if client:
            self._rejected.add(client, line)

    def waits_in_vain(self) -> None:
        self._waited = self._client is not None

    def close(self) -> None:
        for s in (self._client, self._second):
            if s:
                s.close()
        self._rejected.close()
        self._server.close()

    def _accept(self) -> None:
        if not self._second:
            with contextlib.suppress(BlockingIOError):
                self._second, _ = self._server.accept()
                self._second.setblocking(False)
                self._second.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._since = time.monotonic()
                self._queued = self._client is not None
        if self._second and not self._client:
            self._client, self._second = self._second, None
            self._begin()
            self._waited = self._queued
            self._queued = False
        elif self._second and time.monotonic() - self._since > GRACE_S:
            self._rejected.add(self._second, refusal_line(TAKEN))
            self._second = None
        self._rejected.poll()
