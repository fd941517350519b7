"""The firmware on every official CircuitPython image of a folder, in the emulated Pico: images.py names the folder."""

import re
from pathlib import Path

import pytest
from images import images

from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.clocks import Lockstep

pytestmark = pytest.mark.full

STEP_US = 1954  # two steps of CircuitPython's clock


class Board(Lockstep):
    """A board with a console beside its port. Its LED shows CircuitPython's state, too: so start() awaits an answer."""

    def __init__(self, image: Path) -> None:
        super().__init__(make_simulation(Options(machine="rp2040", bench="switches", image=image)))
        self.console = bytearray()
        self.simulation.on_console = self.console.append
        self.start()

    def start(self) -> None:
        self.run(2_000_000)  # the reset, if one was asked for, and most of the start
        for _ in range(20):
            if self.ask(b"!\n*IDN?\n", 1_000_000).startswith(b"mirrormount,"):
                self.run(300_000)  # answers to earlier questions
                self.received.clear()
                return
        raise AssertionError(f"the firmware did not start; the console: {bytes(self.console[-400:])!r}")

    def ask(self, data: bytes, us: int = 300_000) -> bytes:
        """Send, wait for a line to come back (at most us), return it."""
        self.received.clear()
        self.send(data)
        self.run(us, lambda: b"\n" in self.received)
        return bytes(self.received)

    def drives(self) -> dict[str, float]:
        """What every drive pin shows now, 0 ... 1."""
        return dict(self.simulation.bench.duties())

    def off(self) -> bool:
        return not any(self.drives().values())

    def went_high(self, since_us: int) -> list[str]:
        """The pins that went high after since_us."""
        return [pin for t, pin, duty in self.simulation.edges if t >= since_us and duty]

    def type(self, text: bytes, until: bytes) -> str:
        """Type at the console, and wait for `until` there. Returns what came."""
        self.console.clear()
        self.simulation.type(text)
        assert self.run(5_000_000, lambda: until in self.console), bytes(self.console[-400:])
        return self.console.decode(errors="replace")

    def first(self, pin: str, high: bool, since_us: int) -> int:
        """When, in microseconds after since_us, that pin first went high or low."""
        edges = [(t - since_us, (name, duty > 0)) for t, name, duty in self.simulation.edges]
        return next(t for t, edge in edges if t >= 0 and edge == (pin, high))

    def rest(self) -> None:
        """Have both motors at rest, and the errors read."""
        self.send(b"!\n")
        self.run(600_000)
        while self.ask(b"TE?\n") != b"0\r\n":
            pass


@pytest.fixture(scope="module", params=images(circuitpython=True), ids=lambda image: image.name)
def running(request):
    board = Board(request.param)
    yield board
    board.simulation.close()


@pytest.fixture
def board(running):
    running.rest()
    return running


def test_it_tells_the_chip_s_number_and_its_hash_where_the_build_can_make_one(board):
    assert re.fullmatch(rb"mirrormount,Raspberry Pi Pico,[0-9a-f]{16},[0-9.]+\r\n", board.ask(b"*IDN?\n"))
    hashed = board.ask(b"XF?\n", 60_000_000)  # every file is read now, for the first time
    assert re.fullmatch(rb"(crc32-[0-9a-f]{8}|[0-9a-f]{64})\r\n", hashed)


@pytest.mark.parametrize("asked_us", [200_000, 20_000])
def test_a_step_lasts_what_was_asked_to_two_steps_of_the_clock(board, asked_us):
    board.send(b"1XP%d\n" % asked_us)
    board.run(100_000)
    for command, leg in ((b"1PR1\n", "m1_pos"), (b"1PR-1\n", "m1_neg")):
        since = board.simulation.us
        board.send(command)
        board.run(asked_us + 400_000)
        assert board.went_high(since) == [leg, "m1_en"]
        lasted = board.first("m1_en", False, since) - board.first("m1_en", True, since)
        assert abs(lasted - asked_us) < STEP_US
    assert board.off()
    board.send(b"1XP200000\n")


def test_a_stop_has_every_pin_low_within_a_millisecond(board):
    for trial in range(5):
        board.send(b"02550255")
        board.run(60_000 + 1371 * trial)
        assert not board.off()
        board.send(b"!\n")
        board.run(1_000)
        assert board.off(), board.drives()


def test_a_host_that_goes_stops_what_moves(board):
    board.send(b"1MV+\n")
    board.run(60_000)
    assert not board.off()
    board.simulation.opened(False)
    board.run(25_000)
    assert board.off()
    board.simulation.opened(True)
    board.run(50_000)


def test_an_open_switch_ends_a_move(board):
    board.send(b"1XL3;1DH0;1MV+\n")
    board.run(60_000)
    assert not board.off()
    board.simulation.bench.broken.add("m1_sw_pos")
    board.run(5_000)
    assert board.off()
    assert board.ask(b"TE?\n") == b"104\r\n"
    board.simulation.bench.broken.clear()
    board.send(b"1XL0\n")


def test_the_loop_leaves_the_heap_as_it_is(board):
    free, _, passes, _, _ = (int(n) for n in board.ask(b"XH?\n").split(b","))
    board.send(b"1PR1\n")
    board.run(800_000)
    later_free, _, later_passes, _, _ = (int(n) for n in board.ask(b"XH?\n").split(b","))
    assert later_passes - passes > 10
    assert later_free == free
    assert free > 60_000


def test_ctrl_c_at_the_console_turns_the_motors_off_and_gives_the_prompt(board):
    board.send(b"1MV+\n")
    board.run(60_000)
    board.type(b"\x03", b"motors are off")
    assert board.off()
    board.run(1_000_000)
    board.type(b"\r", b">>> ")
    board.type(b"from mountfw.repl import m\r", b">>> ")
    since = board.simulation.us
    board.type(b"m.x.step(1); print('done')\r", b"\ndone")
    board.run(500_000)
    assert board.went_high(since) == ["m2_pos", "m2_en"]
    board.type(b"\x04", b"code.py")
    board.start()


def test_saved_settings_are_there_after_a_reset_while_the_pc_has_the_drive(board):
    board.send(b"1XP150000;SM\n")
    board.run(500_000)
    board.simulation.reset(power=False)
    board.start()
    assert board.ask(b"1XP?\n") == b"150000\r\n"
