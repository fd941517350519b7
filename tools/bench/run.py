"""Measures the firmware on an emulated RP2040, in emulated time, and prints a table beside the paper's figures.

    .venv/bin/python tools/bench/run.py [--n N] [--only ROW[,ROW]] [--json FILE] [--update] [--check [--quick]]

Needs what the rp2040 machine needs (docs/virtual-board.md). A row is named in full, or several are by how they begin:
`--only stop`. Results repeat exactly: all moments are seeded. --update writes all rows into docs/performance.md.
--check names the rows that miss their must, and exits with 1. --quick takes 10 trials of the rows of stops and
frames; with both, a row that has a floor (rows.py) has to keep that.
"""

import argparse
import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from lab import Lab, has_gate
from rows import CLOSED, ROWS, Row
from table import Measurement, as_json, markdown

from mirrormount.common.errors import MountError
from mirrormount.virtual import emulator

QUICK_N = 10
DEFAULT_IMAGE = "default: the newest RPI_PICO-*.uf2 in $MIRRORMOUNT_IMAGES, else docs/virtual-board.md's"
PAGE = Path(__file__).parents[2] / "docs" / "performance.md"
BEGIN, END = "<!-- measured by tools/bench/run.py --update -->", "<!-- end of what was measured -->"


def parse(arguments: list[str]) -> argparse.Namespace:
    """The command line. Raises SystemExit."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--n", type=int, metavar="N", help="trials of each row (default 200; with --quick 10)")
    parser.add_argument("--only", default="", metavar="ROW[,ROW]", help="rows to measure, or how their names begin")
    parser.add_argument("--list", action="store_true", help="list the rows")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything to FILE, too")
    parser.add_argument("--image", type=Path, metavar="FILE", help=f"the MicroPython image; {DEFAULT_IMAGE}")
    parser.add_argument("--no-flash-cache", dest="flash_cache", action="store_false", help="flash as fast as RAM")
    parser.add_argument("--check", action="store_true", help="exit with 1 if a must is missed")
    parser.add_argument("--quick", action="store_true", help="a few trials of the rows of stops and frames")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="rows measured at a time (default 2)")
    parser.add_argument("--update", action="store_true", help="write the table into docs/performance.md")
    options = parser.parse_args(arguments)
    options.n = options.n if options.n is not None else QUICK_N if options.quick else 200
    options.image = options.image or official_image()
    if options.n < 1 or options.jobs < 1:
        parser.error("--n and --jobs must be at least 1")
    if options.update and (options.only or options.quick or not options.flash_cache):
        parser.error("--update writes the whole table, of a board with a cache: leave out --only, --quick and the like")
    return options


def official_image() -> Path | None:
    """The newest official MicroPython for the Pico in the folder $MIRRORMOUNT_IMAGES; None without one."""
    folder = os.environ.get("MIRRORMOUNT_IMAGES")
    return max(Path(folder).glob("RPI_PICO-*.uf2"), default=None) if folder else None


def chosen(only: str, quick: bool = False) -> list[Row]:
    """The rows that --only and --quick leave; all of them for "". Raises SystemExit for a name that fits none."""
    names = [name.strip() for name in only.split(",") if name.strip()]
    found: set[str] = set()
    for name in names:
        fits = {row.name for row in ROWS if row.name.startswith(name)}
        if not fits:
            raise SystemExit(f"no row is called {name!r}: see --list")
        found |= {name} & fits or fits
    return [row for row in ROWS if (not names or row.name in found) and (row.quick or not quick)]


def measured(name: str, n: int, image: Path | None, flash_cache: bool = True) -> tuple[list[float], float]:
    """The values of the row of that name, and how long they took in s. No values without the gate that it is about."""
    start = time.monotonic()
    (row,) = (row for row in ROWS if row.name == name)
    if row.gate and not has_gate():
        return [], 0.0
    seed = row.name.removesuffix("-gate").removeprefix(CLOSED)  # the same moments with the gate and without
    n, gate = min(n, row.most_n or n), row.gate is not False
    with Lab(seed, n, image, gate=gate, flash_cache=flash_cache, closed=row.closed) as lab:
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
    rows = chosen(options.only, options.quick)
    if options.list:
        print("\n".join(f"{row.name:18} {row.what} [{row.figure.unit}]" for row in rows))
        return 0
    try:
        with Lab("identity", 1, options.image) as lab:
            identity, firmware = lab.board().ask(b"*IDN?;XF?").split("; ")
        # Emulated time does not depend on what else this computer does, so rows may be measured side by side
        with ProcessPoolExecutor(options.jobs) as pool:
            work = partial(measured, n=options.n, image=options.image, flash_cache=options.flash_cache)
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
    cache = "" if options.flash_cache else ", without the flash's cache"
    print(f"{identity}, firmware {firmware[:12]}, {image}{cache}\n\n{table}")
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
    missed = [line for m in measurements if (line := m.missed(quick=options.quick))] if options.check else []
    for line in missed:
        print(f"missed: {line}", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
