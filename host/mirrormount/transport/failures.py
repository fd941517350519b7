"""Why a port could not be opened, as one error with cause and remedy. Imports errors, stop_socket."""

import errno
import os
import socket
import sys

from serial.tools import list_ports

from mirrormount.common.errors import CannotOpen, PermissionDenied, PortAbsent, PortBusy
from mirrormount.transport.stop_socket import owners, who_has


def open_error(address: str, e: BaseException) -> CannotOpen:
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
