"""Where network clients come in: a listening socket, the token that a wider network needs, one line for who may not.

Knows nothing of boards. What a client sends before it is let in is compared, never obeyed.
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
from mirrormount.network.client_session import Guest
from mirrormount.transport.first_bytes import FirstBytes
from mirrormount.transport.refusals import TOKEN_REFUSED, refusal_line
from mirrormount.transport.rejected import GRACE_S, Rejected
from mirrormount.transport.telnet import Inlet

TOKEN_S = 10.0  # how long a client may take to send its token: a person may be typing
_LINE_MOST = LONGEST + 2  # and how long that line may be
_CROWD = 64  # clients at the door at a time; more, and one of them goes
_BACKLOG = 8

_UNSENT = 1 << 14  # bytes on their way to a client, beside those that a Guest keeps
_LOST_AFTER = (10, 5, 3)  # a silent connection is probed after 10 s, then each 5 s; 3 times in vain, it is dead


def parse_where(text: str) -> tuple[str, int]:
    """HOST:PORT, or PORT on the loopback interface. Raises BadValue."""
    host, colon, port = text.rpartition(":")
    if not colon:
        host = "127.0.0.1"
    if not host or not (port.isascii() and port.isdecimal()) or int(port) > 65535:
        raise BadValue(f"--tcp is HOST:PORT, for instance 127.0.0.1:5023, not {text!r}")
    return host.strip("[]"), int(port)


class Door:
    """Listens at host and port (0: any that is free). Needs a token unless that is loopback.

    Raises BadAddress, CannotListen, TokenNeeded.
    """

    def __init__(self, host: str, port: int, token: bytes | None, *, telnet: bool) -> None:
        self._token = token
        self._telnet = telnet
        self._server = _listen(host, port, token)
        self._server.setblocking(False)
        self._asked: list[Guest] = []  # for their token
        self._guesses = Guesses()
        self._waiting: list[Guest] = []  # for the board to be free
        self._rejected = Rejected()
        name, number = self._server.getsockname()[:2]
        self.address = f"socket://[{name}]:{number}" if ":" in name else f"socket://{name}:{number}"

    def watched(self) -> list[socket.socket]:
        """Sockets that may have news."""
        return [self._server, *(guest.socket for guest in self._asked)]

    def busy(self) -> bool:
        """True if somebody's time may run out: look() again soon, news or not."""
        return bool(self._asked or self._waiting or self._rejected)

    def look(self) -> None:
        """Accept who has come, read their tokens, see off who is leaving."""
        self._accept()
        for guest in list(self._asked):
            self._ask(guest)
        self._rejected.poll()

    def next(self) -> Guest | None:
        """The next one to be let in."""
        return self._waiting.pop(0) if self._waiting else None

    def turn_away(self, line: bytes) -> None:
        """Tell those who have waited long enough that there is no place."""
        now = time.monotonic()
        for guest in [g for g in self._waiting if now - g.since_s > GRACE_S]:
            self._waiting.remove(guest)
            self._rejected.add(guest.socket, line)

    def close(self) -> None:
        """Listen no more, and close all who stand here."""
        self._server.close()
        for guest in self._asked + self._waiting:
            guest.socket.close()
        self._rejected.close()

    def _accept(self) -> None:
        try:
            client, peer = self._server.accept()
        except OSError:  # nobody, or gone already, or too many files are open
            return
        client.setblocking(False)
        _watch_over(client)
        guest = Guest(client, f"{peer[0]}:{peer[1]}", Inlet(self._telnet))
        guest.address = str(peer[0])
        guest.first = FirstBytes() if self._token is None else None  # a page has no token
        place = self._waiting if self._token is None else self._asked
        place.append(guest)
        if len(place) > _CROWD:
            goes = _who_goes(place)
            place.remove(goes)
            goes.socket.close()

    def _ask(self, guest: Guest) -> None:
        try:
            data = guest.socket.recv(_LINE_MOST)
        except BlockingIOError:
            data = None
        except OSError:
            data = b""
        if data == b"":
            self._asked.remove(guest)
            guest.socket.close()
            return
        guest.held += guest.inlet.feed(data or b"")
        line, end, rest = guest.held.partition(b"\n")
        late = time.monotonic() - guest.since_s > TOKEN_S
        if not end and not late and len(line) <= _LINE_MOST:
            return
        if end and not late and self._guesses.wait_s(guest.address):
            return  # its turn to guess comes
        self._asked.remove(guest)
        if end and not late and same(line.rstrip(b"\r"), self._token or b""):
            guest.held = rest
            guest.since_s = time.monotonic()
            self._waiting.append(guest)
        else:
            if end and not late:
                self._guesses.wrong(guest.address)
            self._rejected.add(guest.socket, refusal_line(TOKEN_REFUSED))


def _who_goes(crowd: list[Guest]) -> Guest:
    """Of too many the one who has proved least: has sent nothing, comes from where most do, has stood there longest.

    So whoever opens many connections closes his own ones, and not that of a slow client that has the token.
    """
    many = Counter(guest.address for guest in crowd)
    return min(crowd, key=lambda guest: (-many[guest.address], bool(guest.held), guest.since_s))


def _listen(host: str, port: int, token: bytes | None) -> socket.socket:
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError) as e:
        raise BadAddress(f"{host}: there is no such host to listen at") from e
    family, _, _, _, where = found[0]
    # what is looked at here is what is bound below: a name could mean something else the second time
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


def _watch_over(client: socket.socket) -> None:
    """Send small answers at once, and notice a client whose computer has vanished."""
    with contextlib.suppress(OSError):  # gone already: whoever reads from it will see
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNSENT)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in zip(("TCP_KEEPIDLE", "TCP_KEEPINTVL", "TCP_KEEPCNT"), _LOST_AFTER, strict=True):
            if hasattr(socket, name):
                client.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
