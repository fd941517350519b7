"""Measures the firmware on an emulated RP2040, in emulated time, and prints a table beside the paper's figures.

    .venv/bin/python tools/bench/run.py [--n N] [--only ROW[,ROW]] [--json FILE]

Needs what the rp2040 machine needs (docs/architecture.md). A row is named in full, or several are by how they begin:
`--only stop`. Results repeat exactly: all moments are seeded.
"""

import argparse
import json
import sys
import time
from pathlib import Path

from lab import Lab
from rows import ROWS, Row
from table import Measurement, as_json, markdown

from mirrormount.errors import MountError
from mirrormount.virtual import emulator


def parse(arguments: list[str]) -> argparse.Namespace:
    """The command line. Raises SystemExit."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--n", type=int, default=200, metavar="N", help="trials of each row (default 200)")
    parser.add_argument("--only", default="", metavar="ROW[,ROW]", help="rows to measure, or how their names begin")
    parser.add_argument("--list", action="store_true", help="list the rows")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything to FILE, too")
    parser.add_argument("--image", type=Path, metavar="FILE", help="the MicroPython image (.uf2 or .bin)")
    options = parser.parse_args(arguments)
    if options.n < 1:
        parser.error("--n must be at least 1")
    return options


def chosen(only: str) -> list[Row]:
    """The rows that --only names; all of them for "". Raises SystemExit for a name that fits none."""
    names = [name.strip() for name in only.split(",") if name.strip()]
    found: set[str] = set()
    for name in names:
        fits = {row.name for row in ROWS if row.name.startswith(name)}
        if not fits:
            raise SystemExit(f"no row is called {name!r}: see --list")
        found |= {name} & fits or fits
    return [row for row in ROWS if not names or row.name in found]


def measured(row: Row, n: int, image: Path | None) -> Measurement:
    """One row, with a line about it on stderr."""
    start = time.monotonic()
    with Lab(row.name, min(n, row.most_n or n), image) as lab:
        values = row.measure(lab)
    measurement = Measurement(row, values, time.monotonic() - start)
    print(f"{row.name}: {measurement.wall_s:.1f} s", file=sys.stderr, flush=True)
    return measurement


def main(arguments: list[str]) -> int:
    """Measure and print."""
    options = parse(arguments)
    rows = chosen(options.only)
    if options.list:
        print("\n".join(f"{row.name:18} {row.what} [{row.figure.unit}]" for row in rows))
        return 0
    try:
        with Lab("identity", 1, options.image) as lab:
            identity, firmware = lab.board().ask(b"*IDN?;XF?").split("; ")
        measurements = [measured(row, options.n, options.image) for row in rows]
        image = emulator.find_image(options.image).name
    except MountError as e:
        print(f"bench: {e}", file=sys.stderr)
        return 1
    print(f"{identity}, firmware {firmware[:12]}, {image}\n\n{markdown(measurements)}")
    if options.json:
        about = {"identity": identity, "firmware": firmware, "image": image}
        options.json.write_text(
            json.dumps(about | {"rows": as_json(measurements)}, ensure_ascii=False, indent=1) + "\n", encoding="utf-8"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
