"""Scans: a mount visits the places of a pattern, and a signal is read at each. Patterns, files, and the live picture.

    for sample in scan(mount, raster(9, 9), power):  # power(mount) returns a number
        print(sample.x, sample.y, sample.values)

The motors are off while a signal is read, between two samples, and after any end. A stop by any thread or by
`mirrormount stop` ends the scan.

A pattern has its places in whole steps of two axes, relative to the start, in the order in which they are visited. A
gap of the drivetrain shifts places that are approached from different sides. A raster approaches all its places from
one side, unless it is a serpentine; a spiral and a line approach them as they come.

The files are CSV, row by row, and HDF5, whole (h5py is imported for it alone). Both have the same metadata: lines
`# name: JSON` at the head of a CSV file, attributes of the HDF5 file. A CSV file ends with the line `# ended: …`;
without it the writing program was cut off, and all rows above are good.

The live picture is a page in a file that a browser reloads while the scan is under way. It has a map for each value of
the signal: a square a place, from the least value (dark) to the largest (bright); a place without a value is crossed
out. It needs no server and no drawing package.
"""

import contextlib
import csv
import importlib.util
import io
import json
import math
import os
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from mirrormount import files
from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, CannotWrite, ExtraMissing, MountError
from mirrormount.markup import html_table, html_text
from mirrormount.terminal import install_command, printable
from mirrormount.values import whole_number
from mirrormount_beam.camera import Camera, Image
from mirrormount_beam.errors import SpotLost
from mirrormount_beam.observe import OF_MEASUREMENT, SpotObserver
from mirrormount_beam.report import BEGINS, html_page
from mountfw import __version__

if TYPE_CHECKING:
    from mirrormount_beam.scale import Scale


# ---- patterns

FARTHEST = 2000  # steps of an axis from the start: more than ten turns of a screw
_MOST_PLACES = 100_000
APPROACH = 4  # steps: more than the gap of any mount so far (1.6 steps of the paper's)


class Place(NamedTuple):
    """A place in steps from the start. measured: False on the way to the next one."""

    x: int
    y: int
    measured: bool = True


@dataclass(frozen=True, slots=True)
class Pattern:
    """Places in their order. parameters: what it was made of, for the files of a scan."""

    name: str
    parameters: Mapping[str, int | bool]
    places: tuple[Place, ...]

    def __post_init__(self) -> None:
        """Raises BadValue for a place that is too far."""
        far = max(max(abs(place.x), abs(place.y)) for place in self.places)
        if far > FARTHEST:
            raise BadValue(f"a {self.name} stays within {FARTHEST} steps of the start on each axis, not {far}")

    @property
    def measured(self) -> int:
        """How many places are measured."""
        return sum(place.measured for place in self.places)


