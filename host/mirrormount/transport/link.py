"""Finds and opens the port to a board, and turns it into lines. Knows no commands.

Addresses: a serial port (/dev/ttyACM0, COM4, a pty), socket://HOST:PORT, or virtual://.
"""

import errno
import os
import select
import socket
import sys
import threading
import time
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

import serial
from serial.tools import list_ports

from mirrormount.common.errors import (
    BadAddress,
    BadValue,
    CannotOpen,
    ConnectionLost,
    NoAnswer,
    NoBoardFound,
    NotAMount,
    PermissionDenied,
    PortAbsent,
    PortBusy,
    SeveralBoardsFound,
)
from mirrormount.common.printable import printable
from mirrormount.common.validation import digits
from mirrormount.transport import circuitpy_ports
from mirrormount.transport.circuitpy_drives import find_drives

# USB ids (vendor, product) that are certainly a MicroPython board. CircuitPython boards have hundreds: they are
# known by their drives. Nothing else is ever written to unasked: an unknown port may be somebody's instrument.
KNOWN_IDS = {(0x2E8A, 0x0005): "MicroPython on RP2040/RP2350"}

_TICK_S = 0.02  # a serial read returns at least this often
_WRITE_S = 2.0
_LONGEST_LINE = 65536  # bytes; a board's lines have some hundreds
_LATE_S = 0.1  # after that much silence nothing of an old answer comes any more


class Port(Protocol):
    """What an open address gives. lockstep: its time passes only in read() and sleep()."""

    lockstep: bool

    def read(self, timeout_s: float) -> bytes: ...

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


def find() -> list[tuple[str, str]]:
    """The serial ports that a mount may be at: (device, description).

    A CircuitPython board is one of them if its drive is mounted and has mountfw on it: then its data channel, or
    its console if it has one channel.
    """
    ports = _ports()
    drives = find_drives()
    return _micropython(ports) + (circuitpy_ports.mounts(drives, ports) if drives else [])


def find_micropython() -> list[tuple[str, str]]:
    """The serial ports of MicroPython boards: (device, description)."""
    return _micropython(_ports())


def _ports() -> list:
    return sorted(list_ports.comports(), key=lambda port: port.device)


def _micropython(ports: list) -> list[tuple[str, str]]:
    return [(port.device, KNOWN_IDS[port.vid, port.pid]) for port in ports if (port.vid, port.pid) in KNOWN_IDS]


def find_one() -> str:
    """The one port that a mount may be at. Raises NoBoardFound or SeveralBoardsFound."""
    found = [device for device, _ in find()]
    if not found:
        if unknown := circuitpy_ports.unknown_data_channels(_ports()):
            raise NoBoardFound(
                f"a CircuitPython board listens at {', '.join(unknown)}, but its drive is not mounted here, so nobody"
                " knows what it is: if it is the mount, name the port"
            )
        raise NoBoardFound("no board found: plug one in, name its port, or use --port virtual://")
    if len(found) > 1:
        raise SeveralBoardsFound(f"several boards found, name one with --port: {', '.join(found)}")
    return found[0]


def open_port(address: str, *, baud: int = 115200) -> Port:
    """Open an address. Raises BadAddress, or a CannotOpen that says what is in the way."""
    if not address.strip():
        raise BadAddress("the port's name is empty: leave it out, or give one (see: mirrormount ports)")
    if address.startswith("virtual://"):
        from mirrormount.virtual.board import open_virtual

        return open_virtual(address)
    if address.startswith("socket://"):
        return _connect(address)
    return SerialPort(address, baud)


class SerialPort:
    """A port that pyserial opens."""

    lockstep = False

    def __init__(self, address: str, baud: int) -> None:
        try:
            self._serial = serial.serial_for_url(address, baudrate=baud, timeout=_TICK_S, do_not_open=True)
            if "://" not in address:
                self._serial.exclusive = True if os.name == "posix" else None
            self._serial.write_timeout = _WRITE_S
            self._serial.open()
        except ValueError as e:
            raise BadAddress(f"{address}: not a port's address") from e
        except (OSError, serial.SerialException) as e:
            raise _why_not(address, e) from e

    def read(self, timeout_s: float) -> bytes:
        """Bytes that are there, or come within timeout_s; may be none. Raises ConnectionLost."""
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


