"""Sends a million frames to an emulated RP2040, 1000 a second, and looks on the pins whether each was obeyed.

    .venv/bin/python tools/bench/frames_soak.py [--frames N] [--seed S] [--report FILE.md]

Each frame reverses motor 1, so each shows. After some hundred of them a stop comes, anywhere in a frame or as eight
zeros: it must cut both motors within the gate's bound (99 of 100), the board must tell it, and the next frame must
drive. It would not if the gate and the parser ever counted stops differently, for then the gate holds the motors off.
The report is written after each train. Exit status 1 if anything was missed, or the board was lost.
"""

import argparse
import random
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from lab import Board, Lab, first_low_us
from measure import QUIET_US, STREAM_US, shown

from mirrormount.device.mount import encode_frame
from mirrormount.errors import MountError
from mirrormount_sim import emulator
from mirrormount_sim.simulation import BoardGone

STOP_US = 20  # from a stop's landing to both motors off, with the gate: 99 of 100 (docs/performance.md)
TRAIN = (200, 1_600)  # frames between two stops
AFTER_US = 50_000  # what a train needs to be counted
STOPS = {b"!": "3", b"00000000": "2"}  # and the reasons that XE? tells
PROGRESS_S = 10.0


class Lost(Exception):
    """The board does not answer."""


@dataclass
class Tally:
    """What was done, and what must not have happened."""

    frames: int = 0
    seen: int = 0
    stops: int = 0
    late: int = 0
    worst_us: float = 0.0
    faults: list[str] = field(default_factory=list)


def train(board: Board, chance: random.Random, tally: Tally, most: int) -> None:
    """Send one train of at most so many frames and the stop after it. Raises Lost, TimeoutError, BoardGone."""
    board.ask(b"TE?")  # and what was echoed before is known not to return
    board.run(QUIET_US)
    board.forget()
    frames = min(most, chance.randrange(*TRAIN))
    for i in range(frames):
        board.give(encode_frame(-255 if i % 2 else 255, 255))
        board.run(STREAM_US)
    board.run(AFTER_US)
    seen = [forward for _, forward in shown(board.edges, 1)]
    tally.frames += frames
    tally.seen += len(seen)
    if seen != [i % 2 == 0 for i in range(frames)]:
        tally.faults.append(f"{board.us} us: of {frames} frames {len(seen)} were obeyed")
    stop = chance.choice(list(STOPS))
    if stop == b"!":
        board.give(encode_frame(255, 255)[: chance.randrange(8)])
        board.run(chance.randrange(STREAM_US))
    landed_us = board.land(stop)
    board.run(AFTER_US)
    took_us = first_low_us(board.edges, landed_us) - landed_us
    tally.stops += 1
    tally.worst_us = max(tally.worst_us, took_us)
    tally.late += took_us > STOP_US
    if not board.off():
        tally.faults.append(f"{board.us} us: a motor is on after {stop.decode()}")
    board.give(b"\n")  # the rest of a frame that was cut ends here
    told = board.ask(b"1XE?")
    if not told:
        raise Lost
    if told.split(",")[0] != STOPS[stop]:
        tally.faults.append(f"{board.us} us: after {stop.decode()} XE? tells {told}")


def report(tally: Tally, about: dict[str, object]) -> str:
    """The report, in Markdown."""
    facts = about | {
        "frames sent": tally.frames,
        "frames obeyed, in their order": tally.seen,
        "stops": tally.stops,
        "worst stop": f"{tally.worst_us} µs",
        f"stops later than {STOP_US} µs": tally.late,
        "what must not have happened": len(tally.faults),
    }
    lines = ["# Soak of frames", "", "| | |", "|---|---|", *(f"| {name} | {fact} |" for name, fact in facts.items())]
    return "\n".join([*lines, "", *(f"- {fault}" for fault in tally.faults)]).rstrip() + "\n"


def parse(arguments: list[str]) -> argparse.Namespace:
    """The command line. Raises SystemExit."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--frames", type=int, default=1_000_000, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="the same trains again (default 1)")
    parser.add_argument("--without-gate", action="store_true", help="to see that late stops are noticed")
    parser.add_argument("--report", type=Path, metavar="FILE.md", help="default: print it at the end")
    parser.add_argument("--image", type=Path, metavar="FILE", help="the MicroPython image (default: the usual one)")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> int:
    """Soak and report."""
    options = parse(arguments)
    chance, tally, ended = random.Random(options.seed), Tally(), ""
    start = told = time.monotonic()
    for number in (signal.SIGTERM, signal.SIGINT):  # a shell lets what runs in the background ignore the second
        signal.signal(number, signal.default_int_handler)
    try:
        with Lab("frames", 1, options.image, gate=not options.without_gate) as lab:
            board = lab.board()
            about = {"seed": options.seed, "image": emulator.find_image(options.image).name}
            about["firmware"] = board.ask(b"XF?")
            try:
                while tally.frames < options.frames:
                    train(board, chance, tally, options.frames - tally.frames)
                    about["emulated time"] = f"{board.us / 60e6:.1f} min"
                    about["wall time"] = f"{(time.monotonic() - start) / 60:.1f} min"
                    if options.report:
                        options.report.write_text(report(tally, about), encoding="utf-8")
                    if time.monotonic() > told + PROGRESS_S:
                        told = time.monotonic()
                        print(f"{tally.frames} frames, {len(tally.faults)} faults", file=sys.stderr, flush=True)
            except KeyboardInterrupt:
                ended = "by Ctrl-C"
            except (BoardGone, Lost, TimeoutError) as e:
                ended = f"the board was lost: {type(e).__name__}"
    except MountError as e:
        print(f"frames_soak: {e}", file=sys.stderr)
        return 1
    if ended:
        about["ended early"] = ended
    if tally.late * 100 > tally.stops:
        tally.faults.append("more than one stop in a hundred was late")
    text = report(tally, about)
    if options.report:
        options.report.write_text(text, encoding="utf-8")
    else:
        print(text, end="")
    return 1 if tally.faults or ended else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
