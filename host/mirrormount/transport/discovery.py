"""Which boards are plugged in, and the drives of CircuitPython boards. No port is opened.

A MicroPython board is known by its USB ids. A CircuitPython board is known by its drive, on which CircuitPython writes
boot_out.txt at start-up. It has a console, and a second port, the data channel, if its boot.py enables it. The USB
serial number of both is the board's UID, as in its boot_out.txt. (CircuitPython makes these names and numbers in
shared-module/usb_cdc/__init__.c and supervisor/shared/usb/usb_desc.c.)
"""

import os
import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from mirrormount.errors import NoBoardFound, SeveralBoardsFound, WrongDrive
from mirrormount.supported import CIRCUITPYTHON, text
from mirrormount.terminal import printable

# A board's drive is FAT. Other volumes are not asked, for one on a network may hang.
_FAT = {"vfat", "msdos", "exfat", "fuseblk"}
_WINDOWS_REMOVABLE = 2  # GetDriveTypeW of a USB drive
_WINDOWS_READ_ONLY = 0x80000  # FILE_READ_ONLY_VOLUME of GetVolumeInformationW
_FIRST_LINE = re.compile(r"Adafruit CircuitPython (\S+) on [^;]*; *(.*)")
_NUMBER = re.compile(r"(\d{1,4})\.(\d{1,4})")
_LONGEST = 4096  # bytes of boot_out.txt: the lines that are needed come before the output of boot.py
GET_IT = (
    "the .uf2 for the board is at circuitpython.org/downloads: double-press reset, or hold BOOTSEL while plugging in,"
    " and drop it on the drive that appears"
)
_DATA = " CDC2 "  # in the interface's name, for instance "CircuitPython CDC2 control"; the console's has " CDC "
# USB ids (vendor, product) that are certainly a MicroPython board. CircuitPython boards have hundreds: they are
# known by their drives. An Adafruit Feather RP2040 has the same id (239a:80f2) with either, so it is not here. Nothing
# else is ever written to unasked: an unknown port may be another instrument.
KNOWN_IDS = {(0x2E8A, 0x0005): "MicroPython on RP2040/RP2350"}


# ---- all boards


def find() -> list[tuple[str, str]]:
    """The serial ports of possible mounts: (device, description).

    A CircuitPython board is one of them if its drive is mounted and has mountfw on it: then its data channel, or
    its console if it has one channel.
    """
    ports = serial_ports()
    drives = find_drives()
    return _micropython(ports) + (mounts(drives, ports) if drives else [])


def find_micropython() -> list[tuple[str, str]]:
    """The serial ports of MicroPython boards: (device, description)."""
    return _micropython(serial_ports())


def find_one() -> str:
    """The port of the only possible mount. Raises NoBoardFound or SeveralBoardsFound."""
    found = [device for device, _ in find()]
    if not found:
        if unknown := unknown_data_channels(serial_ports()):
            raise NoBoardFound(
                f"a CircuitPython board listens at {', '.join(unknown)}, but its drive is not mounted here, so nobody"
                " knows what it is: if it is the mount, name the port"
            )
        raise NoBoardFound("no board found: plug one in, name its port, or use --port virtual://")
    if len(found) > 1:
        raise SeveralBoardsFound(f"several boards found, name one with --port: {', '.join(found)}")
    return found[0]


def serial_ports() -> list:
    """All serial ports of this computer, as pyserial lists them, sorted by device."""
    return sorted(list_ports.comports(), key=lambda port: port.device)


def _micropython(ports: list) -> list[tuple[str, str]]:
    return [(port.device, KNOWN_IDS[port.vid, port.pid]) for port in ports if (port.vid, port.pid) in KNOWN_IDS]


# ---- CircuitPython drives


@dataclass(frozen=True)
class Drive:
    """A board's drive: its mount point, and the fields of its boot_out.txt. uid is upper-case hex, or ""."""

    path: Path
    version: str
    name: str
    board_id: str = ""
    uid: str = ""

    def __str__(self) -> str:
        return f"{printable(str(self.path))} ({self.name})"

    @property
    def has_mountfw(self) -> bool:
        """True if the firmware is on the drive."""
        return (self.path / "mountfw").is_dir()


def find_drives() -> list[Drive]:
    """The CircuitPython drives that are mounted."""
    return [drive for path in mounted() if (drive := read_drive(path))]


def read_drive(path: Path) -> Drive | None:
    """The drive at path, or None if it has no boot_out.txt of CircuitPython."""
    try:
        with (path / "boot_out.txt").open("rb") as f:
            said = f.read(_LONGEST).decode("utf-8", "replace")
    except OSError:
        return None
    found = _FIRST_LINE.match(said)
    if not found:
        return None
    fields = dict(line.split(":", 1) for line in said.splitlines() if line.startswith(("Board ID:", "UID:")))
    board_id, uid = fields.get("Board ID", "").strip(), fields.get("UID", "").strip().upper()
    return Drive(path, printable(found[1], 40), printable(found[2].strip(), 60), board_id, uid)


def drive_at(path: Path) -> Drive:
    """The drive at the path that the user has named. Raises WrongDrive."""
    drive = read_drive(path)
    if drive:
        return drive
    if read_bootloader(path):
        raise WrongDrive(f"{path} is the board's bootloader, without CircuitPython: install that first ({GET_IT})")
    if not path.is_dir():
        raise WrongDrive(f"{path}: there is no such drive (it is called CIRCUITPY unless you have renamed it)")
    if (path / "boot_out.txt").exists():
        raise WrongDrive(f"{path}: its boot_out.txt is not CircuitPython's")
    raise WrongDrive(
        f"{path} has no boot_out.txt, so it is not the drive of a CircuitPython board, or one that has not started"
        " since it was formatted: then press its reset button"
    )


