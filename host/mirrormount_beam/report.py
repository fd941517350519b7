"""Reports of measurements and of runs, as HTML pages: one file with style and curves inside, for screen and phone.

The report of a measurement has its pictures, and JSON beside it has every number, unit and error. The report of a run
is made of its log: how well the beam was held, what it would have done without the loop, and what the loop did.
"""

import io
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mirrormount import files
from mirrormount.markup import html_table, html_text
from mirrormount.terminal import printable
from mirrormount_beam.estimates import Estimate, Result, Series
from mirrormount_beam.runlog import MINUTE_S, ErrorSums, Minute, Run, joined, spectrum
from mirrormount_beam.scale import Optics
from mirrormount_beam.spot.find import Spot
from mirrormount_beam.spot.picture import as_png, html_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# ---- pages

# On a phone the rows of a table of many columns become blocks: its name, and a line for each figure.
# Curves are drawn dark on light; in the dark their lightness is turned round and their hues are kept.
_STYLE = """
:root{color-scheme:light dark;--ink:#1a1a1a;--paper:#fff;--line:#ddd;--soft:#595959;--warn:#fff3cd}
@media(prefers-color-scheme:dark){:root{--ink:#e6e6e6;--paper:#16181b;--line:#3a3d42;--soft:#a8a8a8;--warn:#4a3b0a}
.curve svg{filter:invert(.91) hue-rotate(180deg)}}
body{font:16px/1.5 system-ui,sans-serif;margin:0 auto;max-width:60rem;padding:1rem;color:var(--ink);
background:var(--paper);overflow-wrap:anywhere}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}img,svg{max-width:100%;height:auto}
.wide{overflow-x:auto}table{border-collapse:collapse}td,th{padding:.25rem .75rem .25rem 0;text-align:left;
border-bottom:1px solid var(--line);white-space:nowrap}td.n{text-align:right;font-variant-numeric:tabular-nums}
.curve svg{display:block;width:100%;max-width:44rem}
.partial{background:var(--warn);padding:.5rem 1rem;border-left:4px solid #b58100}
@media(max-width:600px){td,th{padding-right:.5rem}td:first-child{white-space:normal;overflow-wrap:normal}
.many tr{display:block;border-bottom:1px solid var(--line);padding:.3rem 0}
.many tr:first-child{display:none}.many td{display:flex;justify-content:space-between;border:0;padding:0 0 0 1rem;
white-space:normal;text-align:right}.many td:first-child{font-weight:600;padding:0;text-align:left}
.many td:empty{display:none}
.many td.n::before{content:attr(data-of);color:var(--soft);padding-right:1rem;text-align:left}}
"""
_FEW = 3  # columns of a table that fit a phone
BEGINS = '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '


