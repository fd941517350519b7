"""A connected TCP socket as a port, and one socket option. Imports errors, failures, port, printable, validation."""

import contextlib
import select
import socket

from mirrormount.common.errors import BadAddress, BadValue, ConnectionLost
from mirrormount.common.printable import printable
from mirrormount.common.validation import host_and_port
from mirrormount.transport.failures import open_error
from mirrormount.transport.port import WRITE_S


class SocketPort:
    """A port that is a connected socket; name is the address that errors show."""

    lockstep = False

    def __init__(self, connection: socket.socket, name: str) -> None:
        self._connection = connection
        self._name = name

    def read(self, timeout_s: float) -> bytes:
        """Bytes that are there, or arrive within timeout_s; b"" if none. Raises ConnectionLost."""
        try:
            if not select.select([self._connection], [], [], timeout_s)[0]:
                return b""
            data = self._connection.recv(4096)
        except (OSError, ValueError) as e:  # ValueError: closed in another thread
            raise ConnectionLost(f"{self._name} has gone") from e
        if not data:
            raise ConnectionLost(f"{self._name} has gone")
        return data

    def write(self, data: bytes) -> None:
        """Send bytes. Raises ConnectionLost."""
        try:
            self._connection.settimeout(WRITE_S)
            self._connection.sendall(data)
        except OSError as e:
            raise ConnectionLost(f"{self._name} has gone, or takes nothing") from e

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()


def connect(address: str) -> SocketPort:
    """Open socket://HOST:PORT. Raises BadAddress, CannotOpen.

    pyserial's own socket:// is not used: it reads one byte at a time and drops the bytes before a hang-up.
    """
    try:
        where = host_and_port(address.removeprefix("socket://").rstrip("/"))
    except BadValue:
        raise BadAddress(f"{printable(address)}: a socket's address is socket://HOST:PORT") from None
    try:
        connection = socket.create_connection(where, timeout=WRITE_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except UnicodeError as e:
        raise BadAddress(f"{address}: not a host's name") from e
    except OSError as e:
        raise open_error(address, e) from e
    return SocketPort(connection, address)


def acknowledge(client: socket.socket) -> None:
    """Acknowledge received bytes at once, where the system can (Linux). The option lasts for one receipt.

    A client that sends two commands in a row without a query may hold the second one, which may be
    a stop, until the first is acknowledged: otherwise 40 ms.
    """
    if hasattr(socket, "TCP_QUICKACK"):
        with contextlib.suppress(OSError):  # the connection has ended
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
