"""The log of a run that holds a beam: one SQLite file, which a week cannot fill.

    with RunLog(Path("run.sqlite"), {"began": …}) as log:
        hold = Hold(table, response, listen=log)

    with sqlite3.connect("run.sqlite") as file:
        spots = pandas.read_sql("SELECT time_s, camera, x_um, y_um FROM spots", file)

about         name, value: what the run is of, as JSON
events        time_s, state, event, data: every event of the loop (control/events.py), the state that the loop was in,
              and the event's fields as JSON; the newest 300 000, some hours
spots         time_s, state, camera, x_um, y_um: each spot of those events, its error from the target (a view of events)
minutes       begin_s, state (at its end), held_s, missed (spots), corrections, pulses, reversals, interlocks (trips),
              change (of the response, as ResponseChanged): one row a minute, some 100 days
errors        begin_s, kind, name, observations, seconds, x, y, xx, yy, most: ErrorSums of a minute. kind: "held" (um,
              of the camera `name`), "angle" (urad, of the beam), "free" (um: the error if nothing had been moved)
drives        begin_s, actuator, forward_us, back_us: of a minute
interlocks    time_s, number, name, cause: each trip, the newest 10 000

time_s and begin_s are seconds on the table's clock. A thread of its own writes, once a second, in WAL mode: a power cut
costs that second, and a reader sees a run that goes on. A disk that hangs, fails or is full neither stops nor
delays the loop: what cannot be written is counted, `trouble` says why, and with the next second it is tried again.
The file belongs on a disk of this computer: WAL mode needs memory that is shared, which a network share has not.
"""

import contextlib
import json
import math
import queue
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mirrormount import files
from mirrormount.errors import BadFile, CannotWrite
from mirrormount_beam.control.events import (
    CORRECTING,
    CREEPING,
    HOLDING,
    Corrected,
    Estimated,
    Event,
    InterlockTripped,
    Observed,
    Pair,
    Pulsed,
    ResponseChanged,
    SpotSeen,
    StateChanged,
    from_json,
    to_json,
)

MINUTE_S = 60.0
COMMIT_S = 1.0  # what a power cut may cost
HELD = (HOLDING, CORRECTING, CREEPING)
MOST_ROWS = {"events": 300_000, "interlocks": 10_000}
MOST_MINUTES = 150_000
_WAITING_MOST = 20_000  # events in the queue: some minutes of a fast loop
_PATIENCE_S = 5.0  # for a reader that keeps the file
_WINDOW_LEAST = 64  # observations in a window of the spectrum
_SCHEMA = """
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT);
CREATE TABLE events (id INTEGER PRIMARY KEY, time_s REAL, state TEXT, event TEXT, data TEXT);
CREATE VIEW spots AS SELECT events.time_s, state, json_extract(spot.value, '$.camera') AS camera,
  json_extract(spot.value, '$.error_um[0]') AS x_um, json_extract(spot.value, '$.error_um[1]') AS y_um
  FROM events, json_each(data, '$.spots') AS spot WHERE event = 'observation' AND x_um IS NOT NULL;
CREATE TABLE minutes (begin_s REAL PRIMARY KEY, state TEXT, held_s REAL, missed INTEGER, corrections INTEGER,
  pulses INTEGER, reversals INTEGER, interlocks INTEGER, change REAL);
CREATE TABLE errors (begin_s REAL, kind TEXT, name TEXT, observations INTEGER, seconds REAL, x REAL, y REAL,
  xx REAL, yy REAL, most REAL, PRIMARY KEY (begin_s, kind, name));
CREATE TABLE drives (begin_s REAL, actuator TEXT, forward_us INTEGER, back_us INTEGER, PRIMARY KEY (begin_s, actuator));
CREATE TABLE interlocks (id INTEGER PRIMARY KEY, time_s REAL, number INTEGER, name TEXT, cause TEXT);
"""


# ---- errors over time


