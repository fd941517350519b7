"""Clients that cannot be served: each gets one line with the reason, and time to read it. Imports nothing of ours."""

import contextlib
import socket
import time

GRACE_S = 0.2  # how long a newcomer waits: the disconnection of the client before it may not be seen yet

_LEAVE_S = 2.0  # longest wait for a rejected client to close
_LEAVING_MOST = 16  # rejected clients that are waited for


class Rejected:
    """Clients on their way out. They close first: a socket that is closed with unread bytes loses the line."""

    def __init__(self) -> None:
        self._leaving: list[tuple[socket.socket, float]] = []

    def __bool__(self) -> bool:
        return bool(self._leaving)

    def add(self, client: socket.socket, line: bytes) -> None:
        """Send a client (its socket does not block) the reason, and wait for it to close."""
        with contextlib.suppress(OSError):
            client.send(line)
            client.shutdown(socket.SHUT_WR)
        self._leaving.append((client, time.monotonic() + _LEAVE_S))

    def poll(self) -> None:
        """Close the sockets of clients that have closed, or whose time is up."""
        now = time.monotonic()
        too_many = len(self._leaving) - _LEAVING_MOST
        for i, (client, until) in enumerate(list(self._leaving)):
            if i < too_many or now > until or _has_left(client):
                client.close()
                self._leaving.remove((client, until))

    def close(self) -> None:
        """Close all."""
        for client, _ in self._leaving:
            client.close()


def _has_left(client: socket.socket) -> bool:
    try:
        return not client.recv(4096)
    except BlockingIOError:
        return False
    except OSError:
        return True
