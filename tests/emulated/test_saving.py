"""What the flash of the emulated RP2040 holds after a power cut in a save or a motion: LittleFS has its part in it.

One board goes through all cuts of a test, so that a cut finds what the cuts before it have left.
"""

import random
import shutil
from collections.abc import Iterator

import pytest
from power import Board, PowerCut, compiled

from mirrormount.errors import EmulatorMissing
from mirrormount_sim import emulator

PATIENCE_US = 3_000_000
RECORDED_US = 10_800_000  # after that much rest the position is on the flash
NEVER = 1_000_000  # operations
FIRST_DRIVE_US = 150_000  # a motion may start that late when a record must go first
SETTINGS = (b"1XP50000;2XV90;2XB5000\n", b"1XP60000;2XV91;2XB7000\n")
ASK_SETTINGS = b"1XP?;2XV?;2XB?\n"
ANSWERS = (b"50000; 90; 5000\r\n", b"60000; 91; 7000\r\n")


class Mount(Board):
    """A board at its line protocol. which says which of the SETTINGS are on its flash."""

    which = 0

    def ask(self, line: bytes) -> bytes:
        self.received.clear()
        self.send(line)
        assert self.run(PATIENCE_US, lambda: b"\n" in self.received), bytes(self.received)
        return bytes(self.received)

    def positions(self) -> list[tuple[int, int]]:
        """Of each axis, in thousandths of a step, and certainty."""
        axes = [text.split(b",") for text in self.ask(b"XS?\n").split(b"|")[1:]]
        return [(int(axis[0]), int(axis[5])) for axis in axes]

    def record(self, steps: int) -> None:
        """Call axis 1's position `steps`, axis 2's the opposite, and rest until that is recorded."""
        self.ask(b"1DH%d;2DH%d;TE?\n" % (steps, -steps))
        assert self.count(lambda: self.run(RECORDED_US)) >= 2

    def cut_in(self, line: bytes, us: int) -> bool:
        """Do a line, lose the power after us at the latest, start again. Was it in an operation of the flash?"""
        self.simulation.edges.clear()
        self.send(line)
        in_operation = False
        try:
            self.run(us)
            self.simulation.cut_power(NEVER, half=False)
            self.power_cycle()
        except PowerCut:
            in_operation = True
        self.boot()
        return in_operation

    def drove(self) -> bool:
        """Has an enable risen since the last line that was cut?"""
        return any(duty for _, pin, duty in self.simulation.edges if pin.endswith("_en"))

    def check(self, steps: int, may_be: tuple[int, ...]) -> None:
        """After a cut: whole settings, one of may_be; each position `steps`, if it was not left, or unknown."""
        settings = self.ask(ASK_SETTINGS)
        assert settings in [ANSWERS[i] for i in may_be]
        self.which = ANSWERS.index(settings)
        assert self.ask(b"TE?\n") == b"0\r\n"
        for (millisteps, certainty), sign in zip(self.positions(), (1, -1), strict=True):
            assert certainty == 0 or (millisteps == sign * steps * 1000 and not self.drove())


@pytest.fixture(scope="module")
def board(tmp_path_factory) -> Iterator[Mount]:
    """A board with the first of the SETTINGS saved."""
    try:
        flash = emulator.flash_with_firmware(None, compiled())
    except EmulatorMissing as e:
        pytest.skip(str(e))
    board = Mount(shutil.copyfile(flash, tmp_path_factory.mktemp("saving") / "flash.bin"))
    board.boot()
    board.ask(SETTINGS[0] + b"SM;TE?\n")
    yield board
    board.simulation.close()


@pytest.fixture
def tell(capsys):
    def printed(text: str) -> None:
        with capsys.disabled():
            print(f" [{text}]", end="", flush=True)

    return printed


def test_saved_settings_and_a_recorded_position_survive_a_power_cycle(board):
    board.record(7)
    board.power_cycle()
    board.boot()
    assert board.ask(ASK_SETTINGS) == ANSWERS[board.which]
    assert board.positions() == [(7000, 1), (-7000, 1)]
    assert board.ask(b"TE?\n") == b"0\r\n"


@pytest.mark.full
def test_a_cut_at_an_operation_of_a_save_leaves_the_old_settings_or_the_new_ones_whole(board, tell):
    places = random.Random(17)
    cuts = 0
    became = set()
    for operation in (1, 2, 3, 4, 5, 6, 7, 8, 9, 10):
        old, new = board.which, 1 - board.which
        board.record(operation)
        board.ask(SETTINGS[new] + b"TE?\n")
        board.cut_after(operation, half=places.random() < 0.5)
        cuts += board.cut_in(b"SM\n", 300_000)
        board.check(operation, (old, new))
        became.add(board.which == new)
    assert cuts >= 6
    assert became == {False, True}
    tell(f"{cuts} power cuts")


@pytest.mark.full
def test_a_cut_while_a_record_comes_leaves_the_right_position_or_none(board, tell):
    cuts = 0
    for operation in (1, 2, 3, 1, 2, 3):
        board.record(20 + operation)
        board.ask(b"1DH%d;2DH%d;TE?\n" % (operation, -operation))
        board.cut_after(operation, half=cuts % 2 == 0)
        cuts += board.cut_in(b"\n", RECORDED_US)
        board.check(operation, (board.which,))
    assert cuts >= 4
    tell(f"{cuts} power cuts")


@pytest.mark.full
def test_a_cut_in_a_motion_after_a_record_leaves_the_position_unknown(board, tell):
    places = random.Random(19)
    moved = 0
    for half, line in ((False, b"1PR3\n"), (True, b"02550255"), (None, b"2MV-\n"), (None, b"1PR3;2PR-3\n")):
        board.record(5)
        if half is not None:
            board.cut_after(1, half=half)
        board.cut_in(line, places.randint(20_000, 700_000))
        board.check(5, (board.which,))
        if half is None:
            assert board.drove()
            assert [certainty for _, certainty in board.positions()] == [0, 0]
            moved += 1
    assert moved == 2
    tell("4 power cuts")


@pytest.mark.full
def test_the_first_motion_after_a_record_starts_within_150_ms(board, tell):
    late_us = []
    for i in range(16):
        board.record(i)
        board.simulation.edges.clear()
        start_us = board.simulation.us
        board.send(b"1PR1\n")
        assert board.run(1_000_000, board.drove)
        (at_us,) = [us for us, pin, duty in board.simulation.edges if pin == "m1_en" and duty]
        late_us.append(at_us - start_us)
        board.run(200_000)
    assert max(late_us) <= FIRST_DRIVE_US
    tell(f"from the byte to the enable {min(late_us)} to {max(late_us)} us")
