"""The live picture of a scan: a page in a file that a browser reloads while the scan is under way. Imports html_page.

A map for each value of the signal: a square a place, from the least value (dark) to the largest (bright); a place
without a value is crossed out. No server and no drawing package: what is open in the browser is the file.
"""

import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from mirrormount.beam.html_page import BEGINS, page, text
from mirrormount.beam.patterns import Pattern
from mirrormount.beam.scan import Sample, Signal
from mirrormount.common import whole_file

_RELOAD_S = 2
_EVERY_S = 1.0  # at least, between two pages; a large one that takes long to write comes less often
_SHARE = 20.0  # of the scan's time, the page takes one part
_MOST_PX = 640.0  # of a map's longer side
_SIDE_PX = 28.0  # of a place in a small map
_DARK, _MIDDLE, _BRIGHT = (48, 18, 92), (198, 66, 84), (252, 230, 120)


class ScanPage:
    """The page of one scan. columns of errors are not shown."""

    def __init__(self, path: Path, pattern: Pattern, signal: Signal) -> None:
        """Write the empty page. Raises CannotWrite, also if a file is there that is no page."""
        whole_file.check_replaceable(path, BEGINS)
        self._path, self._pattern, self._signal = path, pattern, signal
        self._samples: list[Sample] = []
        measured = [place for place in pattern.places if place.measured]
        self._left, self._top = min(place.x for place in measured), max(place.y for place in measured)
        self._wide = max(place.x for place in measured) - self._left
        self._high = self._top - min(place.y for place in measured)
        steps = [max(abs(b.x - a.x), abs(b.y - a.y)) for a, b in pairwise(measured)]
        self._pitch = min((step for step in steps if step), default=1)
        self._next_s = 0.0
        self._write("")

    def add(self, sample: Sample) -> None:
        """Show a sample, if it is time for a new page. Raises CannotWrite."""
        self._samples.append(sample)
        if time.monotonic() >= self._next_s:
            self._write("")

    def end(self, how: str) -> None:
        """The last page, which does not reload. Raises CannotWrite."""
        self._write(how)

    def _write(self, ended: str) -> None:
        begun_s = time.monotonic()
        state = f"Ended: {ended}" if ended else "Under way; this page reloads itself"
        parts = [
            f"<h1>mirrormount scan {text(self._pattern.name)}</h1>",
            f"<p>{len(self._samples)} of {self._pattern.measured} places. {text(state)}.</p>",
        ]
        for k, (name, unit) in enumerate(self._signal.columns.items()):
            if not name.startswith("error_"):
                parts += self._map(k, name, unit)
        missing = [sample.missing for sample in self._samples if sample.missing]
        if missing:
            parts.append(f"<p>{len(missing)} without a value; the last: {text(missing[-1])}</p>")
        whole_file.write(self._path, page("mirrormount scan", parts, None if ended else _RELOAD_S))
        self._next_s = time.monotonic() + max(_EVERY_S, _SHARE * (time.monotonic() - begun_s))

    def _map(self, k: int, name: str, unit: str) -> Sequence[str]:
        known = [sample.values[k] for sample in self._samples if sample.values]
        if not known:
            return ()
        low, high = min(known), max(known)
        columns, rows = self._wide / self._pitch + 1, self._high / self._pitch + 1
        side = min(_SIDE_PX, _MOST_PX / max(columns, rows))
        places = "".join(self._place(sample, k, side, low, high) for sample in self._samples)
        words = f"{name}: {low:.5g} (dark) … {high:.5g} (bright) {unit}"
        size = f'width="{columns * side:.0f}" height="{rows * side:.0f}"'
        box = f'viewBox="0 0 {columns * side:.2f} {rows * side:.2f}"'
        return f"<h2>{text(words)}</h2>", f'<svg class="map" {size} {box} role="img">{places}</svg>'

    def _place(self, sample: Sample, k: int, side: float, low: float, high: float) -> str:
        x = (sample.x - self._left) / self._pitch * side
        y = (self._top - sample.y) / self._pitch * side
        if not sample.values:
            return (
                f'<path d="M{x:.2f} {y:.2f}l{side:.2f} {side:.2f}m0 -{side:.2f}l-{side:.2f} {side:.2f}" stroke="#888"/>'
            )
        part = (sample.values[k] - low) / (high - low) if high > low else 0.5
        told = f"({sample.x}, {sample.y}): {sample.values[k]:.5g}"
        where = f'x="{x:.2f}" y="{y:.2f}" width="{side:.2f}" height="{side:.2f}"'
        return f'<rect {where} fill="{_colour(part)}"><title>{told}</title></rect>'


def _colour(part: float) -> str:
    """Of a value between the least (0) and the largest (1)."""
    a, b, share = (_DARK, _MIDDLE, 2 * part) if part < 0.5 else (_MIDDLE, _BRIGHT, 2 * part - 1)
    return "#" + "".join(f"{round(u + (v - u) * share):02x}" for u, v in zip(a, b, strict=True))
