"""Which serial ports belong to which CircuitPython board, from what the system says of them. Opens none.

A board shows its console, and a second port, the data channel, where its boot.py has switched that on. Both carry
the board's UID as USB serial number, the same that is in its boot_out.txt. (How CircuitPython makes these
names and numbers: its shared-module/usb_cdc/__init__.c and supervisor/shared/usb/usb_desc.c.)
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from mirrormount.drives import Drive

_DATA = " CDC2 "  # in the interface's name, for instance "CircuitPython CDC2 control"; the console's has " CDC "


@dataclass(frozen=True)
class Channels:
    """A board's serial ports. data is None on a board with one channel, console if boot.py switched it off."""

    console: str | None = None
    data: str | None = None

    @property
    def protocol(self) -> str | None:
        """Where the firmware listens: the data channel, and where there is none the console."""
        return self.data or self.console


def channels(drive: Drive, ports: Iterable[Any]) -> Channels:
    """The ports of the board with this drive, among those of pyserial's list_ports."""
    own = [port for port in ports if drive.uid and (serial_number(port) == drive.uid)]
    if not own:
        return Channels()
    own.sort(key=_place)
    named = [port for port in own if _DATA in (port.interface or "")]
    if len(own) == 1:
        return Channels(data=own[0].device) if named else Channels(console=own[0].device)
    # macOS gives all ports of a board the name of one of them, and Windows gives none: there the order decides,
    # for the console's interface always has the lower number
    data = named[0] if len(named) == 1 else own[-1]
    return Channels(console=next(port.device for port in own if port is not data), data=data.device)


def serial_number(port: Any) -> str:
    """A port's USB serial number, upper-case, or ""."""
    return (getattr(port, "serial_number", None) or "").upper()


def mounts(drives: Sequence[Drive], ports: Sequence[Any]) -> list[tuple[str, str]]:
    """(device, description) of the boards that have mountfw on their drive and can be spoken to."""
    with_mountfw = [drive for drive in drives if drive.has_mountfw]
    found = [(channels(drive, ports).protocol, drive) for drive in with_mountfw]
    return [(device, f"CircuitPython on {drive.name}, drive {drive.path}") for device, drive in found if device]


def unknown_data_channels(ports: Iterable[Any]) -> list[str]:
    """Data channels by their name (Linux only). What listens there is not known."""
    return [port.device for port in ports if _DATA in (getattr(port, "interface", None) or "")]


def _place(port: Any) -> tuple[int, list[int], str]:
    """Sorts a board's ports by the number of their USB interface (1-2:1.0, 1-2:x.2), else by their names' numbers."""
    number = re.search(r":\w+\.(\d+)$", getattr(port, "location", None) or "")
    in_name = [int(digits) for digits in re.findall(r"\d+", port.device)]
    return (int(number[1]) if number else 0, in_name, port.device)
