"""Mounted volumes and their free space, on each system. Knows nothing of boards; imports nothing of ours."""

import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

_FAT = {"vfat", "msdos", "exfat", "fuseblk"}  # no board has another one, and a network's may hang
_WINDOWS_REMOVABLE = 2  # GetDriveTypeW of a USB drive
_WINDOWS_READ_ONLY = 0x80000  # FILE_READ_ONLY_VOLUME of GetVolumeInformationW


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
