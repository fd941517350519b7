"""The serial ports of each CircuitPython board, from the system's lists. Opens none.

A board has a console, and a second port, the data channel, if its boot.py enables it. The USB serial number of both is
the board's UID, as in its boot_out.txt. (CircuitPython makes these names and numbers in
shared-module/usb_cdc/__init__.c and supervisor/shared/usb/usb_desc.c.)
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from mirrormount.common.printable import printable
from mirrormount.transport.circuitpy_drives import Drive

_DATA = " CDC2 "  # in the interface's name, for instance "CircuitPython CDC2 control"; the console's has " CDC "


@dataclass(frozen=True)
class Channels:
    """A board's serial ports. data is None on a board with one channel; console is None if boot.py disables it."""

    console: str | None = None
    data: str | None = None

    @property
    def protocol(self) -> str | None:
        """The firmware's port: the data channel, or the console of a board without one."""
        return self.data or self.console


def channels(drive: Drive, ports: Iterable[Any]) -> Channels:
    """The ports of this drive's board, among these of pyserial's list_ports."""
    own = [port for port in ports if drive.uid and serial_number(port) == drive.uid]
    if not own:
        return Channels()
    own.sort(key=_place)
    named = [port for port in own if _DATA in (port.interface or "")]
    if len(own) == 1:
        return Channels(data=own[0].device) if named else Channels(console=own[0].device)
    # macOS gives all ports of a board one interface name, and Windows gives none. There the order decides: the console
    # has the interface with the lower number.
    data = named[0] if len(named) == 1 else own[-1]
    return Channels(console=next(port.device for port in own if port is not data), data=data.device)


def serial_number(port: Any) -> str:
    """A port's USB serial number, upper-case, or ""."""
    return (getattr(port, "serial_number", None) or "").upper()


def mounts(drives: Sequence[Drive], ports: Sequence[Any]) -> list[tuple[str, str]]:
    """(device, description) of the boards with mountfw on their drive and a port."""
    found = [(channels(drive, ports).protocol, drive) for drive in drives if drive.has_mountfw]
    return [
        (device, f"CircuitPython on {drive.name}, drive {printable(str(drive.path))}")
        for device, drive in found
        if device
    ]


def unknown_data_channels(ports: Iterable[Any]) -> list[str]:
    """Data channels by their interface name (Linux only). Which program runs there is unknown."""
    return [port.device for port in ports if _DATA in (getattr(port, "interface", None) or "")]


def _place(port: Any) -> tuple[int, list[int], str]:
    """Sort key: the number of the port's USB interface (1-2:1.0, 1-2:x.2), else the numbers in its name."""
    number = re.search(r":\w+\.(\d+)$", getattr(port, "location", None) or "")
    in_name = [int(digits) for digits in re.findall(r"\d+", port.device)]
    return (int(number[1]) if number else 0, in_name, port.device)