class SocketPort:
    """A port that is a connected socket."""

    lockstep = False

    def __init__(self, connection: socket.socket, name: str) -> None:
        self._connection = connection
        self._name = name

    def read(self, timeout_s: float) -> bytes:
        """Bytes that are there, or come within timeout_s; may be none. Raises ConnectionLost."""
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
            self._connection.settimeout(_WRITE_S)
            self._connection.sendall(data)
        except OSError as e:
            raise ConnectionLost(f"{self._name} has gone, or takes nothing") from e

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()


def _connect(address: str) -> SocketPort:
    # not pyserial's socket://: it reads a byte at a time and drops what came before a hang-up
    host, _, number = address.removeprefix("socket://").rstrip("/").rpartition(":")
    try:
        port = digits(number, 65535)
    except BadValue:
        host, port = "", 0
    if not host:
        raise BadAddress(f"{printable(address)}: a socket's address is socket://HOST:PORT")
    try:
        connection = socket.create_connection((host.strip("[]"), port), timeout=_WRITE_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except UnicodeError as e:
        raise BadAddress(f"{address}: not a host's name") from e
    except OSError as e:
        raise _why_not(address, e) from e
    return SocketPort(connection, address)


class Link:
    """Lines over a port. One caller at a time: hold `lock` for an exchange."""

    def __init__(self, port: Port) -> None:
        self.port = port
        self.lock = threading.RLock()
        self._buffer = bytearray()
        self._stale = False  # an answer that nobody waits for any more may still arrive

    @property
    def lockstep(self) -> bool:
        """True if time passes only while somebody waits."""
        return self.port.lockstep

    def monotonic(self) -> float:
        """The clock that time-outs are counted by, in seconds."""
        return self.port.monotonic() if self.lockstep else time.monotonic()  # type: ignore[attr-defined]

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        if self.lockstep:
            self.port.sleep(seconds)  # type: ignore[attr-defined]
        else:
            time.sleep(seconds)

    def write(self, data: bytes) -> None:
        """Send bytes. Raises ConnectionLost."""
        with self.lock:
            self.port.write(data)

    def ask(self, data: bytes, timeout_s: float, gate: AbstractContextManager[object] | None = None) -> str:
        """Send, and return the next line. The sending is done inside gate. Raises NoAnswer, ConnectionLost."""
        with self.lock:
            if self._stale:
                self.drain(_LATE_S)
            self._stale = True  # until the answer is here: Ctrl-C may come before it
            with gate or nullcontext():
                self.port.write(data)
            return self.read_line(timeout_s)

    def read_line(self, timeout_s: float) -> str:
        """The next line, without its end. Raises NoAnswer, ConnectionLost, NotAMount for a line without end."""
        end = self.monotonic() + timeout_s
        self._stale = True
        while b"\n" not in self._buffer:
            left = end - self.monotonic()
            if left <= 0:
                raise NoAnswer(f"no answer within {timeout_s:g} s")
            if len(self._buffer) > _LONGEST_LINE:
                raise NotAMount(f"more than {_LONGEST_LINE} bytes without the end of a line")
            self._buffer += self.port.read(left)
        line, _, rest = bytes(self._buffer).partition(b"\n")
        self._buffer[:] = rest
        self._stale = False
        return line.decode("ascii", "replace").strip("\r")

    def drain(self, quiet_s: float, longest_s: float = 2.0) -> bytes:
        """Take in all there is, until quiet_s without a byte (at most longest_s). Returns it."""
        taken = bytes(self._buffer)
        self._buffer.clear()
        end = self.monotonic() + longest_s
        while self.monotonic() < end:
            try:
                data = self.port.read(quiet_s)
            except ConnectionLost:
                if taken:  # its last words; the next call will say that it has gone
                    return taken
                raise
            if not data:
                break
            taken = (taken + data)[:_LONGEST_LINE]  # what a flood says later is of no interest
        if quiet_s >= _LATE_S:
            self._stale = False
        return taken

    def close(self) -> None:
        """Close the port."""
        self.port.close()


def _why_not(address: str, e: BaseException) -> CannotOpen:
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
    from mirrormount.transport.stop_socket import owners, who_has

    owner = who_has(address)
    stoppable = "; `mirrormount stop` goes through it" if owners(address) else ""  # not through any other program
    return f"{f': {owner}' if owner else ''}{stoppable}"


def _errno(e: BaseException | None) -> int | None:
    """The system's error number of e or of what it came from."""
    while e is not None:
        number = getattr(e, "errno", None)
        if number:
            return number
        e = e.__cause__ or e.__context__
    return None
