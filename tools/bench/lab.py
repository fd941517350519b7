"""Emulated boards to measure on: bytes at exact instants, pin edges with their times. Needs the host package.

Every board runs a real MicroPython image in lockstep (mirrormount_sim), with the firmware on it as
`mirrormount deploy` leaves it. Times are microseconds of the board's own time since power-up.
"""

import math
import random
import re
import shutil
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

from mirrormount_sim import emulator
from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.clocks import Lockstep
from mirrormount_sim.emulator import RawPrompt
from mirrormount_sim.machines import board_text
from mirrormount_sim.simulation import Simulation

ENABLES = ("m1_en", "m2_en")
LOST = math.inf  # what never happened
USB_US = 10  # the emulated controller takes so long for a packet: a stop lands then

_PATIENCE_US = 20_000_000
_ASK_US = 1_000_000  # ask again if no answer came: while the board's output is full it drops what it cannot say
_LOOK_US = 20  # between two looks whether a packet has landed
_REST_US = 5_000  # the pass that answered is over
_SHORTLY_US = 50_000  # much less than a start takes
_CLOSED = b"1XN280;2XN280;1MM1;2MM1;SM\n"  # saved: a reset does not end it
_DEAF_US = 60_000  # a host that does not read cannot ask

Edge = tuple[int, str, int]  # time, pin, duty 0 ... 65535


def last_fall_us(edges: list[Edge], since_us: int, pins: tuple[str, ...] = ENABLES) -> int:
    """When, at or after since_us, the last one of pins went low for good; since_us if all were low."""
    return max((us for us, pin, duty in edges if us >= since_us and pin in pins and not duty), default=since_us)


def first_low_us(edges: list[Edge], since_us: int, high_before: Iterable[str] = ENABLES) -> float:
    """When, at or after since_us, both enables were low at once for the first time; LOST if never.

    high_before: those that were high at since_us.
    """
    high = set(high_before)
    if not high:
        return since_us
    for us, pin, duty in edges:
        if us >= since_us and pin in ENABLES:
            (high.add if duty else high.discard)(pin)
            if not high:
                return us
    return LOST


def on_times_us(edges: list[Edge], pin: str) -> list[int]:
    """How long pin was high, each time."""
    times, since = [], None
    for us, name, duty in edges:
        if name == pin and duty and since is None:
            since = us
        elif name == pin and not duty and since is not None:
            times.append(us - since)
            since = None
    return times


class Board(Lockstep):
    """A board that has started. deaf: its host does not read."""

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(simulation)
        self.deaf = False
        self._asked = 0

    def hear(self, reads: bool) -> None:
        """Let the host read what the board sends, or stop reading."""
        self.deaf = not reads
        self.simulation.collects(reads)

    @property
    def us(self) -> int:
        """Now."""
        return self.simulation.us

    @property
    def edges(self) -> list[Edge]:
        """All edges since forget()."""
        return self.simulation.edges

    def forget(self) -> None:
        """Drop the edges so far, and what was received."""
        self.simulation.edges.clear()
        self.received.clear()

    def give(self, data: bytes) -> int:
        """Hand bytes to the board's USB host now, all at once. Returns when that is: the time of landing."""
        landed_us = self.us
        self.simulation.go(self.simulation.now_us, 1, data)
        self._wants_us = self.simulation.next_wait()
        return landed_us

    def land(self, data: bytes) -> int:
        """give(), and let time pass until the last byte is in the board's USB memory. Returns when that is.

        A packet that comes soon after another waits in the host until the board's USB stack has asked for it.
        Raises TimeoutError if it does not.
        """
        given_us = self.give(data)
        end_us = self.us + _PATIENCE_US
        while self.us < end_us:
            landed_us, waiting = self.simulation.landed
            if landed_us > given_us and not waiting:
                return landed_us
            self.run(_LOOK_US)
        raise TimeoutError("the board asks for no more packets")

    def until_us(self, us: int) -> None:
        """Let time pass until us."""
        self.run(max(0, us - self.us))

    def off(self) -> bool:
        """Both enables low."""
        duties = self.simulation.bench.duties()
        return not (duties["m1_en"] or duties["m2_en"])

    def catch_up(self, patience_us: int = _PATIENCE_US) -> bool:
        """Let the board obey and answer all that it was given, and come to rest. False if it took longer.

        A host that does not read just waits.
        """
        if self.deaf:
            return not self.run(_DEAF_US)
        if not self.ask(b"1MD?", patience_us, b"\n"):
            return False
        self.run(_REST_US)
        return True

    def do(self, data: bytes) -> None:
        """Have messages obeyed, and forget what there was to see."""
        self.give(data)
        self.catch_up()
        self.forget()

    def clear(self) -> None:
        """Both motors off, no message half said."""
        self.do(b"!\n")

    def fresh(self) -> None:
        """As clear(), but by a reset if what is still to be obeyed and answered would take long: settings go."""
        self.give(b"!\n")
        if self.deaf or not self.catch_up(_SHORTLY_US):
            self.simulation.reset(power=False)
            self.simulation.lit = False
            self.boot()
            self.run(_PATIENCE_US, lambda: self.simulation.usb)
            self.catch_up()
        self.forget()

    def ask(self, line: bytes, patience_us: int = _PATIENCE_US, before: bytes = b"") -> str:
        """The answer to a line of queries; empty if none comes. before is said before each attempt.

        The address comes back with it (docs/protocol.md), spelled in two ways by turns: answers keep their order, so a
        late one is to the line before, which was spelled in the other way.
        """
        self._asked += 1
        address = (b"1>", b"01>")[self._asked % 2]
        answer = re.compile(rb"(?m)^" + address + rb"(.*)\r\n")
        self.received.clear()
        for _ in range(0, patience_us, _ASK_US):
            self.give(before + address + line + b"\n")
            if self.run(min(_ASK_US, patience_us), lambda: answer.search(self.received) is not None):
                break
        said = answer.search(self.received)
        return said[1].decode() if said else ""

    def stopped_after_us(self, landed_us: int) -> float:
        """From a stop's landing to both enables being low for good; LOST if they are not."""
        self.catch_up()
        landed_us += USB_US
        return last_fall_us(self.edges, landed_us) - landed_us if self.off() else LOST


