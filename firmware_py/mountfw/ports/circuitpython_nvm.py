"""Small files in non-volatile memory, as records that are only appended. Pure.

CircuitPython's microcontroller.nvm erases itself as a whole (to 0xFF) when a byte is written that is not erased, and
only then. A record is therefore written to erased bytes, and is valid if its checksum is right: a power cut at any
byte of it leaves the earlier records valid. When a record does not fit any more, all valid records are written anew.
That erases, and does not survive a power cut (docs/circuitpython.md).

    kind and number (1 byte)   length (2)   content   CRC-32 of all before (4)   0x5A
"""

from binascii import crc32

NAMES = ("mountfw.settings", "mountfw.position")  # a record's number is the place in here
_NEW = ".new"

_FILE = 0xC0  # kinds: in the upper bits, so that neither an erased byte nor a zero is one
_REMOVED = 0xA0
_BLANK = b"\xff"
_END = 0x5A  # never blank: marks the end of the last record, before the erased bytes
_AROUND = 8  # bytes of a record that are not content

_NO_SUCH_FILE = 2  # ENOENT
_EIO = 5
_FULL = 28  # ENOSPC


class NvmRecords:
    """load(), store(), rename() and remove() of a port, for store.Records. nvm: the memory, as a bytearray.

    Data that is stored under a name that ends in `.new` waits in RAM until it is renamed: that writes one record.
    """

    def __init__(self, nvm):
        self._nvm = nvm
        self._size = len(nvm)
        self._waiting = {}  # of `.new` names: content
        self._found = {}  # number: (where its content begins, length)
        self._damaged = False
        self._free = 0  # where the next record goes
        self._scan(bytes(nvm[0 : self._size]))

    def load(self, name):
        """The content; b"" if the memory is damaged, None if the file is absent."""
        if name in self._waiting:
            return self._waiting[name]
        found = self._found.get(_number(name))
        if found is None:
            return b"" if self._damaged and name == NAMES[0] else None
        return bytes(self._nvm[found[0] : found[0] + found[1]])

    def store(self, name, data):
        """Store data under a name that ends in `.new`. Raises OSError if it is too long for the memory."""
        if not name.endswith(_NEW) or _number(name[: -len(_NEW)]) < 0:
            raise OSError(_NO_SUCH_FILE)
        if len(data) + _AROUND > self._size:
            raise OSError(_FULL)
        self._waiting[name] = bytes(data)

    def rename(self, old, new):
        """Write the data stored under old, as new. Raises OSError if there is none, or no room."""
        data = self._waiting.get(old)
        number = _number(new)
        if data is None or number < 0:
            raise OSError(_NO_SUCH_FILE)
        record = _record(_FILE | number, data)
        if self._free + len(record) > self._size:
            self._write_anew(number, record)
        else:
            at = self._append(record)
            self._found[number] = (at + 3, len(data))
        del self._waiting[old]

    def remove(self, name):
        """Remove the file. Raises OSError if there is none."""
        number = _number(name)
        if number not in self._found:
            raise OSError(_NO_SUCH_FILE)
        record = _record(_REMOVED | number, b"")
        if self._free + len(record) > self._size:
            self._write_anew(number, b"")
        else:
            self._append(record)
            del self._found[number]

    def _append(self, record):
        at = self._free
        self._free = at + len(record)  # before it is written: after a failure these bytes are not erased any more
        self._write(at, record)
        return at

    def _write(self, at, data):
        try:
            self._nvm[at : at + len(data)] = data
        except RuntimeError:  # CircuitPython's, if the memory refuses
            raise OSError(_EIO) from None
        self._damaged = False

    def _write_anew(self, number, record):
        """Write all valid records, this one instead of the earlier one of its number: one erase."""
        image = record
        found = {number: (3, len(record) - _AROUND)} if record else {}
        for other in self._found:
            if other != number:
                at, length = self._found[other]
                found[other] = (len(image) + 3, length)
                image += bytes(self._nvm[at - 3 : at + length + _AROUND - 3])
        if len(image) > self._size:
            raise OSError(_FULL)
        self._write(0, image + _BLANK * (self._size - len(image)))
        self._found = found
        self._free = len(image)

    def _scan(self, data):
        """Find the last record of each file. Incomplete records of a power cut are skipped byte by byte."""
        end = len(data)
        while end and data[end - 1] == 0xFF:
            end -= 1
        self._free = end
        at = 0
        seen = False
        while at < end:
            length = _length_at(data, at, end)
            if length < 0:
                at += 1
                continue
            seen = True
            number = data[at] & 0x1F
            if data[at] & 0xE0 == _FILE:
                self._found[number] = (at + 3, length)
            else:
                self._found.pop(number, None)
            at += length + _AROUND
        self._damaged = not seen and any(data[0:end])  # zeros: an ESP32's memory that was never written


def _number(name):
    return NAMES.index(name) if name in NAMES else -1


def _record(head, data):
    record = bytes((head, len(data) & 0xFF, len(data) >> 8)) + data
    return record + (crc32(record) & 0xFFFFFFFF).to_bytes(4, "little") + bytes((_END,))


def _length_at(data, at, end):
    """The length of the content of a whole record at `at`; -1 if none is there."""
    if data[at] & 0x1F >= len(NAMES) or data[at] & 0xE0 not in (_FILE, _REMOVED) or at + _AROUND > end:
        return -1
    length = data[at + 1] | data[at + 2] << 8
    after = at + 3 + length
    if after + 5 > end or data[after + 4] != _END:
        return -1
    checksum = int.from_bytes(data[after : after + 4], "little")
    return length if checksum == crc32(data[at:after]) & 0xFFFFFFFF else -1