def raster(columns: int, rows: int, pitch: int = 1, *, serpentine: bool = False, approach: int = APPROACH) -> Pattern:
    """Rows of places, pitch steps apart, about the start, from the lowest row up.

    Each row is run to the right, after a way back that goes `approach` steps beyond its first place: so the gap is
    taken up on the same side for all of them. serpentine: every second row is run to the left, which is faster, and the
    gap shears the rows unless the board takes it up. Raises BadValue.
    """
    columns, rows, pitch = _count(columns, "columns"), _count(rows, "rows"), _count(pitch, "the pitch")
    approach = 0 if serpentine else _count(approach, "the approach", 0)
    if columns * rows > _MOST_PLACES:
        raise BadValue(f"a raster has at most {_MOST_PLACES} places, not {columns} x {rows}")
    left, low = -((columns - 1) * pitch // 2), -((rows - 1) * pitch // 2)
    places: list[Place] = [Place(left - approach, low - approach, False)] if approach else []
    for row in range(rows):
        y = low + row * pitch
        places += [Place(left - approach, y, False)] if approach else []
        line = [Place(left + column * pitch, y) for column in range(columns)]
        places += reversed(line) if serpentine and row % 2 else line
    made_of = {"columns": columns, "rows": rows, "pitch": pitch, "serpentine": serpentine, "approach": approach}
    return Pattern("raster", made_of, tuple(places))


def spiral(rings: int, pitch: int = 1) -> Pattern:
    """A square spiral from the start outwards, of so many rings that are pitch steps apart. Raises BadValue."""
    rings, pitch = _count(rings, "rings", 0), _count(pitch, "the pitch")
    if (2 * rings + 1) ** 2 > _MOST_PLACES:
        raise BadValue(f"a spiral has at most {_MOST_PLACES} places, not {(2 * rings + 1) ** 2}")
    return Pattern("spiral", {"rings": rings, "pitch": pitch}, tuple(_outwards(rings, pitch)))


def line(by_x: int, by_y: int, count: int) -> Pattern:
    """So many places from the start on, each (by_x, by_y) steps from the one before. Raises BadValue."""
    by_x, by_y = whole_number(by_x, FARTHEST, "x of a step of the line"), whole_number(by_y, FARTHEST, "its y")
    count = _count(count, "the number of places")
    if not (by_x or by_y):
        raise BadValue("a line leads somewhere: x, y or both are not 0")
    return Pattern(
        "line",
        {"by_x": by_x, "by_y": by_y, "count": count},
        tuple(Place(number * by_x, number * by_y) for number in range(count)),
    )


def _outwards(rings: int, pitch: int) -> Iterator[Place]:
    """Each place of the square once, neighbours one after the other."""
    x = y = 0
    yield Place(0, 0)
    for ring in range(1, rings + 1):
        side = 2 * ring
        for by_x, by_y, count in ((1, 0, 1), (0, 1, side - 1), (-1, 0, side), (0, -1, side), (1, 0, side)):
            for _ in range(count):
                x, y = x + by_x * pitch, y + by_y * pitch
                yield Place(x, y)


def _count(value: int, what: str, least: int = 1) -> int:
    number = whole_number(value, _MOST_PLACES, what)
    if number < least:
        raise BadValue(f"{what}: {least} or more, not {number}")
    return number


# ---- scans

_TRIES = 3  # images in which a spot is looked for


class NoValue(Exception):
    """Raised by a signal that has no value at this place; the message says why."""


@dataclass(frozen=True, slots=True)
class Sample:
    """A measured place of a scan.

    time_s: since the scan began, on the mount's clock. x, y: steps from the start, as commanded. position_…,
    certainty_…: as the board says. values: those of Signal.columns; empty if there are none, and missing says why.
    """

    number: int
    time_s: float
    x: int
    y: int
    position_x: float
    certainty_x: str
    position_y: float
    certainty_y: str
    values: tuple[float, ...]
    missing: str = ""

    def _repr_html_(self) -> str:
        values = self.missing or ", ".join(f"{value:.5g}" for value in self.values)
        at = f"{self.position_x:+.3f}, {self.position_y:+.3f} ({self.certainty_x}, {self.certainty_y})"
        rows = [(f"{self.x}, {self.y}", at, values)]
        return html_table(("x, y, steps from the start", "positions", "values"), rows)


@dataclass(frozen=True)
class Signal:
    """What is read at each place. columns: the unit of each value by its name. read: raises NoValue."""

    columns: Mapping[str, str]
    read: Callable[[Mount], Sequence[float]]

    @classmethod
    def of(cls, signal: "Signal | Callable[[Mount], float]") -> "Signal":
        """The signal itself, or a signal of one column, `value`: what a function returns."""
        if isinstance(signal, Signal):
            return signal

        def read(mount: Mount) -> tuple[float]:
            value = signal(mount)
            try:
                return (float(value),)
            except (TypeError, ValueError):
                raise BadValue(
                    f"the signal is one number at each place, not {printable(repr(value), 60)}; for several of them"
                    " give a Signal, such as spot_signal(camera)"
                ) from None

        return cls({"value": ""}, read)


def spot_signal(camera: Camera) -> Signal:
    """Place, its standard errors, and peak of the spot in an image that is exposed when the mount has settled."""
    observer = SpotObserver(camera, patience=replace(OF_MEASUREMENT, missed=_TRIES, doubted=_TRIES))

    def read(_mount: Mount) -> tuple[float, ...]:
        try:
            seen = observer.observe(1)
        except SpotLost as e:
            raise NoValue(str(e)) from e
        return seen.x, seen.y, seen.error_x, seen.error_y, seen.peak

    return Signal({"spot_x": "px", "spot_y": "px", "error_x": "px", "error_y": "px", "peak": "grey"}, read)


def grey_signal(camera: Camera) -> Signal:
    """The mean grey value, of what is looked at, in an image that is exposed when the mount has settled."""
    observer = SpotObserver(camera)
    return Signal({"grey": "grey"}, lambda _mount: (_mean(observer.settled()),))


def _mean(frame: Image) -> float:
    return float(frame.selection.pixels(frame.image).mean())


def scan(
    mount: Mount, pattern: Pattern, signal: Signal | Callable[[Mount], float], *, back: bool = False
) -> Generator[Sample, None, None]:
    """Visit the places of a pattern; a Sample of each that is measured, as soon as it is there.

    back: return to the start after the last one; not after an error or a stop. A value that is not finite is none.
    Raises MountError and what the signal raises, motors off. To end it early, close() the iterator.
    """
    signal = Signal.of(signal)
    begun_s, x, y, number = mount.link.monotonic(), 0, 0, 0
    try:
        with mount.unless_stopped():
            for place in pattern.places:
                _move(mount, place.x - x, place.y - y)
                x, y = place.x, place.y
                if place.measured:
                    values, missing = _read(signal, mount)
                    now = mount.status()
                    yield Sample(
                        number,
                        mount.link.monotonic() - begun_s,
                        x,
                        y,
                        now.x.position,
                        now.x.certainty,
                        now.y.position,
                        now.y.certainty,
                        values,
                        missing,
                    )
                    number += 1
            if back:
                _move(mount, -x, -y)
    except BaseException:
        with contextlib.suppress(MountError):  # the board's keep-alive stands behind it
            mount.stop()
        raise


@dataclass(frozen=True, slots=True)
class Found:
    """Where a search saw the beam, in steps from its start; after so many places."""

    x: int
    y: int
    places: int


def find(mount: Mount, see: Callable[[Mount], object], rings: int = 10, pitch: int = 1) -> Found | None:
    """Search the beam in a spiral and stay where see(mount) is true first; None, and back at the start, if nowhere.

    Raises as scan(), motors off.
    """
    samples = scan(mount, spiral(rings, pitch), lambda here: 1.0 if see(here) else 0.0, back=True)
    with contextlib.closing(samples):
        for sample in samples:
            if sample.values[0]:
                return Found(sample.x, sample.y, sample.number + 1)
    return None


def _move(mount: Mount, by_x: int, by_y: int) -> None:
    """One axis after the other; returns when both are at rest."""
    for axis, by in ((mount.x, by_x), (mount.y, by_y)):
        if by:
            axis.step(by)


def _read(signal: Signal, mount: Mount) -> tuple[tuple[float, ...], str]:
    """The values, or none and the reason."""
    try:
        values = tuple(float(value) for value in signal.read(mount))
    except NoValue as e:
        return (), str(e)
    for name, value in zip(signal.columns, values, strict=True):
        if not math.isfinite(value):
            return (), f"{name} is not finite: {value}"
    return values, ""


# ---- the live picture

_RELOAD_S = 2
_EVERY_S = 1.0  # at least, between two pages; a large one that takes long to write comes less often
_SHARE = 20.0  # writing the page takes at most this part (1 in 20) of the scan's time
_MOST_PX = 640.0  # of a map's longer side
_SIDE_PX = 28.0  # of a place in a small map
_DARK, _MIDDLE, _BRIGHT = (48, 18, 92), (198, 66, 84), (252, 230, 120)


class ScanPage:
    """The page of one scan. columns of errors are not shown. path None: no file, for a notebook, which shows it."""

    def __init__(self, path: Path | None, pattern: Pattern, signal: Signal) -> None:
        """Write the empty page. Raises CannotWrite, also if a file is there that is no page."""
        if path:
            files.check_replaceable(path, BEGINS)
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
        if not self._path:
            return
        begun_s = time.monotonic()
        state = f"Ended: {ended}" if ended else "Under way; this page reloads itself"
        parts = [
            f"<h1>mirrormount scan {html_text(self._pattern.name)}</h1>",
            *self._maps(f"{html_text(state)}."),
        ]
        files.write_atomic(self._path, html_page("mirrormount scan", parts, None if ended else _RELOAD_S))
        self._next_s = time.monotonic() + max(_EVERY_S, _SHARE * (time.monotonic() - begun_s))

    def _repr_html_(self) -> str:
        return "".join(self._maps())

    def _maps(self, state: str = "") -> list[str]:
        parts = [f"<p>{len(self._samples)} of {self._pattern.measured} places. {state}</p>"]
        for k, (name, unit) in enumerate(self._signal.columns.items()):
            if not name.startswith("error_"):
                parts += self._map(k, name, unit)
        missing = [sample.missing for sample in self._samples if sample.missing]
        if missing:
            parts.append(f"<p>{len(missing)} without a value; the last: {html_text(missing[-1])}</p>")
        return parts

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
        return f"<h2>{html_text(words)}</h2>", f'<svg class="map" {size} {box} role="img">{places}</svg>'

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


# ---- files

_T = TypeVar("_T")
COMPLETE = "complete"
UNKNOWN = "not known"
_UNITS = {"time_s": "s", "x": "steps", "y": "steps", "position_x": "steps", "position_y": "steps"}
_OWN = tuple(field.name for field in fields(Sample) if field.name not in ("values", "missing"))
_WHOLE = ("number", "x", "y")
_TEXTS = ("certainty_x", "certainty_y", "missing")
_ROOM, _ROOM_OF_PLACE = 1 << 16, 320  # bytes of an HDF5 file without places, and of each place; measured
Metadata = Mapping[str, Any]  # values that JSON has


def metadata(mount: Mount, pattern: Pattern, signal: Signal, **more: Any) -> Metadata:
    """All that is known at the start of a scan. more: values that JSON has, such as those of of_camera()."""
    return {
        "format": "mirrormount scan 1",
        "version": __version__,
        "started": datetime.now().astimezone().isoformat(timespec="milliseconds"),
        "identity": mount.identity,
        "board_id": mount.board_id,
        "settings": mount.settings(),
        "pattern": pattern.name,
        "pattern_parameters": dict(pattern.parameters),
        "places": pattern.measured,
        "units": {**_UNITS, **signal.columns},
        **more,
    }


def of_camera(camera: Camera, scale: "Scale | None") -> Metadata:
    """What is known of a camera: a value that is not known is null; without a scale, camera_scale is UNKNOWN."""
    now = camera.controls
    return {
        "camera": camera.name,
        "camera_size": str(camera.size),
        "camera_selection": str(camera.selection),
        "camera_scale": asdict(scale) if scale else UNKNOWN,
        "camera_exposure": {"value": now.exposure, "unit": now.exposure_unit, "fixed": now.exposure_fixed},
        "camera_gain": {"value": now.gain, "fixed": now.gain_fixed},
    }


class CsvFile:
    """A CSV file that is written row by row: each row is on the disk when add() returns."""

    def __init__(self, path: Path, about: Metadata, signal: Signal) -> None:
        """Raises CannotWrite, also if the file exists."""
        self._path, self._width = path, len(signal.columns)
        self._file = _guarded(path, lambda: path.open("xb", buffering=0))
        self._good = 0  # bytes: whole rows
        head = "".join(f"# {name}: {json.dumps(value)}\n" for name, value in about.items())
        self._write(head + _row([*_OWN, *signal.columns, "missing"]))

    def add(self, sample: Sample) -> None:
        """Write a row; a value that there is not is empty. Raises CannotWrite."""
        values = sample.values or [""] * self._width
        self._write(_row([*(getattr(sample, name) for name in _OWN), *values, sample.missing]))

    def end(self, ended: str) -> None:
        """Write how the scan ended, and close. Raises CannotWrite."""
        try:
            self._write(f"# ended: {json.dumps(ended)}\n")
        finally:
            self._file.close()

    def _write(self, text: str) -> None:
        """Write whole lines; where the disk takes a part of them only, none."""
        rest = memoryview(text.encode())

        def to_disk() -> None:
            nonlocal rest
            try:
                while rest:
                    rest = rest[self._file.write(rest) :]
                os.fsync(self._file.fileno())
            except OSError:
                with contextlib.suppress(OSError):
                    self._file.seek(self._good)
                    self._file.truncate()
                raise
            self._good = self._file.tell()

        _guarded(self._path, to_disk)


def _row(values: Sequence[object]) -> str:
    text = io.StringIO()
    csv.writer(text).writerow(values)
    return text.getvalue()


def check_hdf5(path: Path) -> None:
    """Find out before a scan that its HDF5 file cannot be written. Raises ExtraMissing, CannotWrite."""
    if importlib.util.find_spec("h5py") is None:
        raise ExtraMissing(f"HDF5 needs a package that is not installed (h5py): {install_command('scan')}")
    if os.path.lexists(path):
        raise CannotWrite(f"{path}: exists; a scan is a new file")
    if os.path.lexists(part := _part_of(path)):
        raise CannotWrite(f"{part}: exists; another scan writes {path.name} now, or one was cut off: then move it away")
    if not os.access(path.parent, os.W_OK):
        raise CannotWrite(f"{path}: no such folder, or no right to write in it")


class Hdf5File:
    """An HDF5 file that is written at the end. Until then FILE.part keeps its name and its room on the disk."""

    def __init__(self, path: Path, about: Metadata, signal: Signal, places: int) -> None:
        """places: of the whole scan. Raises ExtraMissing; CannotWrite, also if the file or its part exists."""
        check_hdf5(path)
        self._path, self._part, self._about, self._signal = path, _part_of(path), about, signal
        self._file = _guarded(self._part, lambda: self._part.open("xb"))  # no file and no link is written to
        self._write(lambda: bytes(_ROOM + _ROOM_OF_PLACE * places))

    def end(self, samples: Sequence[Sample], ended: str) -> None:
        """Write the scan; under its name the file is there when it is whole. A value that there is not is NaN.

        Datasets: one for each column, with its unit as the attribute `unit`. Raises CannotWrite; where a file of that
        name was made meanwhile, the scan stays in the part.
        """
        self._write(lambda: self._whole(samples, ended))
        self._file.close()
        try:
            self._path.open("xb").close()  # only a file of our own is replaced; not every disk has hard links
            try:
                os.replace(self._part, self._path)
            except BaseException:
                self._path.unlink(missing_ok=True)
                raise
        except OSError as e:
            raise CannotWrite(f"{self._path}: {e.strerror or e}; the scan is in {self._part}") from e

    def drop(self) -> None:
        """Give up name and room; there is no file then."""
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            self._part.unlink()

    def _whole(self, samples: Sequence[Sample], ended: str) -> bytes:
        import h5py

        names = (*_OWN, "missing")
        columns: dict[str, list[Any]] = {name: [getattr(sample, name) for sample in samples] for name in names}
        for at, name in enumerate(self._signal.columns):
            columns[name] = [sample.values[at] if sample.values else float("nan") for sample in samples]
        whole = io.BytesIO()
        with h5py.File(whole, "w") as file:
            for name, value in {**self._about, "ended": ended}.items():
                file.attrs[name] = json.dumps(value) if isinstance(value, dict) else value
            for name, data in columns.items():
                kind = h5py.string_dtype() if name in _TEXTS else int if name in _WHOLE else float
                file.create_dataset(name, data=data, dtype=kind).attrs["unit"] = self._about["units"].get(name, "")
        return whole.getvalue()

    def _write(self, content: Callable[[], bytes]) -> None:
        """Write content() into the part, in place of what it had. Raises CannotWrite; there is no part then."""

        def to_disk() -> None:
            try:
                self._file.seek(0)
                self._file.write(content())
                self._file.truncate()
                self._file.flush()
                os.fsync(self._file.fileno())
            except BaseException:
                self.drop()
                raise

        _guarded(self._path, to_disk)


def _part_of(path: Path) -> Path:
    return path.with_name(path.name + ".part")


def _guarded(path: Path, act: Callable[[], _T]) -> _T:
    """act(), with an error of the disk as CannotWrite."""
    try:
        return act()
    except FileExistsError as e:
        raise CannotWrite(f"{path}: exists; a scan is a new file") from e
    except OSError as e:
        raise CannotWrite(f"{path}: {e.strerror or e}") from e