def check_version(drive: Drive) -> None:
    """Raise WrongDrive if its CircuitPython is too old. A build without a number counts as new."""
    number = _NUMBER.match(drive.version)
    if number and CIRCUITPYTHON.too_old((int(number[1]), int(number[2]))):
        raise WrongDrive(
            f"{drive} runs CircuitPython {drive.version}: {text(CIRCUITPYTHON.lowest)} or later is needed, for older"
            f" ones cannot switch their watchdog off as the firmware does ({GET_IT})"
        )


def untried(drive: Drive) -> bool:
    """True if its CircuitPython is newer than all tested versions."""
    number = _NUMBER.match(drive.version)
    return bool(number) and CIRCUITPYTHON.untried((int(number[1]), int(number[2])))


# ---- drives of boot loaders

_INFO = "INFO_UF2.TXT"  # on the drive of every UF2 boot loader
_BOARD_ID = re.compile(r"^Board-ID: *([^\r\n]*)", re.MULTILINE)
CHIPS = {"RPI-RP2": "RP2040", "RP2350": "RP2350"}  # by the Board-ID that the ROM tells: so the drive is called, too


@dataclass(frozen=True)
class Bootloader:
    """The drive of a UF2 boot loader: its mount point, and the Board-ID that it tells, or ""."""

    path: Path
    board_id: str

    def __str__(self) -> str:
        return printable(str(self.path))

    @property
    def chip(self) -> str:
        """RP2040 or RP2350; "" for a boot loader of another chip."""
        return CHIPS.get(self.board_id, "")


def read_bootloader(path: Path) -> Bootloader | None:
    """The boot loader whose drive is at path, or None."""
    try:
        with (path / _INFO).open("rb") as f:
            told = _BOARD_ID.search(f.read(_LONGEST).decode("utf-8", "replace"))
    except OSError:
        return None
    return Bootloader(path, printable(told[1].strip(), 60) if told else "")


def find_bootloaders() -> list[Bootloader]:
    """The boot loaders whose drives are mounted."""
    return [found for path in mounted() if (found := read_bootloader(path))]


def unmounted_bootloaders(labels: Path = Path("/dev/disk/by-label")) -> list[Path]:
    """Drives of boot loaders that are plugged in (Linux only, by their names), mounted or not."""
    return [labels / label for label in CHIPS if (labels / label).exists()]


# ---- serial ports of CircuitPython boards


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
    """Data channels by their interface name (Linux only). It is not known which program runs there."""
    return [port.device for port in ports if _DATA in (getattr(port, "interface", None) or "")]


def _place(port: Any) -> tuple[int, list[int], str]:
    """Sort key: the number of the port's USB interface (1-2:1.0, 1-2:x.2), else the numbers in its name."""
    number = re.search(r":\w+\.(\d+)$", getattr(port, "location", None) or "")
    in_name = [int(digits) for digits in re.findall(r"\d+", port.device)]
    return (int(number[1]) if number else 0, in_name, port.device)


# ---- mounted volumes


@dataclass(frozen=True)
class Room:
    """Free space of a volume, in clusters of cluster_bytes; a file takes whole clusters."""

    free: int
    cluster_bytes: int
    read_only: bool

    def clusters(self, size_bytes: int) -> int:
        """Clusters that a file of this size takes."""
        return -(-size_bytes // self.cluster_bytes)


def mounted() -> list[Path]:
    """The roots of the volumes that can be a board's drive."""
    if sys.platform == "win32":
        return _removable_letters()
    if sys.platform == "darwin":
        return _folders_in(Path("/Volumes"))
    return fat_mounts(Path("/proc/mounts"))


def fat_mounts(table: Path) -> list[Path]:
    """The mount points of FAT volumes in a table like /proc/mounts (Linux)."""
    try:
        lines = table.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return []
    mounts = [fields for line in lines if len(fields := line.split(" ")) > 2 and fields[2] in _FAT]
    # a space in a name is \040 there
    return sorted({Path(re.sub(r"\\([0-7]{3})", lambda m: chr(int(m[1], 8)), fields[1])) for fields in mounts})


def _folders_in(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.is_dir())
    except OSError:
        return []


def _removable_letters() -> list[Path]:
    import ctypes

    kernel = ctypes.windll.kernel32  # type: ignore[attr-defined]
    present = kernel.GetLogicalDrives()
    letters = [chr(ord("A") + bit) for bit in range(26) if present >> bit & 1]
    return [Path(f"{x}:\\") for x in letters if kernel.GetDriveTypeW(f"{x}:\\") == _WINDOWS_REMOVABLE]


def room(path: Path) -> Room:
    """What the volume with this path has left. Raises OSError."""
    if sys.platform == "win32":
        return _room_of_letter(path)
    v = os.statvfs(path)
    read_only = bool(v.f_flag & os.ST_RDONLY) or not os.access(path, os.W_OK)
    return Room(v.f_bavail, v.f_frsize, read_only)


def _room_of_letter(path: Path) -> Room:
    import ctypes

    kernel = ctypes.windll.kernel32  # type: ignore[attr-defined]
    root = f"{path.resolve().drive}\\"
    numbers = [ctypes.c_ulong() for _ in range(4)]  # sectors a cluster, bytes a sector, free clusters, all clusters
    flags = ctypes.c_ulong()
    done = kernel.GetDiskFreeSpaceW(root, *[ctypes.byref(n) for n in numbers])
    if not done or not kernel.GetVolumeInformationW(root, None, 0, None, None, ctypes.byref(flags), None, 0):
        raise OSError(f"{root} does not tell its room")
    return Room(numbers[2].value, numbers[0].value * numbers[1].value, bool(flags.value & _WINDOWS_READ_ONLY))
