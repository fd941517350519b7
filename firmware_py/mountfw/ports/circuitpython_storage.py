"""Files of a CircuitPython board: on its drive if the board may write there, in its non-volatile memory if a PC may.

The board may write to the drive if boot.py has called storage.remount or storage.disable_usb_drive.
"""

import os
from binascii import crc32, hexlify

import microcontroller
import storage

from mountfw.ports.shared import firmware_files, read_file

_SETTINGS = "mountfw.settings"
_POSITION = "mountfw.position"
_NEW = ".new"
_NO_SUCH_FILE = 2  # ENOENT
_EIO = 5
_FULL = 28  # ENOSPC
_AROUND = 9  # bytes of the block that are no content


class NvmFiles:
    """The same two files in one block of a non-volatile memory, nvm, which is like a bytearray.

        length of the settings (2 bytes), of the position (2), settings, position, CRC-32 of all before (4), mark

    A length of 0: there is no such file. The mark is an erased byte, or 0 if the position was removed since.
    CircuitPython erases the memory as a whole when a byte is written that is not erased, and only then. So to remove
    the position erases nothing. A power cut while the block is written loses both files.
    """

    def __init__(self, nvm):
        self._nvm = nvm
        self._waiting = {}  # content of the names that end in `.new`, until they are renamed
        self._files = {}
        self._mark = 0  # where it is
        data = bytes(nvm[0 : len(nvm)])
        half = int.from_bytes(data[0:2], "little")
        length = half + int.from_bytes(data[2:4], "little") + 4
        self._damaged = False
        if _is_sealed(data, 0, length):
            self._mark = length + 4
            self._files[_SETTINGS] = data[4 : 4 + half]
            if data[self._mark] == 0xFF:
                self._files[_POSITION] = data[4 + half : length]
        else:
            self._files[_SETTINGS] = _settings_of_log(data)
            unused = (b"\xff" * len(data), bytes(len(data)))  # zeros: an ESP32's memory that was never written
            self._damaged = not (self._files[_SETTINGS] or data in unused)

    def load(self, name):
        """The content; b"" if the memory is damaged, None if the file is absent."""
        found = self._waiting.get(name) or self._files.get(name)
        return found or (b"" if self._damaged and name == _SETTINGS else None)

    def store(self, name, data):
        """Keep data, under a name that ends in `.new`, until it is renamed."""
        self._waiting[name] = bytes(data)

    def rename(self, old, new):
        """Write the data stored under old, as new. Raises OSError if there is none, or no room."""
        if old not in self._waiting:
            raise OSError(_NO_SUCH_FILE)
        files = dict(self._files)
        files[new] = self._waiting[old]
        settings, position = files.get(_SETTINGS, b""), files.get(_POSITION, b"")
        block = len(settings).to_bytes(2, "little") + len(position).to_bytes(2, "little") + settings + position
        block += (crc32(block) & 0xFFFFFFFF).to_bytes(4, "little") + b"\xff"
        if len(block) > len(self._nvm):
            raise OSError(_FULL)
        self._write(0, block)
        self._mark = len(block) - 1
        self._files = files
        self._damaged = False
        del self._waiting[old]

    def remove(self, name):
        """Remove the position. Raises OSError if there is none."""
        if name != _POSITION or not self._files.get(name):
            raise OSError(_NO_SUCH_FILE)
        self._write(self._mark, b"\0")
        del self._files[name]

    def _write(self, at, data):
        try:
            self._nvm[at : at + len(data)] = data
        except (RuntimeError, MemoryError):  # CircuitPython's, if the memory refuses; an ESP32 first needs 8 KB for it
            raise OSError(_EIO) from None


def _is_sealed(data, start, end):
    """True if the bytes from start to end are followed by their CRC-32, and that by one byte more."""
    checksum = int.from_bytes(data[end : end + 4], "little")
    return end + _AROUND - 4 <= len(data) and checksum == crc32(data[start:end]) & 0xFFFFFFFF


def _settings_of_log(data):
    """The last settings that an older firmware appended: 0xC0, length (2 bytes), content, CRC-32. b"" without any."""
    at = len(data)
    while at > 0:
        at = data.rfind(b"\xc0", 0, at)
        end = at + 3 + int.from_bytes(data[at + 1 : at + 3], "little")
        if at >= 0 and _is_sealed(data, at, end):
            return data[at + 3 : end]
    return b""


_nvm = microcontroller.nvm
_records = NvmFiles(_nvm) if _nvm and storage.getmount("/").readonly else None  # None: the drive has them


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
    checksum = 0
    for name, path in firmware_files(os.listdir, __file__, ("boot.py", "code.py")):
        checksum = crc32(name.encode(), checksum)
        file_hash = _sha256()
        with open(path, "rb") as f:
            while True:
                part = f.read(512)
                if not part:
                    break
                checksum = crc32(part, checksum)
                if file_hash:
                    file_hash.update(part)
                yield None
        if total and file_hash:
            total.update(name.encode())
            total.update(file_hash.digest())
    yield b"sha256-" + hexlify(total.digest()) if total else b"crc32-%08x" % (checksum & 0xFFFFFFFF)


def _sha256():
    """A new SHA-256, or None where this build has none."""
    try:
        import hashlib

        return hashlib.new("sha256")
    except (ImportError, ValueError):
        return None
