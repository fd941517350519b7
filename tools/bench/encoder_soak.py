"""Counts encoders' edges with the real PIO program on an emulated RP2040, for 100 000 steps, against the bench's truth.

    .venv/bin/python tools/bench/encoder_soak.py [--steps N] [--seed S] [--machine cpython] [--report FILE.md]

Both axes move at once in every round: trains of short steps at twice the supply, steps of the closed loop at 80 to
120 % of it, and runs of 3000 edges a second, while the loop answers queries. At rest after each round the counts that
the board tells are compared with what the discs have turned. The report is written after each round, so it always says
how far it is. A move that did not end as it should is told with its step, and the soak goes on. Exit status 1 if a
count was lost, a move did not end as it should, or the board was lost. --machine cpython is quick, but has no PIO:
it is for the closed loop.
"""

import argparse
import random
import signal
import sys
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

from lab import Board

from mirrormount.errors import MountError
from mirrormount_sim import emulator
from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.simulation import BoardGone

MOTORS = ("m1", "m2")
FAST = 2.15  # times the motors' nominal voltage: more than 3000 edges a second, with the scatter of speeds
FAST_EDGES_S = 3_000  # in a run
FARTHEST = 60_000  # counts from the middle of the travel, from where it goes back
DROPPED, DEAD_BAND = 65, 50  # docs/errors.md; the second is an axis's
DONE = 1  # docs/protocol.md, XE?
MOST_OFF = 2  # counts of a move of the closed loop
HALF_WRAP = 1 << 19  # of XC?
QUERIES = (b"*IDN?;VE?\n", b"XS?\n", b"1TP?;2TP?;XH?\n", b"1XC?;2XC?\n", b"1XE?;2XE?\n")  # none takes an error
REST_US = 1_000  # between two pulses, the least
SETTLE_US, BUSY_US, PATIENCE_US = 200_000, 90_000, 30_000_000
SHOWN_S = 10.0


@dataclass(frozen=True)
class Steps:
    """A kind of moves by steps: their lengths, how many, and at which supplies. counts: of one step; 0: open loop."""

    name: str
    pulses_us: tuple[int, ...]
    counts: int
    n: tuple[int, int]
    supply: tuple[float, float]


TRAIN = Steps("of 8 to 12 ms, open loop, at twice the supply", (8_000, 10_000, 12_000), 0, (100, 160), (FAST, FAST))
CLOSED = Steps("of 140 counts, closed loop, 80 to 120 %", (100_000,), 140, (10, 16), (0.8, 1.2))
WHOLE = Steps("of 280 counts, closed loop, 80 to 120 %", (200_000,), 280, (4, 6), (0.8, 1.2))
ROUNDS = (*4 * [TRAIN], CLOSED, *5 * [TRAIN], None, *5 * [TRAIN], WHOLE)  # None: a run


class Lost(Exception):
    """The board does not answer or does not come to rest."""


@dataclass
class Tally:
    """What was done, and what must not have happened."""

    steps: Counter = field(default_factory=Counter)
    edges: int = 0
    lost: int = 0
    steps_without_loss: int = 0  # until the first count was lost
    runs: int = 0
    dropped: int = 0  # answers
    slowest_run: float = float("inf")  # edges a second
    worst_step: int = 0  # counts, of a move of the closed loop
    faults: list[str] = field(default_factory=list)