@dataclass
class ErrorSums:
    """Of the errors of one camera, or of the beam's angle: sums over time of x and y."""

    observations: int = 0
    seconds: float = 0.0
    x: float = 0.0
    y: float = 0.0
    xx: float = 0.0
    yy: float = 0.0
    most: float = 0.0  # largest magnitude along x or y

    def see(self, pair: Pair) -> None:
        """One observation."""
        self.observations += 1
        self.most = max(self.most, *map(abs, pair))

    def last(self, pair: Pair, seconds: float) -> None:
        """The error counts for so many seconds."""
        x, y = pair
        self.seconds += seconds
        self.x += x * seconds
        self.y += y * seconds
        self.xx += x * x * seconds
        self.yy += y * y * seconds

    @classmethod
    def joined(cls, several: "Iterable[ErrorSums]") -> Self:
        """The sums of several stretches of time together."""
        *sums, most = zip(*map(astuple, several), strict=True)
        found = cls(*map(sum, sums))
        found.most = max(most)
        return found

    @property
    def rms(self) -> Pair:
        """Root of the mean square along x and y, about the target. nan without any time."""
        if not self.seconds:
            return math.nan, math.nan
        return math.sqrt(self.xx / self.seconds), math.sqrt(self.yy / self.seconds)

    @property
    def mean(self) -> Pair:
        """Mean along x and y. nan without any time."""
        return (self.x / self.seconds, self.y / self.seconds) if self.seconds else (math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Rms:
    """Root mean squares over time: of the worst error of a spot, and of the beam's angle (None: no distances)."""

    um: float
    urad: float | None

    def times(self, other: "Rms") -> float:
        """How many times as large this one is as another: of the angle where it is known."""
        if other.urad and self.urad is not None:
            return self.urad / other.urad
        return self.um / other.um


@dataclass
class ErrorStatistics:
    """Errors of each camera (um) and of the beam's angle (urad) over time: what `hold` ends with and its report tells.

    The errors that the loop estimates after an observation count until the next estimate. After an interlock has
    tripped nothing counts until the next estimate. So neither the noise of a single observation counts as an error of
    the beam, nor do many observations in a short while count more. before: the estimate that counts since its time.
    """

    errors_um: dict[str, ErrorSums] = field(default_factory=dict)
    angle_urad: ErrorSums = field(default_factory=ErrorSums)
    before: Estimated | None = None

    def take(self, estimate: Estimated) -> None:
        """Take an estimate: the one before it has counted until now."""
        if self.before is not None:
            seconds = max(0.0, estimate.time_s - self.before.time_s)
            for sums, pair in self._each(self.before):
                sums.last(pair, seconds)
        for sums, pair in self._each(estimate):
            sums.see(pair)
        self.before = estimate

    def pause(self) -> None:
        """An interlock has tripped: nothing counts until the next estimate."""
        self.before = None

    @property
    def rms(self) -> Rms:
        """Of all that counted; nan without any time."""
        angle = max(self.angle_urad.rms)
        return Rms(
            max((um for sums in self.errors_um.values() for um in sums.rms), default=math.nan),
            None if math.isnan(angle) else angle,
        )

    def _each(self, estimate: Estimated) -> list[tuple[ErrorSums, Pair]]:
        found = [(self.errors_um.setdefault(name, ErrorSums()), pair) for name, pair in estimate.errors_um.items()]
        return [*found, (self.angle_urad, estimate.angle_urad)] if estimate.angle_urad else found


class LatestErrors:
    """Errors of the newest minutes that were held, up to so many."""

    def __init__(self, minutes: int) -> None:
        self._minutes = minutes
        self._each: deque[ErrorStatistics] = deque([ErrorStatistics()], maxlen=minutes + 1)

    def take(self, estimate: Estimated) -> None:
        """As ErrorStatistics.take()."""
        newest = self._each[-1]
        newest.take(estimate)
        if _seconds(newest) >= MINUTE_S:
            self._each.append(ErrorStatistics(before=estimate))

    def pause(self) -> None:
        """As ErrorStatistics.pause()."""
        self._each[-1].pause()

    @property
    def rms(self) -> Rms | None:
        """Of all these minutes; None before that many have been held."""
        if len(self._each) <= self._minutes:
            return None
        names = self._each[0].errors_um
        errors = {
            name: ErrorSums.joined(each.errors_um[name] for each in self._each if name in each.errors_um)
            for name in names
        }
        return ErrorStatistics(errors, ErrorSums.joined(each.angle_urad for each in self._each)).rms


def _seconds(statistics: ErrorStatistics) -> float:
    return min((sums.seconds for sums in statistics.errors_um.values()), default=0.0)


@dataclass
class Minute:
    """One minute of a run from begin_s on: the row of `minutes`, with those of `errors` and `drives`.

    held, free_um: of the errors. drive_us: for each actuator, the drive in the positive direction and the negative one.
    """

    begin_s: float
    state: str = ""
    held_s: float = 0.0
    missed: int = 0
    corrections: int = 0
    pulses: int = 0
    reversals: int = 0
    interlocks: int = 0
    change: float | None = None
    held: ErrorStatistics = field(default_factory=ErrorStatistics)
    free_um: dict[str, ErrorSums] = field(default_factory=dict)
    drive_us: dict[str, list[int]] = field(default_factory=dict)

    def add(self, event: Event, since_s: float, number: int) -> None:
        """One event. since_s: time of the one before; number: of the correction before."""
        if self.state in HELD:
            self.held_s += max(0.0, event.time_s - since_s)
        match event:
            case StateChanged():
                self.state = event.state
            case Observed() if self.state in HELD:
                for at, spot in enumerate(event.spots):
                    if not isinstance(spot, SpotSeen):
                        self.missed += 1
                    elif at < len(event.free_um):
                        self.free_um.setdefault(spot.camera, ErrorSums()).last(event.free_um[at], 1.0)
            case Estimated():
                self.held.take(event)
            case Corrected():
                self.corrections += event.number != number  # each pulse of a creep is an event, all with one number
                self.reversals += len(event.reversals)
            case Pulsed():
                self.pulses += 1
                self.drive_us.setdefault(event.actuator, [0, 0])[event.us < 0] += abs(event.us)
            case InterlockTripped():
                self.held.pause()
                self.interlocks += 1
            case ResponseChanged():
                self.change = event.change
            case _:
                pass

    def write(self, file: sqlite3.Connection) -> None:
        """Its rows, in place of those that were written while it was younger."""
        counts = self.missed, self.corrections, self.pulses, self.reversals, self.interlocks
        row = self.begin_s, self.state, self.held_s, *counts, self.change
        file.execute(f"REPLACE INTO minutes VALUES ({_marks(9)})", row)
        sums = [("held", name, each) for name, each in self.held.errors_um.items()]
        sums += [("angle", "", self.held.angle_urad)]
        sums += [("free", name, each) for name, each in self.free_um.items()]
        rows = [(self.begin_s, kind, name, *astuple(each)) for kind, name, each in sums]
        file.executemany(f"REPLACE INTO errors VALUES ({_marks(10)})", rows)
        drives = [(self.begin_s, actuator, *us) for actuator, us in self.drive_us.items()]
        file.executemany(f"REPLACE INTO drives VALUES ({_marks(4)})", drives)


def _marks(count: int) -> str:
    return ", ".join("?" * count)


# ---- written


class RunLog:
    """Writes events into a new file. Call it with each; close() writes what is left. Use `with`.

    patient: wait for the disk, for a simulation that is faster than it; otherwise an event waits for nothing.
    lost: events that were not written. Raises CannotWrite if the file exists or cannot be made.
    """

    def __init__(self, path: Path, about: Mapping[str, Any], *, patient: bool = False) -> None:
        self.path = path
        self.trouble = ""
        self.lost = 0
        self._patient = patient
        self._waiting: queue.Queue[Event | None] = queue.Queue(_WAITING_MOST)
        self._minute: Minute | None = None
        self._since_s = 0.0
        self._number = -1  # of the last correction
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.open("xb").close()
            self._file = sqlite3.connect(path, timeout=_PATIENCE_S, isolation_level=None, check_same_thread=False)
            self._file.execute("PRAGMA journal_mode = WAL")
            self._file.execute("PRAGMA synchronous = FULL")  # a commit is on the disk
            self._file.executescript(_SCHEMA)
            rows = [(name, json.dumps(value)) for name, value in about.items()]
            self._file.executemany("INSERT INTO about VALUES (?, ?)", rows)
        except FileExistsError:
            raise CannotWrite(f"cannot write {path}: it exists; each run has a file of its own") from None
        except (OSError, sqlite3.Error) as e:
            raise CannotWrite(f"cannot write {path}: {_why(e)}") from e
        self._thread = threading.Thread(target=self._write_all, name="run log", daemon=True)
        self._thread.start()

    def __call__(self, event: Event) -> None:
        """Take an event; returns at once unless patient."""
        try:
            self._waiting.put(event, block=self._patient)
        except queue.Full:
            self.lost += 1

    def close(self) -> None:
        """Write what waits. Raises CannotWrite if the log is not whole."""
        self._waiting.put(None)
        self._thread.join()
        if self.trouble or self.lost:
            why = self.trouble or "the disk was too slow"
            raise CannotWrite(f"the log {self.path} is not whole, {self.lost} events are missing: {why}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, _error: object, _trace: TracebackType | None) -> None:
        try:
            self.close()
        except CannotWrite:
            if kind is None:  # a log must not hide the exception that is on its way
                raise

    def _write_all(self) -> None:
        """The thread: what has come within a second is one commit."""
        going_on = True
        while going_on:
            events: list[Event] = []
            end_s = time.monotonic() + COMMIT_S
            while len(events) < _WAITING_MOST and (left_s := end_s - time.monotonic()) > 0:
                with contextlib.suppress(queue.Empty):
                    if (event := self._waiting.get(timeout=left_s)) is None:
                        going_on = False
                        break
                    events.append(event)
            if events:
                self._commit(events)
        with contextlib.suppress(sqlite3.Error):  # what is committed is on the disk
            self._file.execute("PRAGMA journal_mode = DELETE")  # a log that is complete is one file
        self._file.close()

    def _commit(self, events: list[Event]) -> None:
        """All of them, or none if the disk fails."""
        try:
            self._file.execute("BEGIN")
            for event in events:
                self._write(event)
            if self._minute:
                self._minute.write(self._file)
            self._delete_oldest()
            self._file.execute("COMMIT")
        except sqlite3.Error as e:
            self.lost += len(events)
            self.trouble = _why(e)
            with contextlib.suppress(sqlite3.Error):  # it may have been rolled back by itself
                self._file.execute("ROLLBACK")

    def _delete_oldest(self) -> None:
        for table, most in MOST_ROWS.items():
            self._file.execute(f"DELETE FROM {table} WHERE id <= (SELECT max(id) FROM {table}) - ?", (most,))
        if self._minute:
            oldest_s = self._minute.begin_s - MOST_MINUTES * MINUTE_S
            for table in ("minutes", "errors", "drives"):
                self._file.execute(f"DELETE FROM {table} WHERE begin_s < ?", (oldest_s,))

    def _write(self, event: Event) -> None:
        begin_s = event.time_s // MINUTE_S * MINUTE_S
        if self._minute is None:
            self._minute = Minute(begin_s)
            self._since_s = event.time_s
        elif begin_s > self._minute.begin_s:
            self._minute.write(self._file)
            before = self._minute
            self._minute = Minute(begin_s, before.state, held=ErrorStatistics(before=before.held.before))
        self._minute.add(event, self._since_s, self._number)
        self._since_s = event.time_s
        data = to_json(event)
        row = event.time_s, self._minute.state, data.pop("event"), json.dumps(data, separators=(",", ":"))
        self._file.execute("INSERT INTO events (time_s, state, event, data) VALUES (?, ?, ?, ?)", row)
        if isinstance(event, Corrected):
            self._number = event.number
        elif isinstance(event, InterlockTripped):
            trip = event.time_s, event.number, event.name, event.cause
            self._file.execute("INSERT INTO interlocks (time_s, number, name, cause) VALUES (?, ?, ?, ?)", trip)


# ---- read


@dataclass
class Run:
    """A log that was read.

    times_s, errors_um: of the observations in the kept events while the beam was held, each by itself; errors_um for
    each camera, shape (observations, 2). interlocks: time_s, number, name and cause of each trip.
    """

    about: dict[str, Any]
    minutes: list[Minute] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    errors_um: dict[str, list[Pair]] = field(default_factory=dict)
    interlocks: list[tuple[float, int, str, str]] = field(default_factory=list)


def read_run(path: Path) -> Run:
    """Read a log, of a run that goes on as well. Raises BadFile if it is none."""
    if not path.exists():
        raise BadFile(f"{path}: there is no such file")
    try:
        with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as file:
            run = _read(file)
        _check(run)
        return run
    except (sqlite3.Error, KeyError, TypeError, ValueError, AttributeError) as e:
        raise BadFile(f"{path}: no log of a run ({e})") from e


def _read(file: sqlite3.Connection) -> Run:
    file.execute("BEGIN")  # all that is read is of one moment
    run = Run({name: files.parse_json(value.encode()) for name, value in file.execute("SELECT * FROM about")})
    minutes = {row[0]: Minute(*row) for row in file.execute("SELECT * FROM minutes ORDER BY begin_s")}
    for begin_s, kind, name, *sums in file.execute("SELECT * FROM errors"):
        if minute := minutes.get(begin_s):
            if kind == "angle":
                minute.held.angle_urad = ErrorSums(*sums)
            else:
                (minute.free_um if kind == "free" else minute.held.errors_um)[name] = ErrorSums(*sums)
    for begin_s, actuator, *us in file.execute("SELECT * FROM drives"):
        if minute := minutes.get(begin_s):
            minute.drive_us[actuator] = us
    run.minutes = list(minutes.values())
    run.interlocks = list(file.execute("SELECT time_s, number, name, cause FROM interlocks ORDER BY id"))
    held = f"event = 'observation' AND state IN ({_marks(len(HELD))})"
    for (data,) in file.execute(f"SELECT data FROM events WHERE {held} ORDER BY id", HELD):
        seen = from_json({"event": "observation", **files.parse_json(data.encode())})
        if isinstance(seen, Observed) and seen.complete:
            run.times_s.append(seen.time_s)
            for spot in seen.spots:
                assert isinstance(spot, SpotSeen)
                run.errors_um.setdefault(spot.camera, []).append(spot.error_um)
    return run


_MOST = 1e12  # of any figure of a log: a second, a micrometre, a count; sums of squares have its square
_SPAN_S = 10 * 366 * 86_400.0  # no run is longer
_NAME_MOST = 100  # characters


def _check(run: Run) -> None:
    """Raise ValueError for what no run writes; a report of it would be none, or never end."""
    times_s = [minute.begin_s for minute in run.minutes]
    _bounded(_MOST, *times_s, *run.times_s, *(trip[0] for trip in run.interlocks))
    if times_s and times_s[-1] - times_s[0] > _SPAN_S:
        raise ValueError("a run of more than ten years")
    if len(run.times_s) > 1 and not run.times_s[-1] > run.times_s[0]:
        raise ValueError("observations at one time")
    for minute in run.minutes:
        counts = minute.held_s, minute.missed, minute.corrections, minute.pulses, minute.reversals, minute.interlocks
        _bounded(_MOST, *counts, *(us for pair in minute.drive_us.values() for us in pair), least=0)
        _bounded(_MOST, minute.change or 0.0)
        by_camera = {**minute.held.errors_um, **{f"free {name}": sums for name, sums in minute.free_um.items()}}
        for sums in (minute.held.angle_urad, *by_camera.values()):
            _bounded(_MOST**2, *astuple(sums))
            _bounded(_MOST**2, sums.observations, sums.seconds, sums.xx, sums.yy, sums.most, least=0)
        names = [*by_camera, *minute.drive_us]
        if any(len(name) > _NAME_MOST for name in names):
            raise ValueError("a name that is too long")
    _bounded(_MOST, *(value for errors in run.errors_um.values() for pair in errors for value in pair))


def _bounded(most: float, *values: float, least: float | None = None) -> None:
    for value in values:
        if not (-most if least is None else least) <= value <= most:  # also if it is not a number
            raise ValueError(f"{value!r} is no figure of a run")


def joined(by_camera: Iterable[Mapping[str, ErrorSums]]) -> dict[str, ErrorSums]:
    """The sums of several times, by camera."""
    found: dict[str, list[ErrorSums]] = {}
    for each in by_camera:
        for camera, sums in each.items():
            found.setdefault(camera, []).append(sums)
    return {camera: ErrorSums.joined(sums) for camera, sums in found.items()}


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
