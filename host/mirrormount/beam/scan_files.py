"""The files of a scan: CSV, row by row, and HDF5, whole. Imports scan, errors; h5py for HDF5 alone.

Both have the same metadata: lines `# name: JSON` at the head of a CSV file, attributes of the HDF5 file. A CSV file
ends with the line `# ended: …`; without it the writing program was cut off, and all rows above are good.
"""

import contextlib
import csv
import importlib.util
import io
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from mirrormount.beam.camera import Camera
from mirrormount.beam.patterns import Pattern
from mirrormount.beam.scan import Sample, Signal
from mirrormount.common.errors import CannotWrite, ExtraMissing
from mirrormount.common.extras import install
from mirrormount.device.mount import Mount
from mountfw import __version__

if TYPE_CHECKING:
    from mirrormount.beam.scale import Scale

_T = TypeVar("_T")
COMPLETE = "complete"
UNKNOWN = "not known"
_UNITS = {"time_s": "s", "x": "steps", "y": "steps", "position_x": "steps", "position_y": "steps"}
_OWN = tuple(field.name for field in fields(Sample) if field.name not in ("values", "missing"))
_WHOLE = ("number", "x", "y")
_TEXTS = ("certainty_x", "certainty_y", "missing")
_ROOM, _ROOM_OF_PLACE = 1 << 16, 320  # bytes of an HDF5 file: without places, and of one; both were measured
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
    """What is known of a camera; what is not known is null, a whole scale UNKNOWN."""
    now = camera.controls
    return {
        "camera": camera.name,
        "camera_size": str(camera.size),
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
        raise ExtraMissing(f"HDF5 needs a package that is not installed (h5py): {install('scan')}")
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
