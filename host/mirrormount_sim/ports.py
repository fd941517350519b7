"""A virtual board's ports in real time: their interface, and those in this process, on a pty and on loopback TCP."""

import contextlib
import os
import select
import socket
import time
from pathlib import Path
from typing import Protocol

from mirrormount.serve import GRACE_S, Client
from mirrormount.transport.link import TAKEN, refusal_line

BUFFER = 512  # bytes in the board's input before the host has to wait
WAITING_MOST = 1 << 20  # bytes of a client that may wait for the board


class Waiting:
    """Received bytes that the board has no room for. A stop overtakes them, and makes those before it void."""

    def __init__(self) -> None:
        self.bytes = bytearray()

    def add(self, data: bytes) -> None:
        """Append received bytes."""
        waited = len(self.bytes)
        self.bytes += data
        stop = max(self.bytes.rfind(b"!", waited), self.bytes.rfind(b"00000000", max(0, waited - 7)))
        stop = max(stop, self.bytes.rfind(b"\x03", waited))  # Ctrl-C: it turns off as well
        if stop > BUFFER:
            self.bytes[:stop] = b"!\n"  # the board may be in the middle of a message: this ends it

    def keep_stop(self) -> None:
        """Of what waits only a stop counts: who wrote it has left without having been served."""
        stops = any(stop in self.bytes for stop in (b"!", b"00000000", b"\x03"))
        self.bytes[:] = b"!\n" if stops else b""

    def take(self, most: int) -> bytes:
        """The next bytes for the board."""
        data = bytes(self.bytes[:most])
        del self.bytes[:most]
        return data


class Port(Protocol):
    """A port for one client. No method blocks."""

    @property
    def address(self) -> str: ...

    def watched(self) -> list[int]:
        """File descriptors to wait for."""
        ...

    def take(self, most: int, *, at_prompt: bool = False) -> bytes:
        """Received bytes: commands, or Python while the board is at its prompt."""
        ...

    @property
    def waits(self) -> bool:
        """True if take() returns bytes although no file descriptor is readable."""
        ...

    def give(self, data: bytes) -> int:
        """Send bytes to the client. Returns how many were sent."""
        ...

    def connected(self) -> bool: ...

    def plug(self, there: bool) -> None:
        """The board's USB is there, or not any more."""
        ...

    def refuse(self, text: str) -> None:
        """Send the text as a line to a client of this port and drop its input: another port's client is served."""
        ...

    def waits_in_vain(self) -> None:
        """Another port's client is served. If this port's has left meanwhile, only a stop of its input counts."""
        ...

    @property
    def prompt(self) -> bool:
        """True if clients of this port may use the board's Python prompt."""
        ...

    def close(self) -> None: ...


class PairPort:
    """One end of a socket pair whose other end is in this process."""

    prompt = True
    waits = False

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        end.setblocking(False)
        self.address = "virtual://"

    def watched(self) -> list[int]:
        return [self._end.fileno()] if self.connected() else []

    def connected(self) -> bool:
        return self._end.fileno() >= 0

    def plug(self, there: bool) -> None:
        if not there:
            self._end.close()

    def take(self, most: int, *, at_prompt: bool = False) -> bytes:
        try:
            return self._end.recv(most)
        except OSError:
            return b""

    def give(self, data: bytes) -> int:
        try:
            return self._end.send(data)
        except OSError:
            return 0

    def refuse(self, text: str) -> None:
        pass

    def waits_in_vain(self) -> None:
        pass

    def close(self) -> None:
        self._end.close()


class PtyPort:
    """A pseudo-terminal of this user alone, under a symlink if one is asked for. POSIX only.

    The bytes that the system would buffer (64 KB) are read at once and wait here, so that a stop overtakes them.
    """

    prompt = True

    def __init__(self, link: Path | None = None) -> None:
        import pty
        import tty

        self._openpty, self._setraw = pty.openpty, tty.setraw
        self._link = link
        self._refused = False
        self._master = -1
        self._waiting = Waiting()
        self._open()
        self.address = str(link or self._name)

    def _open(self) -> None:
        self._master, slave = self._openpty()
        self._setraw(slave)
        self._name = os.ttyname(slave)
        os.fchmod(slave, 0o600)  # the board's prompt is behind it
        os.close(slave)
        os.set_blocking(self._master, False)
        self._poll = select.poll()
        self._poll.register(self._master, select.POLLIN)
        if self._link:
            with contextlib.suppress(FileNotFoundError):
                if self._link.is_symlink():
                    self._link.unlink()
            self._link.symlink_to(self._name)

    def plug(self, there: bool) -> None:
        if there and self._master < 0:
            self._open()
        elif not there and self._link:  # without a link a new name would be unknown
            self.close()

    def watched(self) -> list[int]:
        return [self._master] if self.connected() else []

    def connected(self) -> bool:
        if self._master < 0:
            return False
        # a client that wrote and left at once counts: its bytes may be a stop
        here = all(event & select.POLLIN or not event & select.POLLHUP for _, event in self._poll.poll(0))
        self._refused = self._refused and here
        return here or self.waits

    @property
    def waits(self) -> bool:
        return bool(self._waiting.bytes)

    def take(self, most: int, *, at_prompt: bool = False) -> bytes:
        if at_prompt:
            return self._waiting.take(most) or self._read(most)
        while len(self._waiting.bytes) <= WAITING_MOST and (data := self._read(1 << 16)):
            self._waiting.add(data)
        if len(self._waiting.bytes) > WAITING_MOST:  # too much to find a stop behind it in time
            self._waiting.bytes[:] = b"!?"  # malformed: the rest of a message that is cut here is not executed
        return self._waiting.take(most)

    def _read(self, most: int) -> bytes:
        try:
            return os.read(self._master, most)
        except OSError:  # no bytes, or the client has just left
            return b""

    def give(self, data: bytes) -> int:
        try:
            return os.write(self._master, data)
        except OSError:
            return 0

    def refuse(self, text: str) -> None:
        while self._read(4096):  # or it would be executed later
            pass
        self._waiting = Waiting()
        if not self._refused and self.connected():
            self.give(refusal_line(text))
            self._refused = True

    def waits_in_vain(self) -> None:
        if any(event & select.POLLHUP for _, event in self._poll.poll(0)):
            while data := self._read(1 << 16):
                self._waiting.add(data)
            self._waiting.keep_stop()

    def close(self) -> None:
        if self._link and self._link.is_symlink() and os.readlink(self._link) == self._name:
            self._link.unlink()
        self._waiting = Waiting()
        if self._master >= 0:
            os.close(self._master)
            self._master = -1


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
