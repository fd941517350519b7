"""Measures the firmware on an emulated RP2040, in emulated time, and prints a table beside the paper's figures.

    .venv/bin/python tools/bench/run.py [--n N] [--only ROW[,ROW]] [--json FILE] [--update]

Needs what the rp2040 machine needs (docs/virtual-board.md). A row is named in full, or several are by how they begin:
`--only stop`. Results repeat exactly: all moments are seeded. --update writes all rows into docs/performance.md.
"""

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from lab import Lab
from rows import ROWS, Row
from table import Measurement, as_json, markdown

from mirrormount.common.errors import MountError
from mirrormount.virtual import emulator

PAGE = Path(__file__).parents[2] / "docs" / "performance.md"
BEGIN, END = "<!-- measured by tools/bench/run.py --update -->", "<!-- end of what was measured -->"


def parse(arguments: list[str]) -> argparse.Namespace:
    """The command line. Raises SystemExit."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--n", type=int, default=200, metavar="N", help="trials of each row (default 200)")
    parser.add_argument("--only", default="", metavar="ROW[,ROW]", help="rows to measure, or how their names begin")
    parser.add_argument("--list", action="store_true", help="list the rows")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything to FILE, too")
    parser.add_argument("--image", type=Path, metavar="FILE", help="the MicroPython image (.uf2 or .bin)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="rows measured at a time (default 2)")
    parser.add_argument("--update", action="store_true", help="write the table into docs/performance.md")
    options = parser.parse_args(arguments)
    if options.n < 1 or options.jobs < 1:
        parser.error("--n and --jobs must be at least 1")
    if options.update and options.only:
        parser.error("--update writes the whole table: leave out --only")
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


def measured(name: str, n: int, image: Path | None) -> tuple[list[float], float]:
    """The values of the row of that name, and how long they took in s."""
    start = time.monotonic()
    (row,) = (row for row in ROWS if row.name == name)
    with Lab(row.name, min(n, row.most_n or n), image) as lab:
        values = row.measure(lab)
    return values, time.monotonic() - start


def updated(page: str, about: str) -> str:
    """A page with what was measured between its two marks. Raises ValueError if it has not each of them once."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end) or BEGIN in after or END in after:
        raise ValueError(f"the page must have the lines {BEGIN} and {END}, once each")
    return f"{before}{begin}\n\n{about}\n\n{end}{after}"


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
        # Emulated time does not depend on what else this computer does, so rows may be measured side by side
        with ProcessPoolExecutor(options.jobs) as pool:
            work = partial(measured, n=options.n, image=options.image)
            results = []
            for row, result in zip(rows, pool.map(work, [row.name for row in rows]), strict=True):
                results.append(result)
                print(f"{row.name}: {result[1]:.1f} s", file=sys.stderr, flush=True)
        image = emulator.find_image(options.image).name
    except MountError as e:
        print(f"bench: {e}", file=sys.stderr)
        return 1
    measurements = [Measurement(row, *result) for row, result in zip(rows, results, strict=True)]
    table = markdown(measurements)
    print(f"{identity}, firmware {firmware[:12]}, {image}\n\n{table}")
    if options.json:
        about = {"identity": identity, "firmware": firmware, "image": image}
        options.json.write_text(
            json.dumps(about | {"rows": as_json(measurements)}, ensure_ascii=False, indent=1) + "\n", encoding="utf-8"
        )
    if options.update:
        text = updated(
            PAGE.read_text(encoding="utf-8"), f"`{identity}`, firmware `{firmware[:12]}`, `{image}`:\n\n{table}"
        )
        PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
