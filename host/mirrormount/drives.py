"""Drives of CircuitPython boards: found by their boot_out.txt, which CircuitPython writes at start-up."""

import re
from dataclasses import dataclass
from pathlib import Path

from mirrormount import volumes
from mirrormount.errors import WrongDrive
from mirrormount.supported import CIRCUITPYTHON, text

_FIRST_LINE = re.compile(r"Adafruit CircuitPython (\S+) on [^;]*; *(.*)")
_LONGEST = 4096  # the lines that matter come first; what boot.py prints comes after
GET_IT = (
    "the .uf2 for the board is at circuitpython.org/downloads: double-press reset, or hold BOOTSEL while plugging in,"
    " and drop it on the drive that appears"
)


@dataclass(frozen=True)
class Drive:
    """A board's drive: where it is mounted, and what its boot_out.txt says. uid is upper-case hex, or ""."""

    path: Path
    version: str
    name: str
    board_id: str = ""
    uid: str = ""

    def __str__(self) -> str:
        return f"{self.path} ({self.name})"

    @property
    def has_mountfw(self) -> bool:
        """True if the firmware has been put there."""
        return (self.path / "mountfw").is_dir()


def find_drives() -> list[Drive]:
    """The CircuitPython drives that are mounted."""
    return [drive for path in volumes.mounted() if (drive := read_drive(path))]


def read_drive(path: Path) -> Drive | None:
    """The drive at path, or None if no CircuitPython has written a boot_out.txt there."""
    try:
        with open(path / "boot_out.txt", "rb") as f:
            text = f.read(_LONGEST).decode("utf-8", "replace")
    except OSError:
        return None
    found = _FIRST_LINE.match(text)
    if not found:
        return None
    told = dict(line.split(":", 1) for line in text.splitlines() if line.startswith(("Board ID:", "UID:")))
    return Drive(
        path, found[1], found[2].strip(), told.get("Board ID", "").strip(), told.get("UID", "").strip().upper()
    )


def drive_at(path: Path) -> Drive:
    """The drive that somebody has named. Raises WrongDrive."""
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
    """Raise WrongDrive for a CircuitPython that is too old. A build without a number is taken as new."""
    number = re.match(r"(\d+)\.(\d+)", drive.version)
    if number and CIRCUITPYTHON.too_old((int(number[1]), int(number[2]))):
        raise WrongDrive(
            f"{drive} runs CircuitPython {drive.version}: {text(CIRCUITPYTHON.lowest)} or later is needed, for older"
            f" ones cannot switch their watchdog off as the firmware does ({GET_IT})"
        )


def is_bootloader(path: Path) -> bool:
    """True for the drive of a UF2 bootloader, for instance RPI-RP2."""
    return (path / "INFO_UF2.TXT").exists()


def find_bootloaders() -> list[Path]:
    """The bootloader drives that are mounted."""
    return [path for path in volumes.mounted() if is_bootloader(path)]
