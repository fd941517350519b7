"""The report of a run, made of its log: how well the beam was held, what it would have done, what was done for it."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogFormatter

from mirrormount.beam.html_page import BEGINS, chart, page, table, text
from mirrormount.beam.runlog import MINUTE_S, ErrorSums, Minute, Run, joined, spectrum
from mirrormount.common import whole_file

_COLOURS = ("#1f5fa8", "#b5521b", "#3c7d3c", "#7d3c7d")
_OBSERVATIONS_LEAST = 64  # for a spectrum
_TRIPS_SHOWN = 100
_WIDE = 5.2  # inches: letters of a size that is read on a phone
_LONG_S = 3600.0  # from here on in hours


def write_report(path: Path, run: Run) -> None:
    """Write the page. Raises CannotWrite, also if a file is there that is no page."""
    whole_file.check_replaceable(path, BEGINS)
    whole_file.write(path, page("mirrormount hold", list(_parts(run))))


def _parts(run: Run) -> Iterator[str]:
    yield "<h1>How the beam was held</h1>"
    yield f"<p>{text(' · '.join(f'{name}: {value}' for name, value in run.about.items() if _is_short(value)))}</p>"
    if not run.minutes:
        yield "<p>The log holds no events.</p>"
        return
    yield "<h2>Result</h2>"
    yield _results(run)
    yield "<p>Errors are from the target. What the loop took for them after an observation counts until the next one;"
    yield "behind an interlock nothing counts. These are the figures that the run itself ended with.</p>"
    yield "<h2>Error, and what it would have been</h2>"
    yield chart("errors", lambda axes: _draw_errors(axes, run), 4.2, _WIDE)
    yield "<p>If nobody held it: where the spot would be had nothing been moved since the start. Estimated from the"
    yield "pulses and the response.</p>"
    yield "<h2>Each hour</h2>"
    yield _hours(run)
    yield from _of_observations(run)
    yield "<h2>What the motors did</h2>"
    yield chart("drive", lambda axes: _draw_drive(axes, run), width=_WIDE)
    if any(minute.change is not None for minute in run.minutes):
        yield "<h2>How the response changed</h2>"
        yield chart("response", lambda axes: _draw_change(axes, run), width=_WIDE)
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
    return table(head, rows) + table(("", ""), counts)


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
    return table(head, rows)


def _of_observations(run: Run) -> Iterator[str]:
    """What needs single observations: those of the events that are kept."""
    if len(run.times_s) < _OBSERVATIONS_LEAST:
        return
    span_s = run.times_s[-1] - run.times_s[0]
    yield f"<h2>Distribution and spectrum of the last {span_s / 60:.0f} min</h2>"
    yield chart("histogram", lambda axes: _draw_histogram(axes, run), width=_WIDE)
    yield chart("spectrum", lambda axes: _draw_spectrum(axes, run), width=_WIDE)


def _of_time(run: Run) -> tuple[float, str]:
    """The seconds of a unit of time that suits the run, and its name."""
    long = run.minutes[-1].begin_s - run.minutes[0].begin_s >= _LONG_S
    return (3600.0, "hours") if long else (60.0, "minutes")


def _legend(axes: Axes) -> None:
    """Below the curves: beside or upon them there is no room on a phone."""
    axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, frameon=False)


def _draw_errors(axes: Axes, run: Run) -> None:
    unit_s, unit = _of_time(run)
    began_s = run.minutes[0].begin_s
    for colour, camera in zip(_COLOURS, joined([minute.held.errors_um for minute in run.minutes]), strict=False):
        kept = [minute for minute in run.minutes if camera in minute.held.errors_um]
        times = [(minute.begin_s - began_s) / unit_s for minute in kept]
        rms = [math.hypot(*minute.held.errors_um[camera].rms) for minute in kept]
        most = [minute.held.errors_um[camera].most for minute in kept]
        axes.plot(times, rms, color=colour, lw=1.2, label=f"{camera}: rms of a minute")
        axes.plot(times, most, color=colour, lw=0, marker=".", ms=3, label=f"{camera}: largest of a minute")
        free = [minute for minute in kept if camera in minute.free_um]
        if free:
            at = [(minute.begin_s - began_s) / unit_s for minute in free]
            far = [math.hypot(*minute.free_um[camera].mean) for minute in free]
            axes.plot(at, far, color=colour, lw=1, ls=":", label=f"{camera}: if nobody held it")
    axes.set(xlabel=unit, ylabel="µm", yscale="log")
    axes.yaxis.set_major_formatter(LogFormatter())
    axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.5)))
    if axes.lines:
        _legend(axes)


def _draw_histogram(axes: Axes, run: Run) -> None:
    for colour, (camera, errors) in zip(_COLOURS, run.errors_um.items(), strict=False):
        for at, style in enumerate(("-", "--")):
            values = np.array(errors)[:, at]
            counts, edges = np.histogram(values, bins=60)
            label = f"{camera}, {'xy'[at]}"
            axes.stairs(counts, edges, color=colour, ls=style, label=label)
    axes.set(xlabel="error, µm", ylabel="observations")
    _legend(axes)


def _draw_spectrum(axes: Axes, run: Run) -> None:
    for colour, (camera, errors) in zip(_COLOURS, run.errors_um.items(), strict=False):
        for at, style in enumerate(("-", "--")):
            hz, density = spectrum(np.array(run.times_s), np.array(errors)[:, at])
            axes.plot(hz, density, color=colour, ls=style, lw=1, label=f"{camera}, {'xy'[at]}")
    axes.set(xlabel="Hz", ylabel="µm/√Hz", xscale="log", yscale="log")
    _legend(axes)


def _draw_drive(axes: Axes, run: Run) -> None:
    began_s = run.minutes[0].begin_s
    unit_s, unit = _of_time(run)
    times = [(minute.begin_s - began_s) / unit_s for minute in run.minutes]
    names = dict.fromkeys(name for minute in run.minutes for name in minute.drive_us)
    for name in names:
        pairs = np.array([minute.drive_us.get(name, (0, 0)) for minute in run.minutes]) * 1e-6
        axes.plot(times, np.cumsum(pairs[:, 0] - pairs[:, 1]), lw=1, label=name)
    axes.set(xlabel=unit, ylabel="drive forward less back, s")
    if names:
        _legend(axes)


def _draw_change(axes: Axes, run: Run) -> None:
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
    return table(("", "number", "interlock", "cause"), rows[:_TRIPS_SHOWN]) + more
