"""Ports of a board: serial, TCP, virtual; why one cannot be opened.

open_port() takes an address: a serial port (/dev/ttyACM0, COM4, a pty), socket://HOST:PORT, or virtual://. The virtual
board belongs to a package above this one, so it is named here as text and imported when somebody asks for it. A port
that cannot be opened is one error with cause and remedy.
"""

import contextlib
import errno
import importlib
import os
import select
import socket
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import serial
from serial.tools import list_ports

from mirrormount.errors import (
    BadAddress,
    BadValue,
    CannotOpen,
    ConnectionLost,
    ExtraMissing,
    PermissionDenied,
    PortAbsent,
    PortBusy,
)
from mirrormount.terminal import install_command, printable
from mirrormount.transport.stop_socket import owners, who_has
from mirrormount.values import did_you_mean, host_and_port

WRITE_S = 2.0  # longest time that a write waits


# ---- interfaces


class Port(Protocol):
    """An open port. lockstep: time passes only in read() and sleep(), and the port is a ClockedPort."""

    lockstep: bool

    def read(self, timeout_s: float) -> bytes: ...

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class ClockedPort(Port, Protocol):
    """A port with a clock of its own, in seconds."""

    def monotonic(self) -> float: ...

    def sleep(self, seconds: float) -> None: ...


class Table(Protocol):
    """Boards and cameras that share a clock, in seconds.

    A mount is `Mount(Link(port))`. A camera is a mirrormount_beam.camera.Camera; this package does not import that one.
    """

    @property
    def ports(self) -> Sequence[Port]: ...

    @property
    def cameras(self) -> Sequence[Any]: ...

    def now_s(self) -> float: ...

    def sleep(self, seconds: float) -> None:
        """Let the table's time pass."""
        ...

    def close(self) -> None: ...


# ---- why a port cannot be opened


def explain_open_error(address: str, e: BaseException) -> CannotOpen:
    """The error to raise for e, which opening the address has raised."""
    if isinstance(e, TimeoutError):
        return PortAbsent(f"{address}: no answer")
    if isinstance(e, socket.gaierror):
        return PortAbsent(f"{address}: there is no such host")
    number = _errno(e)
    if number in (errno.EACCES, errno.EPERM) and sys.platform != "win32":
        return PermissionDenied(
            f"{address}: permission denied; on Linux: sudo usermod -aG dialout $USER, log in again"
            " (or the udev file of docs/bring-up.md)"
        )
    if number in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK):
        return PortBusy(f"{address}: another program has this port open{_which(address)}")
    if number == errno.ECONNREFUSED:
        return PortAbsent(f"{address}: nothing listens there")
    if number == errno.ENOENT:
        return PortAbsent(f"{address}: there is no such port (see: mirrormount ports)")
    if number is None and sys.platform == "win32":  # pyserial keeps no number there
        if any(port.device.upper() == address.upper() for port in list_ports.comports()):
            return PortBusy(f"{address}: another program has this port open")
        return PortAbsent(f"{address}: there is no such port (see: mirrormount ports)")
    detail = os.strerror(number) if number else "not a serial port"
    return CannotOpen(f"{address}: cannot be opened: {detail}")


def _which(address: str) -> str:
    owner = who_has(address)
    stoppable = "; `mirrormount stop` goes through it" if owners(address) else ""  # not through any other program
    return f"{f': {owner}' if owner else ''}{stoppable}"


def _errno(e: BaseException | None) -> int | None:
    """The system's error number of e, or of the exception behind it."""
    while e is not None:
        number = getattr(e, "errno", None)
        if number:
            return number
        e = e.__cause__ or e.__context__
    return None


# ---- kinds of ports

_TICK_S = 0.02  # a serial read returns at least this often
_CLOCKS_S = 0.05  # by so much may the clock differ by which a file server dates a link


class SerialPort:
    """A port that pyserial opens: a device's name, or one of pyserial's URLs. Raises BadAddress, CannotOpen."""

    lockstep = False

    def __init__(self, address: str) -> None:
        _check_links(address)
        try:
            self._serial = serial.serial_for_url(address, baudrate=115200, timeout=_TICK_S, do_not_open=True)
            if "://" not in address:
                self._serial.exclusive = True if os.name == "posix" else None
            self._serial.write_timeout = WRITE_S
            self._serial.open()
        except ValueError as e:
            scheme, mark, _ = address.partition("://")
            meant = did_you_mean(scheme, SCHEMES) if mark else ""
            raise BadAddress(f"{address}: not a port's address{meant}") from e
        except (OSError, serial.SerialException) as e:
            raise explain_open_error(address, e) from e

    def read(self, timeout_s: float) -> bytes:
        """Bytes that are there, or arrive within timeout_s; b"" if none. Raises ConnectionLost."""
        end = time.monotonic() + timeout_s
        try:
            while True:
                data = self._serial.read(1)
                if data:
                    return data + self._serial.read(self._serial.in_waiting or 0)
                if time.monotonic() >= end:
                    return b""
        except (OSError, serial.SerialException, TypeError) as e:  # TypeError: closed in another thread
            raise ConnectionLost(f"{self._serial.port} has gone") from e

    def write(self, data: bytes) -> None:
        """Send bytes. Raises ConnectionLost."""
        try:
            self._serial.write(data)
        except (OSError, serial.SerialException, TypeError) as e:  # TypeError: closed in another thread
            raise ConnectionLost(f"{self._serial.port} has gone, or takes nothing") from e

    def close(self) -> None:
        """Close the port."""
        self._serial.close()


