"""Drives of CircuitPython boards, found by the boot_out.txt that CircuitPython writes at start-up."""

import re
from dataclasses import dataclass
from pathlib import Path

from mirrormount.common.errors import WrongDrive
from mirrormount.common.printable import printable
from mirrormount.common.supported import CIRCUITPYTHON, text
from mirrormount.transport import volumes

_FIRST_LINE = re.compile(r"Adafruit CircuitPython (\S+) on [^;]*; *(.*)")
_NUMBER = re.compile(r"(\d{1,4})\.(\d{1,4})")
_LONGEST = 4096  # the needed lines come first, the output of boot.py after them
GET_IT = (
    "the .uf2 for the board is at circuitpython.org/downloads: double-press reset, or hold BOOTSEL while plugging in,"
    " and drop it on the drive that appears"
)


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
    return [drive for path in volumes.mounted() if (drive := read_drive(path))]


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
    if is_bootloader(path):
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


def is_bootloader(path: Path) -> bool:
    """True for the drive of a UF2 bootloader, for instance RPI-RP2."""
    return (path / "INFO_UF2.TXT").exists()


def find_bootloaders() -> list[Path]:
    """The bootloader drives that are mounted."""
    return [path for path in volumes.mounted() if is_bootloader(path)]
