"""storage on the virtual CircuitPython board: who may write on the drive: the PC, unless boot.py remounts it."""

import _chip


class _Drive:
    readonly = True


_drive = _Drive()


def getmount(mount_path):
    if mount_path != "/":
        raise OSError(19)
    return _drive


def remount(mount_path, readonly=False):
    if not _chip.in_boot_py:
        raise RuntimeError("Cannot remount path when visible via USB.")
    getmount(mount_path).readonly = readonly
