"""Where the clients of a virtual board in real time come in: a pty, loopback TCP, or a socket in this process."""

import contextlib
import os
import select
import socket
import time
from pathlib import Path
from typing import Protocol

from mirrormount.transport.first_bytes import FirstBytes, NotAClient
from mirrormount.transport.refusals import TAKEN, refusal_line
from mirrormount.transport.rejected import GRACE_S, Rejected
from mirrormount.transport.tcp_port import acknowledge
from mirrormount.transport.telnet import Inlet

BUFFER = 512  # bytes that a board takes in before its host has to wait
_WAITING_MOST = 1 << 20  # bytes of a client that may wait for the board


class Waiting:
    """What a client has sent and the board has no room for. A stop overtakes it, and what waited before it is void."""

    def __init__(self) -> None:
        self.bytes = bytearray()

    def add(self, data: bytes) -> None:
        """Put commands in line."""
        waited = len(self.bytes)
        self.bytes += data
        stop = max(self.bytes.rfind(b"!", waited), self.bytes.rfind(b"00000000", max(0, waited - 7)))
        stop = max(stop, self.bytes.rfind(b"\x03", waited))  # Ctrl-C: it turns off as well
        if stop > BUFFER:
            self.bytes[:stop] = b"!\n"  # the board may be in the middle of a message: this ends it

    def take(self, most: int) -> bytes:
        """The next bytes for the board."""
        data = bytes(self.bytes[:most])
        del self.bytes[:most]
        return data


class Port(Protocol):
    """A place where a client may be."""

    @property
    def address(self) -> str: ...

    def watched(self) -> list[int]:
        """File descriptors that may have news."""
        ...

    def take(self, most: int, *, at_prompt: bool = False) -> bytes:
        """What the client sent: commands, or Python while the board is at its prompt. Must not block."""
        ...

    @property
    def waits(self) -> bool:
        """Has the client sent something that take() gives without its being in the news?"""
        ...

    def give(self, data: bytes) -> int:
        """Hand bytes to the client; says how many it took. Must not block."""
        ...

    def connected(self) -> bool: ...

    def plug(self, there: bool) -> None:
        """The board's USB has come or gone."""
        ...

    def refuse(self, line: bytes) -> None:
        """Another port has the client, or this one is not for what the board does now: say the line to who is here."""
        ...

    @property
    def prompt(self) -> bool:
        """Is the board's Python prompt for whoever comes here?"""
        ...

    def close(self) -> None: ...


class PtyPort:
    """A pseudo-terminal of this user alone, under a symlink if one is asked for. POSIX only.

    What the system would keep in a pty (64 KB) is read at once and waits here, so that a stop overtakes it.
    """

    prompt = True

    def __init__(self, link: Path | None = None) -> None:
        import pty
        import tty

        self._openpty, self._setraw = pty.openpty, tty.setraw
        self._link = link
        self._told = False
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
        elif not there and self._link:  # without a link nobody could find the next one
            self.close()

    def watched(self) -> list[int]:
        return [self._master] if self.connected() else []

    def connected(self) -> bool:
        if self._master < 0:
            return False
        # whoever wrote and left at once still counts: it may have been a stop
        here = all(event & select.POLLIN or not event & select.POLLHUP for _, event in self._poll.poll(0))
        self._told = self._told and here
        return here or self.waits

    @property
    def waits(self) -> bool:
        return bool(self._waiting.bytes)

    def take(self, most: int, *, at_prompt: bool = False) -> bytes:
        if at_prompt:
            return self._waiting.take(most) or self._read(most)
        while len(self._waiting.bytes) <= _WAITING_MOST and (data := self._read(1 << 16)):
            self._waiting.add(data)
        if len(self._waiting.bytes) > _WAITING_MOST:  # too much for a stop behind it to be seen in time
            self._waiting.bytes[:] = b"!?"  # malformed, so the rest of the message that is cut here is not obeyed
        return self._waiting.take(most)

    def _read(self, most: int) -> bytes:
        try:
            return os.read(self._master, most)
        except OSError:  # nothing waits, or the client has just left
            return b""

    def give(self, data: bytes) -> int:
        try:
            return os.write(self._master, data)
        except OSError:
            return 0

    def refuse(self, line: bytes) -> None:
        while self._read(4096):  # or it would be obeyed later
            pass
        self._waiting = Waiting()
        if not self._told and self.connected():
            self.give(line)
            self._told = True

    def close(self) -> None:
        if self._link and self._link.is_symlink() and os.readlink(self._link) == self._name:
            self._link.unlink()
        self._waiting = Waiting()
        if self._master >= 0:
            os.close(self._master)
            self._master = -1


class TcpPort:
    """A listening socket on the loopback interface, for commands: anybody on this computer can reach it, and so can
    a web page. So it has no prompt and none of its keys (Ctrl-C is a stop), and a web browser is not let in.

    What the board has no room for waits here. A stop overtakes it, and what waited before the stop is void.

    A newcomer waits a moment before he is turned away: the client before him may just have gone
    without our having seen it.
    """

    prompt = False

    def __init__(self, port: int) -> None:
        self._server = socket.create_server(("127.0.0.1", port))
        self._server.setblocking(False)
        self._client: socket.socket | None = None
        self._begin()
        self._newcomer: socket.socket | None = None
        self._since = 0.0
        self._rejected = Rejected()
        self.address = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def _begin(self) -> None:
        """Nothing was sent yet."""
        self._first, self._inlet = FirstBytes(), Inlet(telnet=False)
        self._waiting = Waiting()
        self._ended = False  # the client will send no more

    def watched(self) -> list[int]:
        self._accept()
        hears = self._client if not self._ended else None
        return [s.fileno() for s in (None if self._newcomer else self._server, hears) if s]

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
        while not self._ended and received <= _WAITING_MOST:  # all there is: its last may be a stop
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
        if len(self._waiting.bytes) > _WAITING_MOST:  # too much for a stop behind it to be seen in time
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

    def close(self) -> None:
        for s in (self._client, self._newcomer):
            if s:
                s.close()
        self._rejected.close()
        self._server.close()

    def _accept(self) -> None:
        if not self._newcomer:
            with contextlib.suppress(BlockingIOError):
                self._newcomer, _ = self._server.accept()
                self._newcomer.setblocking(False)
                self._newcomer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._since = time.monotonic()
        if self._newcomer and not self._client:
            self._client, self._newcomer = self._newcomer, None
            self._begin()
        elif self._newcomer and time.monotonic() - self._since > GRACE_S:
            self._rejected.add(self._newcomer, refusal_line(TAKEN))
            self._newcomer = None
        self._rejected.poll()


class PairPort:
    """One end of a socket pair whose other end is in this process."""

    prompt = True
    waits = False

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        end.setblocking(False)
        self.address = "virtual://"

    def watched(self) -> list[int]:
        return [self._end.fileno()]

    def connected(self) -> bool:
        return True

    def plug(self, there: bool) -> None:
        pass

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

    def refuse(self, line: bytes) -> None:
        pass

    def close(self) -> None:
        self._end.close()