class Soak:
    """One board, and the rounds that it makes."""

    def __init__(self, board: Board, seed: int) -> None:
        self.board = board
        self.tally = Tally()
        self._random = random.Random(seed)
        self._told: list[int] = []  # errors of moves that did not come to their counts, since the last look
        self._apart = self._counts_apart()
        self._start = self.truth()
        self.ask(b"1DH0;2DH0")

    def truth(self) -> list[int]:
        """What each disc has turned, in edges."""
        bench = self.board.simulation.bench
        return [bench.encoders[motor].count(bench.trains[motor]) for motor in MOTORS]

    def ask(self, line: bytes) -> str:
        """The answer to a line; commands may stand before its queries. Raises Lost."""
        answer = self.board.ask(line + b";TE?")
        if not answer:
            raise Lost(f"no answer to {line.decode()}")
        said, _, last = answer.rpartition(";")
        error = int(last)
        if error == DROPPED:  # of a query before this one: the host reads between two looks only
            self.tally.dropped += 1
            return self.ask(line)
        if error > 100 and error % 100 == DEAD_BAND:  # told with its move
            self._told.append(error)
        elif error:
            raise Lost(f"error {error} after {line.decode()}")
        return said

    def round(self, kind: Steps | None) -> None:
        """Move both axes at once, and compare at rest."""
        before = self.truth()
        if kind:
            self._move(kind)
        else:
            self._run()
        after = self.truth()
        self.tally.edges += sum(abs(now - then) for then, now in zip(before, after, strict=True))
        apart = self._counts_apart()
        lost = [abs(now - then) for then, now in zip(self._apart, apart, strict=True)]
        self._apart = apart
        if any(lost):
            self.tally.lost += sum(lost)
            self.tally.faults.append(f"{self.board.us} us: {lost} counts lost in {kind.name if kind else 'a run'}")
        elif not self.tally.lost:
            self.tally.steps_without_loss = self.tally.steps.total()
        self.tally.faults += [f"{self.board.us} us: error {error} of no move" for error in self._told]
        self._told.clear()

    def _counts_apart(self) -> list[int]:
        told = self.ask(b"1XC?;2XC?").split(";")
        return [
            (int(count) - edges + HALF_WRAP) % (2 * HALF_WRAP) - HALF_WRAP
            for count, edges in zip(told, self.truth(), strict=True)
        ]

    def _ways(self) -> list[int]:
        """A direction for each axis; back, where it has come far."""
        way = (-1, 1)
        return [
            -1 if turned > FARTHEST else 1 if turned < -FARTHEST else self._random.choice(way)
            for turned in (now - then for then, now in zip(self._start, self.truth(), strict=True))
        ]

    def _supply(self, supply: float) -> None:
        for train in self.board.simulation.bench.trains.values():
            train.profile = replace(train.profile, supply=supply)

    def _move(self, kind: Steps) -> None:
        self._supply(self._random.uniform(*kind.supply))
        pulse_us = self._random.choice(kind.pulses_us)
        velocity = 1_000_000 // (pulse_us + REST_US)
        for axis in "12":
            self.ask(f"{axis}MM0;{axis}XN{kind.counts};{axis}XP{pulse_us};{axis}VA{velocity}".encode())
            if kind.counts:
                self.ask(f"{axis}MM1".encode())
        n = [way * self._random.randint(*kind.n) for way in self._ways()]
        before = self.truth()
        self.board.give(b"1PR%d;2PR%d\n" % tuple(n))
        self._busy_until(lambda: self.ask(b"1MD?;2MD?") == "1; 1")
        self.board.run(SETTLE_US)
        for axis, wanted, turned in zip("12", n, self._turned(before), strict=True):
            reason, made = [int(word) for word in self.ask(f"{axis}XE?".encode()).split(",")[:2]]
            self.tally.steps[kind.name] += abs(made)
            off = abs(turned - wanted * kind.counts) if kind.counts else 0
            self.tally.worst_step = max(self.tally.worst_step, off)
            errors = [error for error in self._told if error // 100 == int(axis)]
            self._told = [error for error in self._told if error not in errors]
            if reason != DONE or made != wanted or off > MOST_OFF or errors:
                told = ", ".join(f"error {error}" for error in errors) or "no error told"
                self.tally.faults.append(
                    f"{self.board.us} us, step {self.tally.steps.total()}: axis {axis}: {made} of {wanted} steps,"
                    f" {off} counts off, reason {reason}, {told}"
                )

    def _run(self) -> None:
        self._supply(FAST)
        self.ask(b"1MM0;2MM0")
        signs = [b"+" if way > 0 else b"-" for way in self._ways()]
        before, end_us = self.truth(), self.board.us + 1_020_000  # the spin-up takes 20 ms
        self.board.give(b"1MV%b;2MV%b\n" % tuple(signs))
        self._busy_until(lambda: self.board.us > end_us - BUSY_US)
        self.board.until_us(end_us)
        self.tally.runs += 1
        slowest = min(abs(turned) for turned in self._turned(before)) / 1.02
        self.tally.slowest_run = min(self.tally.slowest_run, slowest)
        if slowest < FAST_EDGES_S:
            self.tally.faults.append(f"{self.board.us} us: only {slowest:.0f} edges a second")
        self.board.give(b"1ST;2ST\n")
        self.board.run(SETTLE_US + SETTLE_US)

    def _turned(self, before: list[int]) -> list[int]:
        return [now - then for then, now in zip(before, self.truth(), strict=True)]

    def _busy_until(self, over) -> None:
        """Give the loop queries to answer until over()."""
        end_us = self.board.us + PATIENCE_US
        while not over():
            if self.board.us > end_us:
                raise Lost("a move does not end")
            self.board.give(self._random.choice(QUERIES))
            self.board.run(self._random.randrange(20_000, BUSY_US))


def report(tally: Tally, about: dict[str, object]) -> str:
    """The report, in Markdown."""
    facts = about | {
        "steps": f"{tally.steps.total()}: " + ", ".join(f"{n} {kind}" for kind, n in tally.steps.items()),
        "steps until a count was lost": tally.steps_without_loss,
        "edges counted": tally.edges,
        "counts lost": tally.lost,
        "runs, the slowest axis of all": f"{tally.runs}, {tally.slowest_run:.0f} edges a second",
        "moves of the closed loop: farthest from their counts": tally.worst_step,
        "answers that the board had to drop": tally.dropped,
        "what must not have happened": len(tally.faults),
    }
    lines = [
        "# Soak of the encoders",
        "",
        "| | |",
        "|---|---|",
        *(f"| {name} | {fact} |" for name, fact in facts.items()),
    ]
    return "\n".join([*lines, "", *(f"- {fault}" for fault in tally.faults)]).rstrip() + "\n"


def parse(arguments: list[str]) -> argparse.Namespace:
    """The command line. Raises SystemExit."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--steps", type=int, default=100_000, metavar="N", help="of both axes together")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="the same rounds again (default 1)")
    parser.add_argument("--fault", choices=("lost",), help="let the sensors lose edges: to see that it is noticed")
    parser.add_argument("--report", type=Path, metavar="FILE.md", help="default: print it at the end")
    parser.add_argument("--machine", choices=("rp2040", "cpython"), default="rp2040", help="default: rp2040, emulated")
    parser.add_argument("--image", type=Path, metavar="FILE", help="the MicroPython image (default: the usual one)")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> int:
    """Soak and report."""
    options = parse(arguments)
    start = shown = time.monotonic()
    for number in (signal.SIGTERM, signal.SIGINT):  # a shell lets what runs in the background ignore the second
        signal.signal(number, signal.default_int_handler)
    try:
        emulated = options.machine == "rp2040"
        image = emulator.find_image(options.image).name if emulated else "none: the firmware in this Python"
        kind = Options(options.machine, encoder="motor", image=options.image, seed=options.seed)
        board = Board(make_simulation(kind))
    except MountError as e:
        print(f"encoder_soak: {e}", file=sys.stderr)
        return 1
    ended, tally, about = "", Tally(), {"seed": options.seed, "image": image}
    try:
        board.clear()
        about["firmware"] = board.ask(b"XF?")
        for motor in MOTORS if options.fault else ():
            board.simulation.bench.disturb(motor, options.fault)
        soak = Soak(board, options.seed)
        tally, number = soak.tally, 0
        while tally.steps.total() < options.steps:
            soak.round(ROUNDS[number % len(ROUNDS)])
            number += 1
            about["emulated time"] = f"{board.us / 60e6:.1f} min"
            about["wall time"] = f"{(time.monotonic() - start) / 60:.1f} min"
            if options.report:
                options.report.write_text(report(tally, about), encoding="utf-8")
            if time.monotonic() > shown + SHOWN_S:
                shown = time.monotonic()
                print(
                    f"{tally.steps.total()} steps, {tally.edges} edges, {tally.lost} lost, {len(tally.faults)} faults,"
                    f" {tally.steps.total() / (shown - start):.1f} steps/s",
                    file=sys.stderr,
                    flush=True,
                )
    except KeyboardInterrupt:
        ended = "by Ctrl-C"
    except (BoardGone, Lost) as e:
        ended = f"the board was lost: {type(e).__name__}: {e}"
    finally:
        board.simulation.close()
    if ended:
        about["ended early"] = ended
    text = report(tally, about)
    if options.report:
        options.report.write_text(text, encoding="utf-8")
    else:
        print(text, end="")
    return 1 if tally.lost or tally.faults or ended else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
