"""What a CircuitPython board keeps: on its drive if that is the board's own, in its non-volatile memory if a PC has it.

A drive is the board's where boot.py has said so (storage.remount, or storage.disable_usb_drive).
"""

import binascii
import os

import microcontroller
import storage

from mountfw.nvm_circuitpython import NvmRecords

_NO_SUCH_FILE = 2  # ENOENT
_MOST_BYTES = 4096  # more than any file of ours: another one of that name must not fill the memory
_SETTINGS = "mountfw.settings"
_NO_HASH = b"unknown"

_nvm = microcontroller.nvm
_records = NvmRecords(_nvm) if _nvm and storage.getmount("/").readonly else None  # None: the drive has them


def load(name):
    """The first bytes of a file, up to _MOST_BYTES; none if it cannot be read; None if there is no such file."""
    if _records:
        return _records.load(name)
    data = _read(name)
    if data is None and name == _SETTINGS:  # a power cut came in the middle of rename()
        data = _read(name + ".new")
    return data


def _read(name):
    try:
        with open(name, "rb") as f:
            return f.read(_MOST_BYTES)
    except OSError as e:
        return None if e.errno == _NO_SUCH_FILE else b""


def store(name, data):
    """Make a file of these bytes. Raises OSError."""
    if _records:
        _records.store(name, data)
        return
    with open(name, "wb") as f:
        f.write(data)
    os.sync()


def rename(old, new):
    """Have a file under a new name, instead of the one that has it now. Raises OSError.

    FAT does that in two steps, and a power cut between them leaves the old name: load() knows.
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
    """SHA-256, as hex (bytes), over boot.py, code.py and every .py and .mpy of mountfw on the drive.

    For each, in the order of their names from the root on: the name, then the SHA-256 of the file (32 bytes).
    A build without hashlib says `unknown`.
    """
    try:
        import hashlib
    except ImportError:
        return _NO_HASH
    library = __file__.rpartition("/")[0]
    root = library.rpartition("/")[0]
    total = hashlib.new("sha256")
    for folder in ("", "mountfw", "mountfw/boards"):
        place = root + "/" + folder if root or not folder else folder
        for name in sorted(os.listdir(place)):
            if name in ("boot.py", "code.py") if not folder else name.endswith((".py", ".mpy")):
                total.update((folder + "/" + name if folder else name).encode())
                total.update(_file_hash(hashlib.new("sha256"), place.rstrip("/") + "/" + name))
    return binascii.hexlify(total.digest())


def _file_hash(digest, path):
    buffer = bytearray(512)
    view = memoryview(buffer)
    with open(path, "rb") as f:
        while True:
            n = f.readinto(buffer)
            if not n:
                return digest.digest()
            digest.update(view[:n])
