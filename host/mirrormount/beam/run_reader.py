"""Reads the log of a run, one that goes on or was cut by a power cut as well."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirrormount.beam.control.events import Estimated, Event, Looked, SpotSeen, StateChanged, from_json
from mirrormount.beam.run_log import ABOUT, EVENTS, MINUTES
from mirrormount.beam.run_minutes import HELD, MINUTE_S, Minute, minute_from_json
from mirrormount.common import json_text
from mirrormount.common.errors import BadFile

_LONGEST = 1 << 16  # bytes of a line
_WINDOW_LEAST = 64  # looks in a window of the spectrum


@dataclass
class Run:
    """A log that was read. damaged: lines that are none of its form, such as the last one before a power cut.

    minutes: all of them, with the last ones made of the events if they were cut. times_s, errors_um, angle_urad: of the
    looks in the kept events while the beam was held, each by itself; errors_um for each camera, shape (looks, 2).
    """

    about: dict[str, Any]
    minutes: list[Minute] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    errors_um: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    damaged: int = 0


def read_run(folder: Path) -> Run:
    """Read a log, of a run that goes on as well. Raises BadFile if it is none."""
    try:
        about = json_text.read(folder / ABOUT)
        if not isinstance(about, dict):
            raise ValueError("no object")
    except (OSError, ValueError) as e:
        raise BadFile(f"{folder}: no log of a run ({ABOUT}: {_why(e)})") from e
    run = Run(about)
    for data in _lines(folder / MINUTES, run):
        try:
            run.minutes.append(minute_from_json(data))
        except (TypeError, ValueError, AttributeError):
            run.damaged += 1
    known_s = run.minutes[-1].begin_s + MINUTE_S if run.minutes else -math.inf
    state = ""
    for path in sorted(folder.glob(EVENTS)):
        state = _add_events(path, run, known_s, state)
    return run


def _lines(path: Path, run: Run) -> Iterator[dict[str, Any]]:
    """The objects of a file of JSON lines; what is none is counted."""
    try:
        with path.open("rb") as file:
            while line := file.readline(_LONGEST):
                try:
                    data = json_text.loads(line)
                    if not isinstance(data, dict):
                        raise ValueError("no object")
                    yield data
                except ValueError:
                    run.damaged += 1
    except OSError as e:
        raise BadFile(f"{path}: {e.strerror}") from e


def _add_events(path: Path, run: Run, known_s: float, state: str) -> str:
    """The looks of a segment, and the minutes that the file of minutes, which ends at known_s, does not have.

    state: of the loop at its begin ("": not known). Returns that at its end.
    """
    for data in _lines(path, run):
        try:
            event = from_json(data)
            _check(event)
        except (KeyError, TypeError, ValueError, AttributeError):
            run.damaged += 1
            continue
        if isinstance(event, StateChanged):
            state = event.state
        if event.time_s >= known_s:
            _into_minute(event, run)
        if isinstance(event, Looked) and event.complete and (state in HELD or not state):
            run.times_s.append(event.time_s)
            for spot in event.spots:
                assert isinstance(spot, SpotSeen)
                run.errors_um.setdefault(spot.camera, []).append(spot.error_um)
    return state


def _check(event: Event) -> None:
    """Raises TypeError or ValueError for an event whose numbers are none."""
    if not math.isfinite(event.time_s):
        raise ValueError
    if isinstance(event, Looked):
        for spot in event.spots:
            if isinstance(spot, SpotSeen) and not all(math.isfinite(um) for um in spot.error_um):
                raise ValueError
    if isinstance(event, Estimated):
        for pair in (*event.errors_um.values(), event.angle_urad or (0.0, 0.0)):
            if len(pair) != 2 or not all(math.isfinite(um) for um in pair):
                raise ValueError


def _into_minute(event: Event, run: Run) -> None:
    last = run.minutes[-1] if run.minutes else None
    if last is None or last.begin_s != event.time_s // MINUTE_S * MINUTE_S:
        run.minutes.append(Minute.after(last, event.time_s))
    run.minutes[-1].add(event)


def spectrum(
    times_s: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies, Hz, and amplitude density, unit/√Hz, of values at almost regular times.

    Values are interpolated to regular times. Welch's average of half-overlapping Hann windows (P. D. Welch 1967), one
    sided: the density squared, summed over frequency, is the variance.
    """
    count = len(times_s)
    regular = np.interp(np.linspace(times_s[0], times_s[-1], count), times_s, values)
    step_s = (times_s[-1] - times_s[0]) / (count - 1)
    length = min(count, max(_WINDOW_LEAST, 1 << int(math.log2(count / 4))))
    window = np.hanning(length + 1)[:-1]
    powers = []
    for start in range(0, count - length + 1, length // 2):
        part = regular[start : start + length]
        powers.append(np.abs(np.fft.rfft((part - part.mean()) * window)) ** 2)
    density = 2 * np.mean(powers, axis=0) * step_s / (window**2).sum()
    return np.fft.rfftfreq(length, step_s)[1:], np.sqrt(density[1:])


def _why(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