class Lab:
    """Makes boards for one measurement, counts its trials, and cleans up after it.

    gate: False for a board file that leaves the gate out; closed: with encoders on the motors, and both axes in the
    closed loop.
    """

    def __init__(
        self,
        name: str,
        n: int,
        image: Path | None = None,
        *,
        gate: bool = True,
        closed: bool = False,
    ) -> None:
        self.n = n
        self.random = random.Random(name)  # the same moments in every run
        self._name = name
        self._image = image
        self._gate = gate
        self.closed = closed
        self._encoder = "motor" if closed else None
        self._folder = TemporaryDirectory(prefix="mirrormount-bench-")
        self._boards: list[Board] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception: object) -> None:
        for board in self._boards:
            board.simulation.close()
        self._folder.cleanup()

    def board(self, *, switches: bool = False) -> Board:
        """A new board that has started. switches: end-stops wired."""
        text = board_text("pico", 2, self._encoder)
        if not self._gate:
            text = (text or "from mountfw.boards.pico import *\n") + "\nGATE = False\n"
        flash = Path(self._folder.name) / f"{len(self._boards)}.bin"
        shutil.copyfile(emulator.flash_with_firmware(self._image, board=text), flash)
        bench = "switches" if switches else "paper"
        options = Options("rp2040", image=self._image, flash=flash, bench=bench, encoder=self._encoder)
        board = Board(make_simulation(options))
        self._boards.append(board)
        board.clear()
        if self._encoder:
            board.do(_CLOSED)
        return board

    def trials(self, n: int | None = None) -> Iterator[int]:
        """0, 1, 2 ... n-1 (default: as many trials as were asked for), with progress on stderr."""
        n = n or self.n
        shown = 0.0
        for trial in range(n):
            if sys.stderr.isatty() and time.monotonic() > shown + 0.5:
                shown = time.monotonic()
                print(f"\r{self._name}: {trial}/{n} ", end="", file=sys.stderr, flush=True)
            yield trial


# The loop notes how long a pass has taken: there, at the end of each, it hangs while a motor is driven.
_HANGING = """
from mountfw.build import build
from mountfw.ports import micropython as port
board = port.find_board()
a = build(port, board)
about = a.queries.about
passed = about.passed
def ended(us):
    passed(us)
    while a.controller.driving():
        pass
about.passed = ended
try:
    a.run()
finally:
    port.leave(board)
"""


def start_hanging(board: Board) -> None:
    """Start the firmware anew; the loop hangs with the first drive, until the watchdog resets the board."""
    RawPrompt(board)
    board.simulation.lit = False
    board.give(_HANGING.encode() + b"\x04")
    board.boot()
    board.clear()
