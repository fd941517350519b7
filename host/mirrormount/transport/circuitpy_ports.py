"""The serial ports of each CircuitPython board, from the system's lists. Opens none.

A board has a console, and a second port, the data channel, if its boot.py enables it. The USB serial number of both is
the board's UID, as in its boot_out.txt. (CircuitPython makes these names and numbers in
shared-module/usb_cdc/__init__.c and supervisor/shared/usb/usb_desc.c.)

A drive's text proves nothing: it may contain another instrument's serial number. A port counts as a board's only if the
system lists both below one USB device (Linux), if it has the USB ids of CircuitPython on that board, or if the user has
named it.
"""

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mirrormount.common.printable import printable
from mirrormount.transport.circuitpy_drives import Drive

_SYSFS = "/sys"
# {board id: USB ids (vendor, product)} of CircuitPython: USB_VID and USB_PID in its
# ports/*/boards/*/mpconfigboard.mk. Where the system does not list a drive's USB device, a port must have these.
_USB_IDS = {
    "raspberry_pi_pico": (0x239A, 0x80F4),
    "raspberry_pi_pico_w": (0x239A, 0x8120),
    "raspberry_pi_pico2": (0x2E8A, 0x000B),
    "raspberry_pi_pico2_w": (0x239A, 0x8162),
    "seeeduino_xiao_rp2040": (0x2886, 0x0042),
    "adafruit_feather_rp2040": (0x239A, 0x80F2),
    "adafruit_feather_esp32s3_4mbflash_2mbpsram": (0x239A, 0x811C),
    "adafruit_feather_esp32s3_nopsram": (0x239A, 0x8114),
}
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
    """The ports that certainly belong to this drive's board, among these of pyserial's list_ports."""
    own = [port for port in ports if _belongs(drive, port)]
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


def unproven(drive: Drive, ports: Iterable[Any]) -> list[str]:
    """Ports whose only link to this drive is the serial number in its text. Nothing is sent there."""
    return [port.device for port in ports if _belongs(drive, port) is None]


def _belongs(drive: Drive, port: Any) -> bool | None:
    """True if this drive and this port are of one board; None if only the drive's text says so."""
    if not drive.uid or serial_number(port) != drive.uid:
        return False
    if drive.vouched:
        return True
    usb_device = getattr(port, "usb_device_path", None)  # Linux only
    drives_device = _device_in_sysfs(drive.path)
    if usb_device and drives_device:
        return drives_device.startswith(os.path.realpath(usb_device) + os.sep)
    return True if (port.vid, port.pid) == _USB_IDS.get(drive.board_id) else None


def _device_in_sysfs(path: Path) -> str:
    """The path in sysfs of the device that is mounted there; "" if there is none."""
    try:
        number = os.stat(path).st_dev
        place = f"{_SYSFS}/dev/block/{os.major(number)}:{os.minor(number)}"
    except (OSError, AttributeError):  # Windows has no such numbers
        return ""
    return os.path.realpath(place) if os.path.exists(place) else ""


def serial_number(port: Any) -> str:
    """A port's USB serial number, upper-case, or ""."""
    return (getattr(port, "serial_number", None) or "").upper()


def mounts(drives: Sequence[Drive], ports: Sequence[Any]) -> list[tuple[str, str]]:
    """(device, description) of the boards with mountfw on their drive and a port."""
    with_mountfw = [drive for drive in drives if drive.has_mountfw and not namesakes(drive, drives)]
    found = [(channels(drive, ports).protocol, drive) for drive in with_mountfw]
    return [
        (device, f"CircuitPython on {drive.name}, drive {printable(str(drive.path))}")
        for device, drive in found
        if device
    ]


def namesakes(drive: Drive, drives: Iterable[Drive]) -> list[Drive]:
    """Other drives with the same UID: all but one are copies or forged."""
    return [other for other in drives if drive.uid and other.uid == drive.uid and not _is_same(other, drive)]


def _is_same(one: Drive, other: Drive) -> bool:
    try:
        return os.path.samefile(one.path, other.path)
    except OSError:
        return one.path == other.path


def unknown_data_channels(ports: Iterable[Any]) -> list[str]:
    """Data channels by their interface name (Linux only). Which program runs there is unknown."""
    return [port.device for port in ports if _DATA in (getattr(port, "interface", None) or "")]


def _place(port: Any) -> tuple[int, list[int], str]:
    """Sort key: the number of the port's USB interface (1-2:1.0, 1-2:x.2), else the numbers in its name."""
    number = re.search(r":\w+\.(\d+)$", getattr(port, "location", None) or "")
    in_name = [int(digits) for digits in re.findall(r"\d+", port.device)]
    return (int(number[1]) if number else 0, in_name, port.device)
