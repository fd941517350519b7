"""The virtual board in real time, for hosts on a pty, on loopback TCP, or in this process.

One client at a time: whoever comes while another is served is told so in one line. A client that
does not read makes the board's output wait, and what it left unread is there for the next one,
as on a USB port.
"""

import contextlib
import os
import select
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from mirrormount.first_bytes import FirstBytes, NotAClient
from mirrormount.guest import acknowledge
from mirrormount.telnet import Inlet
from mirrormount.turned_away import AT_PROMPT_LINE, GRACE_S, TAKEN_LINE, TurnedAway
from mirrormount.virtual.world import World

_QUANTUM_US = 1000  # a busy firmware never leads the wall's clock by more
_BUFFER = 512  # bytes that a board takes in before its host has to wait
_UNREAD = 512  # bytes of output that wait in the board before it says that nobody collects
_HANGUP_S = 0.02  # how often to look whether somebody has opened the pty
_LAG_US = 100_000  # by how much virtual time may fall behind before it gives up catching up


class Port(Protocol):
    """A place where a client may be."""

    @property
    def address(self) -> str: ...

    def watched(self) -> list[int]:
        """File descriptors that may have news."""
        ...

    def take(self, most: int) -> bytes:
        """What the client sent; must not block."""
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
    """A pseudo-terminal of this user alone, under a symlink if one is asked for. POSIX only."""

    prompt = True

    def __init__(self, link: Path | None = None) -> None:
        import pty
        import tty

        self._openpty, self._setraw = pty.openpty, tty.setraw
        self._link = link
        self._told = False
        self._master = -1
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
        return here

    def take(self, most: int) -> bytes:
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
        while self.take(4096):  # or it would be obeyed later
            pass
        if not self._told and self.connected():
            self.give(line)
            self._told = True

    def close(self) -> None:
        if self._link and self._link.is_symlink() and os.readlink(self._link) == self._name:
            self._link.unlink()
        if self._master >= 0:
            os.close(self._master)
            self._master = -1


class TcpPort:
    """A listening socket on the loopback interface, for commands: anybody on this computer can reach it, and so can
    a web page. So it has no prompt and none of its keys (Ctrl-C is a stop), and a web browser is not let in.

    A newcomer waits a moment before he is turned away: the client before him may just have gone
    without our having seen it.
    """

    prompt = False

    def __init__(self, port: int) -> None:
        self._server = socket.create_server(("127.0.0.1", port))
        self._first, self._inlet = FirstBytes(), Inlet(telnet=False)
        self._server.setblocking(False)
        self._client: socket.socket | None = None
        self._newcomer: socket.socket | None = None
        self._since = 0.0
        self._away = TurnedAway()
        self.address = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def watched(self) -> list[int]:
        self._accept()
        return [s.fileno() for s in (None if self._newcomer else self._server, self._client) if s]

    def connected(self) -> bool:
        return self._client is not None

    def plug(self, there: bool) -> None:
        if not there and self._client:
            self._client.close()
            self._client = None

    def take(self, most: int) -> bytes:
        if not self._client:
            return b""
        try:
            data = self._client.recv(most)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        acknowledge(self._client)
        if data:
            with contextlib.suppress(NotAClient):
                return self._inlet.feed(self._first.feed(data))
        self._client.close()
        self._client = None
        return b""

    def give(self, data: bytes) -> int:
        if not self._client:
            return 0
        try:
            return self._client.send(data)
        except OSError:
            return 0

    def refuse(self, line: bytes) -> None:
        client, self._client = self._client, None
        if client:
            self._away.add(client, line)

    def close(self) -> None:
        for s in (self._client, self._newcomer):
            if s:
                s.close()
        self._away.close()
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
            self._first, self._inlet = FirstBytes(), Inlet(telnet=False)
        elif self._newcomer and time.monotonic() - self._since > GRACE_S:
            self._away.add(self._newcomer, TAKEN_LINE)
            self._newcomer = None
        self._away.look()


class PairPort:
    """One end of a socket pair whose other end is in this process."""

    prompt = True

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

    def take(self, most: int) -> bytes:
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


def serve(world: World, ports: Sequence[Port], stopped: Callable[[], bool]) -> None:
    """Let the board live in real time on these ports until stopped() says so.

    Raises BoardGone when the firmware's process has ended.
    """
    unread = bytearray()
    world.on_sent = unread.append
    start_us, start_s = world.now_us, time.monotonic()
    choice = _Choice(ports)

    def wall_us() -> int:
        return start_us + int((time.monotonic() - start_s) * 1e6)

    plugged = True
    while not stopped():
        wants_us = world.next_event_us(world.next_wait())
        now_us = world.now_us
        if wall_us() - now_us > _LAG_US:  # a slow machine: its time goes slower than the wall's
            start_us -= wall_us() - now_us
        if world.usb != plugged:
            plugged = world.usb
            for port in ports:
                port.plug(plugged)
        client = choice.look(world.at_prompt)
        world.opened(client is not None)
        if client and unread:
            del unread[: client.give(bytes(unread))]
        room = _BUFFER - world.waiting_in
        wait_s = max(0.0, (now_us + wants_us - wall_us()) * 1e-6)
        watched = [fd for port in ports for fd in port.watched()] if room > 0 else []
        _wait(watched, min(wait_s, _HANGUP_S) if client is None or unread else wait_s)
        client = choice.look(world.at_prompt)
        world.opened(client is not None)  # before the first byte of somebody who has just come
        data = client.take(room) if client and room > 0 else b""
        t = max(now_us, min(now_us + wants_us, wall_us()))
        world.collects(len(unread) < _UNREAD)
        world.go(t, max(0, wall_us() - t) + _QUANTUM_US, data)


class _Choice:
    """Which port's client is served: the present one while it is there, else the next to come.

    Whoever comes to another port meanwhile waits a moment, for the present one may just have gone
    without our having seen it; then he is told.
    """

    def __init__(self, ports: Sequence[Port]) -> None:
        self._ports = ports
        self._waiting: dict[Port, float] = {}
        self.client: Port | None = None

    def look(self, at_prompt: bool) -> Port | None:
        if at_prompt:
            for port in self._ports:
                if not port.prompt and port.connected():
                    port.refuse(AT_PROMPT_LINE)
        if self.client is None or not self.client.connected():
            self.client = next((port for port in self._ports if port.connected()), None)
        for port in self._ports:
            if port is self.client or not port.connected():
                self._waiting.pop(port, None)
            elif time.monotonic() - self._waiting.setdefault(port, time.monotonic()) > GRACE_S:
                port.refuse(TAKEN_LINE)
        return self.client


def _wait(watched: list[int], seconds: float) -> None:
    if watched:
        select.select(watched, [], [], seconds)
    else:
        time.sleep(seconds)
