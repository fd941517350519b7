"""The owner's side of the stop socket: accepts stops for a port that is open in this process.

    owner = Stoppable([address], write_stop)   # Mount.open and `serve` do this
    owner.close()
    held_here(address)                         # True if this process has the port open (Mount.open)

stop_socket.py is the other side. A Stoppable calls write_stop() in its own thread: it must write the stop without
waiting for a lock that a hanging thread may hold.
"""

import contextlib
import errno
import itertools
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from mirrormount.common.errors import MountError
from mirrormount.transport.stop_socket import FAILED, clear, make_folder, path_of, real_name, supported

_PRESENT_S = 2.0  # between two looks whether the socket still has its name
_REQUEST_S = 0.2  # longest time from a connection to its request: the next one waits meanwhile
_PASSING = (
    errno.EMFILE,
    errno.ENFILE,
    errno.ENOMEM,
    errno.ECONNABORTED,
)  # too many files, or the client has gone

# Nothing here takes a lock: the collector of garbage may close one in any thread, also in one that is in this file.
_held: dict[int, list[str]] = {}  # the open Stoppables of this process: their numbers, with the names of their ports
_numbers = itertools.count(1)


def held_here(address: str) -> bool:
    """True if this process has the port open. Each virtual:// board is a new one: False."""
    if address.startswith("virtual://"):
        return False
    name = real_name(address)
    return any(name in names for names in list(_held.values()))


class Stoppable:
    """The owner's side: accepts stops for a port that is open in this process, until close().

    names: the addresses of the port. stop: writes the stop, and returns STOPPED or SENT; it may raise
    MountError. Without a socket the port works all the same, and `why_not` has the reason.
    """

    def __init__(self, names: Sequence[str], stop: Callable[[], str]) -> None:
        self._names = [real_name(name) for name in names]
        self._stop = stop
        self._process = os.getpid()
        self.why_not: str | None = None
        self._server: socket.socket | None = None
        self._paths: list[Path] = []
        self._number = next(_numbers)
        _held[self._number] = self._names
        if supported():
            try:
                self._server = self._bound()
                threading.Thread(target=self._serve, args=(self._server,), name="stop socket", daemon=True).start()
            except (OSError, MountError) as e:  # a full disk, a home without a runtime folder: the port works
                self.why_not = str(e)
                self._remove()
        else:
            self.why_not = "this system has no Unix sockets"

    def close(self) -> None:
        """Accept no more stops. In a forked process it does nothing: the socket is the parent's."""
        if self._process != os.getpid():
            return
        _held.pop(self._number, None)  # first: a socket that is made anew is closed again by its thread from here on
        self._remove()
        if server := self._server:
            with contextlib.suppress(OSError):
                server.shutdown(socket.SHUT_RDWR)  # ends accept() on Linux; the thread is a daemon elsewhere
            server.close()

    def _remove(self) -> None:
        for path in self._paths:
            path.unlink(missing_ok=True)

    def _bound(self) -> socket.socket:
        """A socket that listens under all names."""
        folder = make_folder()
        self._paths = [path_of(folder, name, self._number) for name in self._names]
        for path in self._paths:
            clear(path)
        server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            server.settimeout(_PRESENT_S)
            server.bind(str(self._paths[0]))
            self._paths[0].chmod(0o600)
            server.listen(8)
            for other in self._paths[1:]:
                os.link(self._paths[0], other)
        except BaseException:
            server.close()
            raise
        return server

    def _present(self, server: socket.socket) -> socket.socket:
        """The socket; a new one if a name of it is gone, as with its folder when the user has logged out."""
        if self._number not in _held or all(path.exists() for path in self._paths):
            return server
        with contextlib.suppress(OSError, MountError):  # no folder yet: the next look tries again
            self._remove()
            self._server = anew = self._bound()
            server.close()
            if self._number not in _held:  # closed meanwhile
                self.close()
            return anew
        return server

    def _serve(self, server: socket.socket) -> None:
        while True:
            try:
                asker, _ = server.accept()
            except TimeoutError:
                server = self._present(server)
                continue
            except OSError as e:
                if e.errno not in _PASSING:
                    return  # closed
                time.sleep(_REQUEST_S)  # no event shows that there is room again
                continue
            with asker, contextlib.suppress(OSError):  # it has disconnected
                asker.settimeout(_REQUEST_S)
                if _user(asker) in (None, os.getuid(), 0) and asker.recv(16).startswith(b"stop"):
                    asker.sendall(self._answer().encode() + b"\n")

    def _answer(self) -> str:
        try:
            return self._stop()
        except Exception as e:  # of any kind: it is sent to the program that requested the stop
            return FAILED + (str(e) or type(e).__name__)


def _user(connection: socket.socket) -> int | None:
    """The peer's user id; None if the system does not show it (the folder's mode protects the socket there)."""
    if not hasattr(socket, "SO_PEERCRED"):
        return None
    return struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))[1]
