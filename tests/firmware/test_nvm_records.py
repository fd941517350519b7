"""Files as records in a non-volatile memory, with the power cut at every byte. Runs under CPython and MicroPython."""

from mountfw.ports.circuitpython_nvm import NvmRecords

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

    def __len__(self):
        return len(self.data)

    def __getitem__(self, key):
        return self.data[key]

    def __setitem__(self, key, value):
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


def put(records, name, data):
    records.store(name + ".new", data)
    records.rename(name + ".new", name)


def test_what_was_put_is_there_after_a_restart():
    nvm = Nvm()
    records = NvmRecords(nvm)
    put(records, SETTINGS, b"one")
    put(records, POSITION, b"two\xff\xff\xff\xff")
    put(records, SETTINGS, b"three")
    assert nvm.erases == 0
    for again in (records, NvmRecords(nvm)):
        assert (again.load(SETTINGS), again.load(POSITION)) == (b"three", b"two\xff\xff\xff\xff")


def test_what_was_removed_is_not_there_and_cannot_be_removed_twice():
    nvm = Nvm()
    records = NvmRecords(nvm)
    put(records, POSITION, b"here")
    records.remove(POSITION)
    for again in (records, NvmRecords(nvm)):
        assert again.load(POSITION) is None
        try:
            again.remove(POSITION)
            raise AssertionError
        except OSError as e:
            assert e.args[0] == 2


def test_a_power_cut_at_any_byte_of_a_record_leaves_the_old_one_and_room_for_the_next():
    for left in range(30):
        nvm = Nvm()
        records = NvmRecords(nvm)
        put(records, SETTINGS, b"the old settings")
        put(records, POSITION, b"a place")
        nvm.left = left
        try:
            put(records, SETTINGS, b"the new settings!")
            cut = False
        except PowerCut:
            cut = True
        nvm.left = -1
        again = NvmRecords(nvm)
        assert again.load(SETTINGS) == (b"the old settings" if cut else b"the new settings!"), left
        assert again.load(POSITION) == b"a place"
        put(again, SETTINGS, b"and the next")
        assert NvmRecords(nvm).load(SETTINGS) == b"and the next"
        assert nvm.erases == 0
    assert not cut


def test_a_power_cut_while_a_record_is_removed_leaves_it_or_not_and_nothing_else():
    for left in range(9):
        nvm = Nvm()
        records = NvmRecords(nvm)
        put(records, SETTINGS, b"settings")
        put(records, POSITION, b"a place")
        nvm.left = left
        try:
            records.remove(POSITION)
            kept = None
        except PowerCut:
            kept = b"a place"
        nvm.left = -1
        again = NvmRecords(nvm)
        assert (again.load(SETTINGS), again.load(POSITION)) == (b"settings", kept), left


def test_a_full_memory_is_written_anew_with_what_is_in_use():
    nvm = Nvm()
    records = NvmRecords(nvm)
    put(records, SETTINGS, b"s" * 100)
    for i in range(100):
        put(records, POSITION, b"%030d" % i)
        records.remove(POSITION)
    assert 8 < nvm.erases < 15  # of 200 records
    put(records, POSITION, b"last")
    again = NvmRecords(nvm)
    assert (again.load(SETTINGS), again.load(POSITION)) == (b"s" * 100, b"last")


def test_what_does_not_fit_is_refused_and_the_old_stays():
    nvm = Nvm(64)
    records = NvmRecords(nvm)
    put(records, SETTINGS, b"small")
    for data in (b"x" * 60, b"x" * 50):
        try:
            put(records, POSITION, data)
            raise AssertionError
        except OSError as e:
            assert e.args[0] == 28
    assert NvmRecords(nvm).load(SETTINGS) == b"small"


def test_a_memory_that_was_never_written_is_empty_and_one_of_somebody_else_is_damaged():
    for blank in (0, 0xFF):
        nvm = Nvm(blank=blank)
        records = NvmRecords(nvm)
        assert records.load(SETTINGS) is None
        put(records, SETTINGS, b"mine")
        assert NvmRecords(nvm).load(SETTINGS) == b"mine"
    nvm = Nvm()
    nvm.data[3:10] = b"foreign"
    assert NvmRecords(nvm).load(SETTINGS) == b""
    assert NvmRecords(nvm).load(POSITION) is None
