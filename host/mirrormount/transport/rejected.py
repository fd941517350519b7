"""Clients that cannot be served: each is told why in one line, and sent away so that it can read it."""

import contextlib
import socket
import time

from mirrormount.device.identify import AT_PROMPT, TAKEN

TAKEN_LINE = TAKEN.encode() + b"\r\n"
AT_PROMPT_LINE = AT_PROMPT.encode() + b"\r\n"
GRACE_S = 0.2  # how long a newcomer waits: the client before him may just have gone without our having seen it

_LEAVE_S = 2.0  # how long the one who is told may take to close
_LEAVING = 16  # how many of them are waited for


class TurnedAway:
    """Those who are leaving. They close, not we: a connection closed on unread bytes loses the line on its way."""

    def __init__(self) -> None:
        self._leaving: list[tuple[socket.socket, float]] = []

    def __bool__(self) -> bool:
        return bool(self._leaving)

    def add(self, client: socket.socket, line: bytes) -> None:
        """Tell a client (its socket does not block) why, and see it off."""
        with contextlib.suppress(OSError):
            client.send(line)
            client.shutdown(socket.SHUT_WR)
        self._leaving.append((client, time.monotonic() + _LEAVE_S))

    def look(self) -> None:
        """Close those who have left, or had time enough."""
        now = time.monotonic()
        crowd = len(self._leaving) - _LEAVING
        for i, (client, until) in enumerate(list(self._leaving)):
            if i < crowd or now > until or _has_left(client):
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