def html_page(title: str, parts: Sequence[str], reload_s: int | None = None) -> str:
    """A whole page. title is text, parts are HTML. reload_s: a browser loads it again after so many seconds."""
    again = f'<meta http-equiv="refresh" content="{reload_s}">' if reload_s else ""
    return (
        f'{BEGINS}content="width=device-width, initial-scale=1">{again}'
        f"<title>{html_text(title)}</title><style>{_STYLE}</style></head><body>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _wide_table(head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """A table that a phone shows, too."""
    kind = "wide many" if len(head) > _FEW else "wide"
    return f'<div class="{kind}">{html_table(head, rows)}</div>'


def html_chart(title: str, draw: "Callable[[Axes], object]", height: float = 3.2, width: float = 7.0) -> str:
    """A curve as SVG. draw(axes) draws it; title makes the ids in the SVG repeatable. height, width: inches.

    The letters have 10 points, so those of a narrower chart are larger on a phone, which shows its whole width.
    """
    import matplotlib  # a page without curves needs none
    from matplotlib.figure import Figure

    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": title, "font.family": "sans-serif"}):
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.add_subplot()
        draw(axes)
        axes.grid(alpha=0.3)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None}, transparent=True)
    svg = out.getvalue()
    return f'<div class="curve">{svg[svg.index("<svg") :]}</div>'


# ---- measurements

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
    files.write_atomic(path, json.dumps(_finite(data), indent=1, allow_nan=False) + "\n")


def write_page(path: Path, result: Result, origin: Origin, last: tuple[NDArray[Any], Spot] | None) -> None:
    """Write the page. last: a picture and its spot, for the reader to see. Raises CannotWrite."""
    began = origin.began.isoformat(sep=" ", timespec="seconds")
    of = " · ".join((began, origin.board, f"camera: {origin.camera}", f"mirrormount {origin.version}"))
    parts = [
        f"<h1>mirrormount measure {html_text(result.experiment)}</h1>",
        f"<p>{html_text(of)}</p>",
    ]
    if result.partial:
        parts.append(
            f'<p class="partial"><b>Ended early:</b> {html_text(result.partial)}. What was measured by then is below:'
            f" {len(result.readings)} readings of the spot. The JSON file has each of them.</p>"
        )
    parts.append("<h2>Results</h2>")
    parts.append(_table(result, origin.optics) if result.estimates else "<p>None yet: it ended too early.</p>")
    parts += [f"<p>{html_text(remark)}</p>" for remark in result.remarks]
    if any(math.isfinite(estimate.error) for estimate in result.estimates.values()):
        parts.append("<p>± is one standard error. The truth is within two of them in 95 of 100 measurements.</p>")
    for series in [*result.series, *(_readings(result) if result.partial and not result.series else ())]:
        parts += [f"<h2>{html_text(series.title)}</h2>", _chart(series)]
    if last:
        picture = html_picture(as_png(*last), "the spot in the picture")
        parts += ["<h2>The camera's last picture, with the spot that was found</h2>", picture]
    parts += ["<h2>Settings of the mount</h2>", _settings(origin.settings)]
    files.write_atomic(path, html_page(f"measure {result.experiment}", parts))


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
    return _wide_table(("", *shown), rows)


def _in_words(estimate: Estimate) -> str:
    """As on the command line, where a unit is a word that can be typed; a page has its symbol."""
    unit = "/".join(_SYMBOLS.get(part, part) for part in estimate.unit.split("/"))
    return str(replace(estimate, unit=unit))


def _settings(settings: Mapping[str, Mapping[str, int | float]]) -> str:
    names = dict.fromkeys(name for values in settings.values() for name in values)
    return _wide_table(("", *settings), [(name, *(each.get(name, "") for each in settings.values())) for name in names])


def _chart(series: Series) -> str:
    """A curve as SVG, with bars of one standard error."""

    def draw(axes: "Axes") -> None:
        x, y, error = np.array(series.points, dtype=float).reshape(-1, 3).T
        style = {"color": "#1f5fa8", "marker": ".", "markersize": 5}
        axes.errorbar(x, y, error if error.any() else None, linestyle="-" if series.joined else "none", lw=1, **style)
        axes.set(xlabel=series.x_label, ylabel=series.y_label)
        if len(x) and (x == np.round(x)).all() and not series.in_picture:
            from matplotlib.ticker import MaxNLocator

            axes.xaxis.set_major_locator(MaxNLocator(integer=True))  # places and steps are counted
        if series.in_picture:
            axes.set_aspect("equal", adjustable="datalim")
            axes.invert_yaxis()
            for at, name, fill in ((0, "begin", "none"), (-1, "end", "#b5521b")):
                axes.plot(x[at], y[at], "o", ms=8, mec="#b5521b", mfc=fill, ls="none", label=name)
            axes.legend(fontsize="small", loc="center")

    return html_chart(series.title, draw, height=4.0 if series.in_picture else 2.8, width=5.2)


# ---- runs

_COLOURS = ("#1f5fa8", "#b5521b", "#3c7d3c", "#7d3c7d")
_OBSERVATIONS_LEAST = 64  # for a spectrum
_TRIPS_SHOWN = 100
_WIDE = 5.2  # inches: letters of a size that is read on a phone
_LONG_S = 3600.0  # from here on in hours


def write_report(path: Path, run: Run) -> None:
    """Write the page. Raises CannotWrite, also if a file is there that is no page."""
    files.check_replaceable(path, BEGINS)
    files.write_atomic(path, html_page("mirrormount hold", list(_parts(run))))


def _parts(run: Run) -> Iterator[str]:
    yield "<h1>How the beam was held</h1>"
    yield f"<p>{html_text(' · '.join(f'{name}: {value}' for name, value in run.about.items() if _is_short(value)))}</p>"
    if not run.minutes:
        yield "<p>The log holds no events.</p>"
        return
    yield "<h2>Result</h2>"
    yield _results(run)
    yield "<p>Errors are from the target. What the loop took for them after an observation counts until the next one;"
    yield "behind an interlock nothing counts. These are the figures that the run itself ended with.</p>"
    yield "<h2>Error, and what it would have been</h2>"
    yield html_chart("errors", lambda axes: _draw_errors(axes, run), 4.2, _WIDE)
    yield "<p>If nobody held it: where the spot would be had nothing been moved since the start. Estimated from the"
    yield "pulses and the response.</p>"
    yield "<h2>Each hour</h2>"
    yield _hours(run)
    yield from _of_observations(run)
    yield "<h2>What the motors did</h2>"
    yield html_chart("drive", lambda axes: _draw_drive(axes, run), width=_WIDE)
    if any(minute.change is not None for minute in run.minutes):
        yield "<h2>How the response changed</h2>"
        yield html_chart("response", lambda axes: _draw_change(axes, run), width=_WIDE)
    yield "<h2>Interlocks</h2>"
    yield _interlocks(run)


def _is_short(value: object) -> bool:
    return isinstance(value, str | int | float) and len(str(value)) < 200


def _results(run: Run) -> str:
    errors = joined([minute.held.errors_um for minute in run.minutes])
    angle = ErrorSums.joined(minute.held.angle_urad for minute in run.minutes)
    rows: list[Sequence[object]] = [
        (f"{camera}, µm", *map(_figure, sums.rms), *map(_figure, sums.mean), _figure(sums.most), sums.observations)
        for camera, sums in errors.items()
    ]
    if angle.observations:
        of_angle = (*map(_figure, angle.rms), *map(_figure, angle.mean), _figure(angle.most), angle.observations)
        rows.append(("angle of the beam, µrad", *of_angle))
    head = ("", "rms x", "rms y", "mean x", "mean y", "largest", "observations")
    span_s = run.minutes[-1].begin_s + MINUTE_S - run.minutes[0].begin_s
    held_s = sum(minute.held_s for minute in run.minutes)
    counts = [
        ("time, in whole minutes", f"{span_s / MINUTE_S:.0f} min"),
        ("held", f"{held_s / MINUTE_S:.1f} min"),
        ("corrections", sum(minute.corrections for minute in run.minutes)),
        ("pulses", sum(minute.pulses for minute in run.minutes)),
        ("reversals", sum(minute.reversals for minute in run.minutes)),
        ("interlocks that tripped", sum(minute.interlocks for minute in run.minutes)),
        ("observations without a spot", sum(minute.missed for minute in run.minutes)),
    ]
    return _wide_table(head, rows) + _wide_table(("", ""), counts)


def _figure(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.3g}"


def _hours(run: Run) -> str:
    """rms of each hour since the start."""
    began_s = run.minutes[0].begin_s
    hours: dict[int, list[Minute]] = {}
    for minute in run.minutes:
        hours.setdefault(int((minute.begin_s - began_s) // 3600), []).append(minute)
    cameras = list(joined([minute.held.errors_um for minute in run.minutes]))
    rows = []
    for hour, minutes in hours.items():
        errors = joined([minute.held.errors_um for minute in minutes])
        cells = [_figure(math.hypot(*errors[camera].rms)) if camera in errors else "–" for camera in cameras]
        corrections, reversals, trips = (
            sum(getattr(minute, name) for minute in minutes) for name in ("corrections", "reversals", "interlocks")
        )
        rows.append((f"hour {hour + 1}", *cells, corrections, reversals, trips))
    head = ("", *(f"{camera}, µm rms" for camera in cameras), "corrections", "reversals", "interlocks")
    return _wide_table(head, rows)


def _of_observations(run: Run) -> Iterator[str]:
    """What needs single observations: those of the events that are kept."""
    if len(run.times_s) < _OBSERVATIONS_LEAST:
        return
    span_s = run.times_s[-1] - run.times_s[0]
    yield f"<h2>Distribution and spectrum of the last {span_s / 60:.0f} min</h2>"
    yield html_chart("histogram", lambda axes: _draw_histogram(axes, run), width=_WIDE)
    yield html_chart("spectrum", lambda axes: _draw_spectrum(axes, run), width=_WIDE)


def _of_time(run: Run) -> tuple[float, str]:
    """The seconds of a unit of time that suits the run, and its name."""
    long = run.minutes[-1].begin_s - run.minutes[0].begin_s >= _LONG_S
    return (3600.0, "hours") if long else (60.0, "minutes")


def _legend(axes: "Axes") -> None:
    """Below the curves: beside or upon them there is no room on a phone."""
    axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, frameon=False)


def _plain(name: str) -> str:
    """A name as a label of a curve, where $ would begin a formula and a leading _ would hide it."""
    text = printable(name).replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text


def _draw_errors(axes: "Axes", run: Run) -> None:
    unit_s, unit = _of_time(run)
    began_s = run.minutes[0].begin_s
    for colour, camera in zip(_COLOURS, joined([minute.held.errors_um for minute in run.minutes]), strict=False):
        kept = [minute for minute in run.minutes if camera in minute.held.errors_um]
        times = [(minute.begin_s - began_s) / unit_s for minute in kept]
        rms = [math.hypot(*minute.held.errors_um[camera].rms) for minute in kept]
        most = [minute.held.errors_um[camera].most for minute in kept]
        axes.plot(times, rms, color=colour, lw=1.2, label=f"{_plain(camera)}: rms of a minute")
        axes.plot(times, most, color=colour, lw=0, marker=".", ms=3, label=f"{_plain(camera)}: largest of a minute")
        free = [minute for minute in kept if camera in minute.free_um]
        if free:
            at = [(minute.begin_s - began_s) / unit_s for minute in free]
            far = [math.hypot(*minute.free_um[camera].mean) for minute in free]
            axes.plot(at, far, color=colour, lw=1, ls=":", label=f"{_plain(camera)}: if nobody held it")
    axes.set(xlabel=unit, ylabel="µm", yscale="log")
    from matplotlib.ticker import LogFormatter

    axes.yaxis.set_major_formatter(LogFormatter())
    axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.5)))
    if axes.lines:
        _legend(axes)


def _draw_histogram(axes: "Axes", run: Run) -> None:
    for colour, (camera, errors) in zip(_COLOURS, run.errors_um.items(), strict=False):
        for at, style in enumerate(("-", "--")):
            values = np.array(errors)[:, at]
            counts, edges = np.histogram(values, bins=60)
            label = f"{_plain(camera)}, {'xy'[at]}"
            axes.stairs(counts, edges, color=colour, ls=style, label=label)
    axes.set(xlabel="error, µm", ylabel="observations")
    _legend(axes)


def _draw_spectrum(axes: "Axes", run: Run) -> None:
    for colour, (camera, errors) in zip(_COLOURS, run.errors_um.items(), strict=False):
        for at, style in enumerate(("-", "--")):
            hz, density = spectrum(np.array(run.times_s), np.array(errors)[:, at])
            axes.plot(hz, density, color=colour, ls=style, lw=1, label=f"{_plain(camera)}, {'xy'[at]}")
    axes.set(xlabel="Hz", ylabel="µm/√Hz", xscale="log", yscale="log")
    _legend(axes)


def _draw_drive(axes: "Axes", run: Run) -> None:
    began_s = run.minutes[0].begin_s
    unit_s, unit = _of_time(run)
    times = [(minute.begin_s - began_s) / unit_s for minute in run.minutes]
    names = dict.fromkeys(name for minute in run.minutes for name in minute.drive_us)
    for name in names:
        pairs = np.array([minute.drive_us.get(name, (0, 0)) for minute in run.minutes]) * 1e-6
        axes.plot(times, np.cumsum(pairs[:, 0] - pairs[:, 1]), lw=1, label=_plain(name))
    axes.set(xlabel=unit, ylabel="drive forward less back, s")
    if names:
        _legend(axes)


def _draw_change(axes: "Axes", run: Run) -> None:
    began_s = run.minutes[0].begin_s
    known = [(minute.begin_s - began_s, minute.change) for minute in run.minutes if minute.change is not None]
    unit_s, unit = _of_time(run)
    axes.plot([at / unit_s for at, _ in known], [100 * change for _, change in known], color=_COLOURS[0], lw=1)
    axes.set(xlabel=unit, ylabel="largest change of a column, %")
    axes.set_ylim(0.0, 110 * max((change for _, change in known), default=1.0) or 1.0)


def _interlocks(run: Run) -> str:
    began_s = run.minutes[0].begin_s
    rows = [(f"{(at_s - began_s) / 60:.1f} min", number, name, cause) for at_s, number, name, cause in run.interlocks]
    if not rows:
        return "<p>None has tripped.</p>"
    more = f"<p>The first {_TRIPS_SHOWN} of {len(rows)}.</p>" if len(rows) > _TRIPS_SHOWN else ""
    return _wide_table(("", "number", "interlock", "cause"), rows[:_TRIPS_SHOWN]) + more
