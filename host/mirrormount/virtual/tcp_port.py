"""A virtual board's port on loopback TCP."""

import contextlib
import socket
import time

from mirrormount.serve import GRACE_S, Client
from mirrormount.transport.lines import TAKEN
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
        self._client: Client | None = None
        self._begin()
        self._second: Client | None = None
        self._queued = False  # the second one came while the first was served
        self._waited = False  # the client has waited for another one, and was not served yet
        self._refused: list[Client] = []  # until they have closed
        self.address = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def _begin(self) -> None:
        """Forget the input of the client before."""
        self._waiting = Waiting()
        self._ended = False  # the client sends no more

    def watched(self) -> list[int]:
        self._accept()
        reads = self._client if not self._ended else None
        return [s.fileno() for s in (None if self._second else self._server, reads and reads.socket) if s]

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
            self._client.socket.close()
        self._client = None
        self._begin()

    def take(self, most: int, *, at_prompt: bool = False) -> bytes:
        if self._client and not self._ended:
            self._receive(self._client)
        data = self._waiting.take(most)
        if self._ended and not self._waiting.bytes:
            self._leave()
        return data

    def _receive(self, client: Client) -> None:
        self._waiting.add(client.receive())
        self._ended = bool(client.gone)
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
            return self._client.socket.send(data)
        except OSError:
            return 0

    def refuse(self, text: str) -> None:
        client, self._client = self._client, None
        self._begin()
        if client:
            client.refuse(text)
            self._refused.append(client)

    def waits_in_vain(self) -> None:
        self._waited = self._client is not None

    def close(self) -> None:
        for client in (self._client, self._second, *self._refused):
            if client:
                client.socket.close()
        self._server.close()

    def _accept(self) -> None:
        if not self._second:
            with contextlib.suppress(BlockingIOError):
                self._second = Client(self._server.accept()[0])
                self._queued = self._client is not None
        if self._second and not self._client:
            self._client, self._second = self._second, None
            self._begin()
            self._waited = self._queued
            self._queued = False
        elif self._second and time.monotonic() - self._second.since_s > GRACE_S:
            self._second.refuse(TAKEN)
            self._refused.append(self._second)
            self._second = None
        for client in list(self._refused):
            client.receive()
            if client.gone:
                client.socket.close()
                self._refused.remove(client)
