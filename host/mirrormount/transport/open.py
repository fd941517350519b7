"""Opens an address: a serial port (/dev/ttyACM0, COM4, a pty), socket://HOST:PORT, or virtual://; a table of mounts.

`virtual` stands above transport, so it is named here as text and imported when it is asked for: the one dynamic
import of the host.
"""

import importlib
from collections.abc import Callable
from typing import Any

from mirrormount.common.errors import BadAddress
from mirrormount.common.printable import printable
from mirrormount.transport.port import Port, Table
from mirrormount.transport.serial_port import SerialPort
from mirrormount.transport.tcp_port import connect


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


def _in_module(module: str, function: str) -> Callable[[str], Any]:
    """A function of a module that is imported at its first call."""
    return lambda address: getattr(importlib.import_module(module), function)(address)


# how each scheme is opened; every other address is pyserial's
SCHEMES: dict[str, Callable[[str], Port]] = {
    "socket": connect,
    "virtual": _in_module("mirrormount.virtual.board", "open_virtual"),
}
TABLE_SCHEMES: dict[str, Callable[[str], Table]] = {
    "virtual-table": _in_module("mirrormount.virtual.table", "open_table"),
}
