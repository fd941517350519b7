"""Files of a CircuitPython board: on its drive if the board may write there, in its non-volatile memory if a PC may.

The board may write to the drive if boot.py has called storage.remount or storage.disable_usb_drive.
"""

import binascii
import os

import microcontroller
import storage

from mountfw.ports.circuitpython_nvm import NvmRecords
from mountfw.ports.shared import firmware_files, read_file

_SETTINGS = "mountfw.settings"

_nvm = microcontroller.nvm
_records = NvmRecords(_nvm) if _nvm and storage.getmount("/").readonly else None  # None: the drive has them


def load(name):
    """The first bytes of a file, b"" if it cannot be read, None if it is absent."""
    if _records:
        return _records.load(name)
    data = read_file(name)
    if data is None and name == _SETTINGS:  # a power cut in the middle of rename()
        data = read_file(name + ".new")
    return data


def store(name, data):
    """Make a file of these bytes. Raises OSError."""
    if _records:
        _records.store(name, data)
        return
    with open(name, "wb") as f:
        f.write(data)
    os.sync()


def rename(old, new):
    """Rename a file, replacing one that has the new name. Raises OSError.

    FAT does that in two steps. A power cut between them leaves the old name, which load() reads, too.
    """
    if _records:
        _records.rename(old, new)
        return
    os.rename(old, new)
    os.sync()


def remove(name):
    """Remove a file. Raises OSError."""
    if _records:
        _records.remove(name)
        return
    os.remove(name)
    os.sync()


def firmware_hash():
    """Yield None after each part of the work, and last the SHA-256, as hex (bytes), over the firmware's files.

    These are boot.py, code.py and every .py and .mpy of mountfw on the drive. For each, in the order of their names
    from the root on: the name, then the SHA-256 of the file (32 bytes). Builds before CircuitPython 10.1 have no
    SHA-256: they yield `crc32-` and the CRC-32 of names and contents. Raises OSError.
    """
    total = _sha256()
    crc = 0
    for name, path in firmware_files(os.listdir, __file__, ("boot.py", "code.py")):
        crc = binascii.crc32(name.encode(), crc)
        file_hash = _sha256()
        with open(path, "rb") as f:
            while True:
                part = f.read(512)
                if not part:
                    break
                crc = binascii.crc32(part, crc)
                if file_hash:
                    file_hash.update(part)
                yield None
        if total and file_hash:
            total.update(name.encode())
            total.update(file_hash.digest())
    yield b"sha256-" + binascii.hexlify(total.digest()) if total else b"crc32-%08x" % (crc & 0xFFFFFFFF)


def _sha256():
    """A new SHA-256, or None where this build has none."""
    try:
        import hashlib

        return hashlib.new("sha256")
    except (ImportError, ValueError):
        return None