def _check_links(path: str) -> None:
    """Raises PortAbsent for the link of a virtual board that was killed: its terminal's number is another one's now.

    A board makes its link behind its terminal. Linux keeps the time at which a terminal was made (st_ctime).
    """
    with contextlib.suppress(OSError):  # no such file, or links in a circle: opening it says so
        os.stat(path)
        while os.path.islink(path):
            target = os.path.join(os.path.dirname(path), os.readlink(path))
            made_s, link_s = os.stat(target).st_ctime, os.lstat(path).st_ctime
            if target.startswith("/dev/pts/") and made_s > link_s + _CLOCKS_S:
                raise PortAbsent(
                    f"{path}: leads to a terminal that is younger than this link: the virtual board that made it was"
                    " killed; start it again"
                )
            path = target


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


def connect_tcp(address: str) -> SocketPort:
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
        raise explain_open_error(address, e) from e
    return SocketPort(connection, address)


def acknowledge(client: socket.socket) -> None:
    """Acknowledge received bytes at once, where the system can (Linux). The option lasts for one receipt.

    A client that sends two commands in a row without a query may hold the second one, which may be
    a stop, until the first is acknowledged: otherwise 40 ms.
    """
    if hasattr(socket, "TCP_QUICKACK"):
        with contextlib.suppress(OSError):  # the connection has ended
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)


class Log(Protocol):
    """A receiver of the copy."""

    def add(self, data: bytes, *, to_board: bool) -> None: ...


class TappedPort:
    """A port whose traffic is logged."""

    def __init__(self, port: Port, log: Log) -> None:
        self._port = port
        self._log = log
        self.lockstep = port.lockstep

    def read(self, timeout_s: float) -> bytes:
        """As Port.read()."""
        data = self._port.read(timeout_s)
        if data:
            self._log.add(data, to_board=False)
        return data

    def write(self, data: bytes) -> None:
        """As Port.write(). The log gets its copy afterwards: a stop does not wait for it."""
        self._port.write(data)
        self._log.add(data, to_board=True)

    def close(self) -> None:
        """As Port.close()."""
        self._port.close()


# ---- opening by address


def open_port(address: str) -> Port:
    """Open an address. Raises BadAddress, or a CannotOpen that names the cause."""
    if not address.strip():
        raise BadAddress("the port's name is empty: leave it out, or give one (see: mirrormount ports)")
    scheme, separator, _ = address.partition("://")
    if separator and scheme in SCHEMES:
        return SCHEMES[scheme](address)
    return SerialPort(address)


def open_table(address: str) -> Table:
    """Open a table of mounts and cameras: virtual-table://. Raises BadAddress, CannotOpen."""
    scheme, _, _ = address.partition("://")
    if scheme not in TABLE_SCHEMES:
        raise BadAddress(f"{printable(address)}: the address of a table begins with {', '.join(TABLE_SCHEMES)}://")
    return TABLE_SCHEMES[scheme](address)


def _in_module(module: str, function: str, extra: str) -> Callable[[str], Any]:
    """A function of a module that is imported at its first call, which needs an extra. The call raises ExtraMissing."""

    def call(address: str) -> Any:
        try:
            found = importlib.import_module(module)
        except ModuleNotFoundError as e:
            told = f"{address} needs a package that is not installed ({e.name}): {install_command(extra)}"
            raise ExtraMissing(told) from e
        return getattr(found, function)(address)

    return call


# Every address without one of these schemes is opened by pyserial.
SCHEMES: dict[str, Callable[[str], Port]] = {
    "socket": connect_tcp,
    "virtual": _in_module("mirrormount_sim.board", "open_virtual", "sim"),
}
TABLE_SCHEMES: dict[str, Callable[[str], Table]] = {
    "virtual-table": _in_module("mirrormount_sim.table", "open_table", "sim,beam"),
}
