"""Runs published drivers of New Focus 8742/8743-CL controllers against virtual boards, and prints what the pins did.

    .venv/bin/python tools/compat/run.py [--driver NAME] [--way tcp|pty] [--machine cpython|micropython] [--only WORD]

Exit status 1 if a check failed. How to add a driver: tools/compat/README.md.
"""

import argparse
import importlib
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from checks import Check, Trial, trial
from place import MACHINES, WAYS

from mirrormount.errors import EmulatorMissing

_HEADINGS = ("driver", "over", "machine", "call", "what the pins did", "ok")


def drivers() -> list[str]:
    """The names of the drivers that have a file here."""
    return sorted(path.stem.removeprefix("driver_") for path in Path(__file__).parent.glob("driver_*.py"))


def parse(arguments: list[str]) -> argparse.Namespace:
    """The command line. Raises SystemExit."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--driver", choices=drivers(), help="this one only")
    parser.add_argument("--way", choices=WAYS, help="over TCP, or over a pty, only")
    parser.add_argument("--machine", choices=MACHINES, help="on this machine only")
    parser.add_argument("--only", default="", metavar="WORD", help="only calls that have this word in them")
    return parser.parse_args(arguments)


def row(opened: Trial, check: Check) -> tuple[str, ...]:
    """Run a check: its line of the table, of which the last word is "ok" or begins with "FAILED"."""
    try:
        opened.run(check)
        verdict = "ok"
    except Exception as e:
        at = traceback.extract_tb(e.__traceback__)[-1]
        verdict = f"FAILED: {' '.join(f'{type(e).__name__} {e}'.split())} ({Path(at.filename).name}:{at.lineno})"
    place = opened.place
    return (opened.kind.NAME, place.way, place.machine, check.call, opened.told(), verdict)


def rows(kind: Any, way: str, machine: str, only: str) -> Iterator[tuple[str, ...]]:
    """The lines of a driver at a place."""
    checks = [check for check in kind.CHECKS if way in check.ways and only in check.call]
    if not checks:
        return
    try:
        with trial(kind, way, machine) as opened:
            for check in checks:
                yield row(opened, check)
    except (EmulatorMissing, ModuleNotFoundError) as e:
        yield (kind.NAME, way, machine, "", "", f"not run: {e}")


def main(arguments: list[str]) -> int:
    """Run, and print a line as soon as it is known."""
    options = parse(arguments)
    print(f"| {' | '.join(_HEADINGS)} |\n|{'---|' * len(_HEADINGS)}")
    failed = 0
    for name in [options.driver] if options.driver else drivers():
        kind = importlib.import_module(f"driver_{name}")
        for way in [options.way] if options.way else kind.WAYS:
            for machine in [options.machine] if options.machine else MACHINES:
                for cells in rows(kind, way, machine, options.only):
                    print(f"| {' | '.join(cells)} |", flush=True)
                    failed += cells[-1].startswith("FAILED")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
