"""Runs the firmware for hours on an emulated RP2040, under random commands and faults, and looks for what must not be.

    .venv/bin/python tools/bench/soak.py --hours H --seed S --report FILE.md

Hours are the board's own. Every episode follows from the seed and its number alone: `--episode N` runs that one on a
new board. Exit status 1 if anything happened that must not, or if the board was lost.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

from episode import BYTE_US, STOP_US, Episode, Hung, Tally, Violation
from lab import Board, Lab

from mirrormount.errors import MountError
from mirrormount_sim import emulator
from mirrormount_sim.simulation import BoardGone

TOLD = 5  # episodes with violations that are told in full


def parse(arguments: list[str]) -> argparse.Namespace:
    """The command line. Raises SystemExit."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--hours", type=float, default=1.0, metavar="H", help="of emulated time (default 1)")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the report there; else to standard output")
    parser.add_argument("--episode", type=int, metavar="N", help="only this one, on a new board")
    parser.add_argument("--stop-us", type=int, default=STOP_US, metavar="US", help="most for a stop (%(default)s)")
    parser.add_argument("--byte-us", type=int, default=BYTE_US, metavar="US", help="for each byte ahead (%(default)s)")
    parser.add_argument("--image", type=Path, metavar="FILE", help="the MicroPython image (.uf2 or .bin)")
    return parser.parse_args(arguments)


def soak(board: Board, tally: Tally, options: argparse.Namespace) -> None:
    """Run episodes until the time is over, with progress on stderr. Raises Hung, BoardGone."""
    boot_id, shown = 0, 0.0
    end_us = options.hours * 3600e6
    number = 0 if options.episode is None else options.episode
    while board.us < end_us:
        boot_id = Episode(board, tally, options.seed, number, options.stop_us, options.byte_us).run(boot_id)
        if options.episode is not None:
            return
        number += 1
        if time.monotonic() > shown + 10:
            shown = time.monotonic()
            progress = f"episode {number}, {board.us / 60e6:.1f} min, {len(tally.violations)} violations"
            print(progress, file=sys.stderr, flush=True)


def report(tally: Tally, about: dict[str, object]) -> str:
    """The report, in Markdown."""
    memory = tally.memory or [0]
    facts = about | {
        "episodes": tally.episodes,
        "bytes sent to the board": tally.received,
        "commands": _by_kind(tally.commands),
        "stops": _by_kind(tally.stops),
        "faults": _by_kind(tally.faults),
        "times that a motor was started": tally.drives,
        "moves whose end was checked, by reason": _by_kind(tally.moves),
        "errors that the board told, by number": _by_kind(tally.errors),
        "worst stop, nothing ahead of it": f"{tally.worst_stop_us:.0f} µs",
        "worst stop, 100 bytes or more ahead of it": f"{tally.worst_byte_us:.1f} µs a byte",
        "free memory at rest, first, last, least": f"{memory[0]}, {memory[-1]}, {min(memory)} bytes",
        "passes of the loop": tally.passes,
        "resets": tally.resets,
        "violations": len(tally.violations),
    }
    lines = ["# Soak", "", "| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in facts.items())]
    episodes = list(dict.fromkeys(violation.episode for violation in tally.violations))
    for episode in episodes[:TOLD]:
        lines += ["", *_told([violation for violation in tally.violations if violation.episode == episode])]
    if len(episodes) > TOLD:
        lines += ["", f"And {len(episodes) - TOLD} more episodes."]
    return "\n".join(lines) + "\n"


def _by_kind(counts: Counter) -> str:
    return f"{counts.total()}: " + ", ".join(f"{n} {kind}" for kind, n in sorted(counts.items(), key=str))


def _told(violations: list[Violation]) -> list[str]:
    """What went wrong in one episode, and what it had done up to then: its microsecond, and bytes or event."""
    return [
        f"## Episode {violations[0].episode}",
        "",
        *(f"- at {violation.at_us} µs: {violation.what}" for violation in violations),
        "",
        "```",
        *violations[-1].log,
        "```",
    ]


def main(arguments: list[str]) -> int:
    """Soak and report."""
    options = parse(arguments)
    tally, start = Tally(), time.monotonic()
    try:
        with Lab("soak", 1, options.image) as lab:
            board = lab.board(switches=True)
            identity, firmware = board.ask(b"*IDN?;XF?").split("; ")
            ended = ""
            try:
                soak(board, tally, options)
            except (Hung, BoardGone) as e:
                ended = f"the board was lost: {type(e).__name__}"
            except KeyboardInterrupt:
                ended = "by Ctrl-C"
            about = {
                "seed": options.seed,
                "board": identity,
                "firmware": firmware,
                "image": emulator.find_image(options.image).name,
                "emulated time": f"{board.us / 60e6:.1f} min",
                "wall time": f"{(time.monotonic() - start) / 60:.1f} min",
            }
    except MountError as e:
        print(f"soak: {e}", file=sys.stderr)
        return 1
    if ended:
        about["ended early"] = ended
    if sinks := tally.memory_sinks():
        about["free memory"] = "sinks"
    text = report(tally, about)
    if options.report:
        options.report.write_text(text, encoding="utf-8")
    else:
        print(text, end="")
    return 1 if tally.violations or ended or sinks else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
