"""Measures the firmware on an emulated RP2040, in emulated time, and prints a table beside the paper's figures.

    .venv/bin/python tools/bench/run.py [--n N] [--only ROW[,ROW]] [--json FILE] [--update] [--check [--quick]]

Needs what the rp2040 machine needs (docs/virtual-board.md). A row is named in full, or several are by how they begin:
`--only stop`. Results repeat exactly: all moments are seeded. --update measures the rows that somebody asks for
(ON_THE_PAGE), and writes them into docs/performance.md. --check names the rows that miss their must, and exits with 1.
--quick takes 10 trials of the rows of stops and frames; with both, a row that has a floor (rows.py) has to keep that.
"""

import argparse
import json
import math
import os
import statistics
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import fill

from lab import Lab
from rows import CLOSED, ON_THE_PAGE, PAPER_SOURCE, ROWS, Row

from mirrormount.errors import MountError
from mirrormount_sim import emulator

QUICK_N = 10
DEFAULT_IMAGE = "default: the newest RPI_PICO-*.uf2 in $MIRRORMOUNT_IMAGES, else docs/virtual-board.md's"
PAGE = Path(__file__).parents[2] / "docs" / "performance.md"
BEGIN, END = "<!-- measured by tools/bench/run.py --update -->", "<!-- end of what was measured -->"
NOT_MODELLED = (
    "Emulated time. Not modelled: when a USB host polls and sends (full speed: up to 1 ms a turn; here a byte is the"
    " board's as soon as it asks for one), the second core."
)


@dataclass(frozen=True)
class Measurement:
    """What one row gave. Errors are judged by their size, so all but sd is of absolute values."""

    row: Row
    values: Sequence[float]
    wall_s: float = 0.0

    def _sorted(self) -> list[float]:
        """From the best to the worst."""
        return sorted((abs(v) for v in self.values), reverse=self.row.figure.more_is_better)

    @property
    def median(self) -> float:
        return statistics.median(self._sorted())

    @property
    def p99(self) -> float:
        """The value that 99 of 100 keep to: nearest rank."""
        return self._sorted()[math.ceil(0.99 * len(self.values)) - 1]

    @property
    def worst(self) -> float:
        return self._sorted()[-1]

    @property
    def sd(self) -> float | None:
        """Standard deviation of the values with their signs; None for fewer than two, or if one was lost."""
        if len(self.values) < 2 or not all(map(math.isfinite, self.values)):
            return None
        return statistics.stdev(self.values)

    @property
    def judged(self) -> float:
        """The value that the limits are for."""
        return self.p99 if self.row.figure.p99 else self.worst

    def meets(self, limit: float | None) -> bool:
        """Whether the judged value keeps a limit; None is kept by none."""
        if limit is None:
            return False
        return self.judged >= limit if self.row.figure.more_is_better else self.judged <= limit

    def missed(self, *, quick: bool) -> str:
        """The row and its limit, if a check fails; else "". quick: a row with a floor has to keep that instead."""
        must, floor = self.row.figure.must, self.row.floor
        if self.meets(must) or (quick and self.meets(floor)):
            return ""
        limit = f"must {must:g}" if floor is None or not quick else f"must {must:g}, floor {floor:g}"
        return f"{self.row.name}: {_text(self.judged)} {self.row.figure.unit}, {limit}"


def markdown(measurements: Sequence[Measurement]) -> str:
    """The table, and what it does not tell."""
    lines = [
        "| | unit | n | median | p99 | worst | sd | must | the paper's sketch |",
        "|---|---|--:|--:|--:|--:|--:|---|---|",
    ]
    for m in measurements:
        numbers = [_text(v) for v in (m.median, m.p99, m.worst, m.sd)]
        must = f"{m.row.figure.must:g}: {'met' if m.meets(m.row.figure.must) else '**not met**'}"
        lines.append(
            "| " + " | ".join([m.row.what, m.row.figure.unit, str(len(m.values)), *numbers, must, m.row.paper]) + " |"
        )
    notes = (fill(note, 100) for note in (NOT_MODELLED, f"The paper's sketch: {PAPER_SOURCE}."))
    return "\n".join([*lines, "", "\n\n".join(notes)])


def _text(value: float | None) -> str:
    if value is None:
        return ""
    if math.isinf(value):
        return "lost"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def as_json(measurements: Sequence[Measurement]) -> list[dict]:
    """The same for programs, with every value; what was lost is null."""
    return [
        {
            "name": m.row.name,
            "what": m.row.what,
            "unit": m.row.figure.unit,
            "n": len(m.values),
            "median": _number(m.median),
            "p99": _number(m.p99),
            "worst": _number(m.worst),
            "sd": m.sd,
            "judged_by": "p99" if m.row.figure.p99 else "worst",
            "must": m.row.figure.must,
            "must_met": m.meets(m.row.figure.must),
            "paper": m.row.paper,
            "wall_s": round(m.wall_s, 1),
            "values": [_number(v) for v in m.values],
        }
        for m in measurements
    ]


def _number(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def parse(arguments: list[str]) -> argparse.Namespace:
    """The command line. Raises SystemExit."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--n", type=int, metavar="N", help="trials of each row (default 200; with --quick 10)")
    parser.add_argument("--only", default="", metavar="ROW[,ROW]", help="rows to measure, or how their names begin")
    parser.add_argument("--list", action="store_true", help="list the rows")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything to FILE, too")
    parser.add_argument("--image", type=Path, metavar="FILE", help=f"the MicroPython image; {DEFAULT_IMAGE}")
    parser.add_argument("--check", action="store_true", help="exit with 1 if a must is missed")
    parser.add_argument("--quick", action="store_true", help="a few trials of the rows of stops and frames")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="rows measured at a time (default 2)")
    parser.add_argument("--update", action="store_true", help="measure the rows of docs/performance.md, and write them")
    options = parser.parse_args(arguments)
    options.n = options.n if options.n is not None else QUICK_N if options.quick else 200
    options.image = options.image or official_image()
    if options.n < 1 or options.jobs < 1:
        parser.error("--n and --jobs must be at least 1")
    if options.update and (options.only or options.quick):
        parser.error("--update measures the rows of the page: leave out --only and --quick")
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


def measured(name: str, n: int, image: Path | None) -> tuple[list[float], float]:
    """The values of the row of that name, and how long they took in s."""
    start = time.monotonic()
    (row,) = (row for row in ROWS if row.name == name)
    seed = row.name.removesuffix("-gate").removeprefix(CLOSED)  # the same moments with the gate and without
    n, gate = min(n, row.most_n or n), row.gate is not False
    with Lab(seed, n, image, gate=gate, closed=row.closed) as lab:
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
    rows = chosen(",".join(ON_THE_PAGE) if options.update else options.only, options.quick)
    if options.list:
        print("\n".join(f"{row.name:18} {row.what} [{row.figure.unit}]" for row in rows))
        return 0
    try:
        with Lab("identity", 1, options.image) as lab:
            identity, firmware = lab.board().ask(b"*IDN?;XF?").replace("sha256-", "").split("; ")
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
        about = f"`{identity}`, firmware `{firmware[:12]}`,\n`{image}`:\n\n{table}"
        text = updated(PAGE.read_text(encoding="utf-8"), about)
        PAGE.write_text(text, encoding="utf-8")
    missed = [line for m in measurements if (line := m.missed(quick=options.quick))] if options.check else []
    for line in missed:
        print(f"missed: {line}", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
