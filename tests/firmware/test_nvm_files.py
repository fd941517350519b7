"""Two files in one block of a memory, with the power cut at every byte. Runs under CPython and MicroPython."""

import sys
from binascii import crc32


class _Stub:
    nvm = None


_stubs = [name for name in ("microcontroller", "storage") if name not in sys.modules]
for _name in _stubs:
    sys.modules[_name] = _Stub
from mountfw.ports.circuitpython_storage import NvmFiles  # noqa: E402

for _name in _stubs:
    del sys.modules[_name]

SETTINGS = "mountfw.settings"
POSITION = "mountfw.position"


class PowerCut(Exception):
    pass


class Nvm:
    """An RP2040's: erased bytes can be programmed, anything else erases all of it first. May fail after some bytes."""

    def __init__(self, size=512, blank=0xFF):
        self.data = bytearray([blank] * size)
        self.erases = 0
        self.left = -1  # bytes until the power goes; -1: it stays
        self.refuses = None  # an error that a write raises

    def __len__(self):
        return len(self.data)

    def __getitem__(self, key):
        return self.data[key]

    def __setitem__(self, key, value):
        if self.refuses:
            raise self.refuses
        assert len(self.data[key]) == len(value), "a slice takes as many bytes as it has"
        at = key.start
        if [c for c in self.data[key] if c != 0xFF]:
            self.erases += 1
            whole = bytearray(self.data)
            whole[key] = value
            self.data = bytearray(b"\xff" * len(whole))
            at, value = 0, whole
        for c in value:
            if self.left == 0:
                raise PowerCut
            self.left -= 1
            self.data[at] = c
            at += 1


def put(files, name, data):
    files.store(name + ".new", data)
    files.rename(name + ".new", name)


def test_what_was_put_is_there_after_a_restart():
    nvm = Nvm()
    files = NvmFiles(nvm)
    put(files, SETTINGS, b"one")
    put(files, POSITION, b"two\xff\xff\xff\xff")
    put(files, SETTINGS, b"three")
    for again in (files, NvmFiles(nvm)):
        assert (again.load(SETTINGS), again.load(POSITION)) == (b"three", b"two\xff\xff\xff\xff")


def test_what_was_removed_is_not_there_cannot_be_removed_twice_and_erases_nothing():
    nvm = Nvm()
    files = NvmFiles(nvm)
    put(files, SETTINGS, b"settings")
    put(files, POSITION, b"here")
    erases = nvm.erases
    files.remove(POSITION)
    assert nvm.erases == erases
    for again in (files, NvmFiles(nvm)):
        assert (again.load(SETTINGS), again.load(POSITION)) == (b"settings", None)
        try:
            again.remove(POSITION)
            raise AssertionError
        except OSError as e:
            assert e.args[0] == 2
    put(files, POSITION, b"there")
    assert NvmFiles(nvm).load(POSITION) == b"there"


def test_a_power_cut_at_any_byte_of_the_block_leaves_the_new_files_or_none_and_says_so():
    for left in range(600):
        nvm = Nvm()
        files = NvmFiles(nvm)
        put(files, SETTINGS, b"the settings")
        put(files, POSITION, b"a place")
        files.remove(POSITION)
        nvm.left = left
        try:
            put(files, POSITION, b"another place")
            cut = False
        except PowerCut:
            cut = True
        nvm.left = -1
        again = NvmFiles(nvm)
        found = again.load(SETTINGS), again.load(POSITION)
        lost = (b"" if left else None, None)  # right after it was erased, the memory is as if nothing had been there
        assert found == (b"the settings", b"another place") or (cut and found == lost), left
        put(again, SETTINGS, b"and the next")
        assert NvmFiles(nvm).load(SETTINGS) == b"and the next"
        if not cut:
            return
    raise AssertionError


def test_what_does_not_fit_is_refused_and_the_old_stays():
    nvm = Nvm(64)
    files = NvmFiles(nvm)
    put(files, SETTINGS, b"small")
    for data in (b"x" * 60, b"x" * 51):
        try:
            put(files, POSITION, data)
            raise AssertionError
        except OSError as e:
            assert e.args[0] == 28
    assert NvmFiles(nvm).load(SETTINGS) == b"small"
    put(files, POSITION, b"x" * 50)
    assert NvmFiles(nvm).load(POSITION) == b"x" * 50


def test_a_memory_that_cannot_be_written_for_want_of_heap_is_told_as_every_failure_is_and_the_old_stays():
    nvm = Nvm()
    files = NvmFiles(nvm)
    put(files, SETTINGS, b"old")
    nvm.refuses = MemoryError  # an ESP32's port copies all of it to write one byte
    try:
        put(files, SETTINGS, b"new")
        raise AssertionError
    except OSError as e:
        assert e.args[0] == 5
    nvm.refuses = None
    assert NvmFiles(nvm).load(SETTINGS) == b"old"


def test_a_memory_that_was_never_written_is_empty_and_one_of_somebody_else_is_damaged():
    for blank in (0, 0xFF):
        nvm = Nvm(blank=blank)
        files = NvmFiles(nvm)
        assert files.load(SETTINGS) is None
        put(files, SETTINGS, b"mine")
        assert NvmFiles(nvm).load(SETTINGS) == b"mine"
    nvm = Nvm()
    nvm.data[3:10] = b"foreign"
    assert NvmFiles(nvm).load(SETTINGS) == b""
    assert NvmFiles(nvm).load(POSITION) is None


def test_the_settings_that_an_older_firmware_appended_are_read_and_kept():
    nvm = Nvm()
    at = 0
    for head, data in ((0xC0, b"older"), (0xC1, b"a place"), (0xC0, b"the last"), (0xA1, b"")):
        record = bytes((head, len(data), 0)) + data
        record += (crc32(record) & 0xFFFFFFFF).to_bytes(4, "little") + b"\x5a"
        nvm.data[at : at + len(record)] = record
        at += len(record)
    nvm.data[at] = 0xC0  # the power went
    files = NvmFiles(nvm)
    assert (files.load(SETTINGS), files.load(POSITION)) == (b"the last", None)
    put(files, POSITION, b"here")
    again = NvmFiles(nvm)
    assert (again.load(SETTINGS), again.load(POSITION)) == (b"the last", b"here")
