"""Opens an address: a serial port (/dev/ttyACM0, COM4, a pty), socket://HOST:PORT, or virtual://.

`virtual` stands above transport, so it is named here as text and imported when it is asked for: the one dynamic
import of the host.
"""

import importlib
from collections.abc import Callable

from mirrormount.common.errors import BadAddress
from mirrormount.transport.port import Port
from mirrormount.transport.serial_port import SerialPort
from mirrormount.transport.tcp_port import connect


def open_port(address: str, *, baud: int = 115200) -> Port:
    """Open an address. Raises BadAddress, or a CannotOpen that names the cause."""
    if not address.strip():
        raise BadAddress("the port's name is empty: leave it out, or give one (see: mirrormount ports)")
    scheme, separator, _ = address.partition("://")
    if separator and scheme in SCHEMES:
        return SCHEMES[scheme](address)
    return SerialPort(address, baud)


def _in_module(module: str, function: str) -> Callable[[str], Port]:
    """A function of a module that is imported at its first call."""
    return lambda address: getattr(importlib.import_module(module), function)(address)


# how each scheme is opened; every other address is pyserial's
SCHEMES: dict[str, Callable[[str], Port]] = {
    "socket": connect,
    "virtual": _in_module("mirrormount.virtual.board", "open_virtual"),
}
