"""The report of a measurement: a page with its pictures inside, and JSON with every number, unit and error."""

import base64
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mirrormount.beam import Spot
from mirrormount.beam.estimate import Estimate
from mirrormount.beam.html_page import chart, page, table, text
from mirrormount.beam.optics import Optics
from mirrormount.beam.result import Result, Series
from mirrormount.common import whole_file

NUMBERS_BEGIN = '{\n "began": "'  # the file of write_json()
_SYMBOLS = {"us": "µs", "urad": "µrad", "sqrt(s)": "√s"}


@dataclass(frozen=True)
class Origin:
    """Of what the report is. settings: of the mount's axes during the measurement."""

    began: datetime
    version: str
    board: str
    camera: str
    settings: Mapping[str, Mapping[str, int | float]]
    optics: Optics


def write_json(path: Path, result: Result, origin: Origin) -> None:
    """Write all numbers. Raises CannotWrite."""
    data = {
        "began": origin.began.isoformat(timespec="seconds"),
        "mirrormount": origin.version,
        "board": origin.board,
        "camera": origin.camera,
        "settings": origin.settings,
        "optics": origin.optics.to_json(),
        **result.to_json(),
    }
    whole_file.write(path, json.dumps(_finite(data), indent=1, allow_nan=False) + "\n")


def write_page(path: Path, result: Result, origin: Origin, last: tuple[NDArray[np.uint8], Spot] | None) -> None:
    """Write the page. last: a picture and its spot, for the reader to see. Raises CannotWrite."""
    began = origin.began.isoformat(sep=" ", timespec="seconds")
    of = " · ".join((began, origin.board, f"camera: {origin.camera}", f"mirrormount {origin.version}"))
    parts = [
        f"<h1>mirrormount measure {text(result.experiment)}</h1>",
        f"<p>{text(of)}</p>",
    ]
    if result.partial:
        parts.append(
            f'<p class="partial"><b>Ended early:</b> {text(result.partial)}. What was measured by then is below:'
            f" {len(result.readings)} readings of the spot. The JSON file has each of them.</p>"
        )
    parts.append("<h2>Results</h2>")
    parts.append(_table(result, origin.optics) if result.estimates else "<p>None yet: it ended too early.</p>")
    parts += [f"<p>{text(remark)}</p>" for remark in result.remarks]
    if any(math.isfinite(estimate.error) for estimate in result.estimates.values()):
        parts.append("<p>± is one standard error. The truth is within two of them in 95 of 100 measurements.</p>")
    for series in [*result.series, *(_readings(result) if result.partial and not result.series else ())]:
        parts += [f"<h2>{text(series.title)}</h2>", _chart(series)]
    if last:
        parts += ["<h2>The camera's last picture, with the spot that was found</h2>", _picture(*last)]
    parts += ["<h2>Settings of the mount</h2>", _settings(origin.settings)]
    whole_file.write(path, page(f"measure {result.experiment}", parts))


def _readings(result: Result) -> Iterator[Series]:
    """The spot's place over the time, of a measurement that has no other curve of all its readings."""
    for name, at in (("x", 1), ("y", 2)):
        points = [(row[0], row[at], row[at + 2]) for row in result.readings]
        yield Series(f"All readings: the spot's {name} in the picture", "time in s", "px", points)


def _finite(value: object) -> object:
    """The same without numbers that JSON has not: they become null."""
    if isinstance(value, Mapping):
        return {str(key): _finite(each) for key, each in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _table(result: Result, optics: Optics) -> str:
    estimates = result.estimates
    columns: dict[str, list[Estimate | None]] = {"measured": list(estimates.values())}
    in_px = {name: estimate if estimate.unit.startswith("px") else None for name, estimate in estimates.items()}
    columns["at the camera"] = [each and optics.mm(each) for each in in_px.values()]
    columns["of the beam"] = [each and optics.beam_urad(each) for each in in_px.values()]
    columns["of the mirror"] = [
        each and optics.mirror_urad(each, name[0]) if result.moves and name.startswith(("x.", "y.")) else None
        for name, each in in_px.items()
    ]
    shown = {title: cells for title, cells in columns.items() if any(cells)}
    cells_of = zip(estimates, *shown.values(), strict=True)
    rows = [(name, *(_in_words(cell) if cell else "" for cell in cells)) for name, *cells in cells_of]
    return table(("", *shown), rows)


def _in_words(estimate: Estimate) -> str:
    """As on the command line, where a unit is a word that can be typed; a page has its symbol."""
    unit = "/".join(_SYMBOLS.get(part, part) for part in estimate.unit.split("/"))
    return str(replace(estimate, unit=unit))


def _settings(settings: Mapping[str, Mapping[str, int | float]]) -> str:
    names = dict.fromkeys(name for values in settings.values() for name in values)
    return table(("", *settings), [(name, *(each.get(name, "") for each in settings.values())) for name in names])


def _chart(series: Series) -> str:
    """A curve as SVG, with bars of one standard error."""

    def draw(axes: Axes) -> None:
        x, y, error = np.array(series.points, dtype=float).reshape(-1, 3).T
        style = {"color": "#1f5fa8", "marker": ".", "markersize": 5}
        axes.errorbar(x, y, error if error.any() else None, linestyle="-" if series.joined else "none", lw=1, **style)
        axes.set(xlabel=series.x_label, ylabel=series.y_label)
        if len(x) and (x == np.round(x)).all() and not series.in_picture:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))  # places and steps are counted
        if series.in_picture:
            axes.set_aspect("equal", adjustable="datalim")
            axes.invert_yaxis()
            for at, name, fill in ((0, "begin", "none"), (-1, "end", "#b5521b")):
                axes.plot(x[at], y[at], "o", ms=8, mec="#b5521b", mfc=fill, ls="none", label=name)
            axes.legend(fontsize="small", loc="center")

    return chart(series.title, draw, height=4.0 if series.in_picture else 2.8, width=5.2)


def _picture(image: NDArray[np.uint8], spot: Spot) -> str:
    shown = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    at = round(spot.x), round(spot.y)
    cv2.circle(shown, at, round(max(spot.width, spot.height) * 2), (60, 180, 255), 1, cv2.LINE_AA)
    cv2.drawMarker(shown, at, (60, 180, 255), cv2.MARKER_CROSS, 12, 1, cv2.LINE_AA)
    data = cv2.imencode(".png", shown)[1].tobytes()
    return f'<img alt="the spot in the picture" src="data:image/png;base64,{base64.b64encode(data).decode()}">'
