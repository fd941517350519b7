"""Accepts network clients: a listening socket, the token for addresses beyond loopback, one line to rejected clients.

Knows no board. Bytes from a client before its admission are compared with the token, never executed.
"""

import contextlib
import errno
import ipaddress
import os
import socket
import time
from collections import Counter

from mirrormount.common.errors import BadAddress, BadValue, CannotListen, TokenNeeded
from mirrormount.common.tokens import LONGEST, Guesses, same
from mirrormount.common.validation import host_and_port
from mirrormount.network.client_session import ClientSession
from mirrormount.transport.first_bytes import FirstBytes
from mirrormount.transport.refusals import TOKEN_REFUSED, refusal_line
from mirrormount.transport.rejected import GRACE_S, Rejected
from mirrormount.transport.telnet import Inlet

TOKEN_S = 10.0  # until a client must have sent its token, which may be typed
_LINE_MOST = LONGEST + 2  # the longest line with a token
_NEWCOMERS_MOST = 64  # clients that wait at a time; beyond that, one is disconnected
_BACKLOG = 8

_UNSENT = 1 << 14  # bytes that the system buffers for a client, beside those of its ClientSession
_LOST_AFTER = (10, 5, 3)  # a silent connection is probed after 10 s, then each 5 s; 3 times in vain, it is dead


def parse_where(text: str) -> tuple[str, int]:
    """HOST:PORT, or PORT on the loopback interface. Raises BadValue."""
    try:
        return host_and_port(text, "127.0.0.1")
    except BadValue:
        raise BadValue(f"--tcp is HOST:PORT, for instance 127.0.0.1:5023, not {text[:80]!r}") from None


class Listener:
    """Listens at host and port (0: any that is free). Needs a token unless that is loopback.

    Raises BadAddress, CannotListen, TokenNeeded.
    """

    def __init__(self, host: str, port: int, token: bytes | None, *, telnet: bool) -> None:
        self._token = token
        self._telnet = telnet
        self._server = _listen(host, port, token)
        self._server.setblocking(False)
        self._unauthenticated: list[ClientSession] = []  # without a valid token yet
        self._guesses = Guesses()
        self._waiting: list[ClientSession] = []  # until the board is free
        self._rejected = Rejected()
        name, number = self._server.getsockname()[:2]
        self.address = f"socket://[{name}]:{number}" if ":" in name else f"socket://{name}:{number}"

    def watched(self) -> list[socket.socket]:
        """Sockets to wait for."""
        return [self._server, *(session.socket for session in self._unauthenticated)]

    def busy(self) -> bool:
        """True if a time limit is running: poll() again soon, with or without events."""
        return bool(self._unauthenticated or self._waiting or self._rejected)

    def poll(self) -> None:
        """Accept new clients, read tokens, close rejected ones."""
        self._accept()
        for session in list(self._unauthenticated):
            self._read_token(session)
        self._rejected.poll()

    def next(self) -> ClientSession | None:
        """The next client to be admitted, or None."""
        return self._waiting.pop(0) if self._waiting else None

    def reject_waiting(self, line: bytes) -> None:
        """Reject clients that have waited longer than GRACE_S, with this line."""
        now = time.monotonic()
        for session in [g for g in self._waiting if now - g.since_s > GRACE_S]:
            self._waiting.remove(session)
            self._rejected.add(session.socket, line)

    def close(self) -> None:
        """Stop listening, and close all clients that wait."""
        self._server.close()
        for session in self._unauthenticated + self._waiting:
            session.socket.close()
        self._rejected.close()

    def _accept(self) -> None:
        try:
            client, peer = self._server.accept()
        except OSError:  # none, or gone already, or too many files are open
            return
        client.setblocking(False)
        _set_options(client)
        session = ClientSession(client, f"{peer[0]}:{peer[1]}", Inlet(self._telnet))
        session.address = str(peer[0])
        session.first = FirstBytes() if self._token is None else None  # a page has no token
        place = self._waiting if self._token is None else self._unauthenticated
        place.append(session)
        if len(place) > _NEWCOMERS_MOST:
            goes = _least_proven(place)
            place.remove(goes)
            goes.socket.close()

    def _read_token(self, session: ClientSession) -> None:
        try:
            data = session.socket.recv(_LINE_MOST)
        except BlockingIOError:
            data = None
        except OSError:
            data = b""
        if data == b"":
            self._unauthenticated.remove(session)
            session.socket.close()
            return
        session.pending += session.inlet.feed(data or b"")
        line, end, rest = session.pending.partition(b"\n")
        late = time.monotonic() - session.since_s > TOKEN_S
        if not end and not late and len(line) <= _LINE_MOST:
            return
        if end and not late and self._guesses.wait_s(session.address):
            return  # guesses from its address are delayed
        self._unauthenticated.remove(session)
        if end and not late and same(line.rstrip(b"\r"), self._token or b""):
            session.pending = rest
            session.since_s = time.monotonic()
            self._waiting.append(session)
        else:
            if end and not late:
                self._guesses.wrong(session.address)
            self._rejected.add(session.socket, refusal_line(TOKEN_REFUSED))


def _least_proven(crowd: list[ClientSession]) -> ClientSession:
    """The client to disconnect when there are too many: of the address with most, without bytes sent, waiting longest.

    A computer that opens many connections so closes its own, not that of a slow client with the token.
    """
    many = Counter(session.address for session in crowd)
    return min(crowd, key=lambda session: (-many[session.address], bool(session.pending), session.since_s))


def _listen(host: str, port: int, token: bytes | None) -> socket.socket:
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError) as e:
        raise BadAddress(f"{host}: there is no such host to listen at") from e
    family, _, _, _, where = found[0]
    # the address that is checked is the one that is bound: a name could resolve differently the second time
    if token is None and not ipaddress.ip_address(str(where[0]).partition("%")[0]).is_loopback:
        raise TokenNeeded(
            f"{host} is more than this computer, and whoever reaches it could drive the mount: give --token TOKEN"
            " (or MIRRORMOUNT_TOKEN), or listen on 127.0.0.1"
        )
    try:
        return socket.create_server((str(where[0]), port), family=family, backlog=_BACKLOG)
    except OSError as e:
        raise CannotListen(f"cannot listen on {host}:{port}: {_why(e)}") from e


def _why(e: OSError) -> str:
    other = "take another port, for instance --tcp 127.0.0.1:5023"
    if e.errno in (errno.EACCES, errno.EPERM):
        return f"this user may not use that port (below 1024 it takes an administrator): {other}"
    if e.errno == errno.EADDRINUSE:
        return f"another program listens there: {other}"
    return f"{os.strerror(e.errno or 0)}: {other}"


def _set_options(client: socket.socket) -> None:
    """Send small replies at once, and detect a client whose computer is gone."""
    with contextlib.suppress(OSError):  # gone already: the next read shows it
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNSENT)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in zip(("TCP_KEEPIDLE", "TCP_KEEPINTVL", "TCP_KEEPCNT"), _LOST_AFTER, strict=True):
            if hasattr(socket, name):
                client.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
