"""Files as cameras: pictures, stacks of them, videos, and recordings. Each image once, in the time of the file.

A recording is a folder. frames.jsonl has a line of JSON for each image: file, time_s, number, repeated, late.
camera.json has the camera's name, width, height and Controls. The pictures are PNG, 8 or 16 bits, lossless.
"""

import functools
import itertools
import json
import logging
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount import files
from mirrormount.errors import CannotWrite
from mirrormount.terminal import printable
from mirrormount_beam.camera import (
    Camera,
    Controls,
    Dark,
    Image,
    Limits,
    Picture,
    Size,
    checked,
    in_one_channel,
    to_grey,
)
from mirrormount_beam.errors import CameraAbsent, CameraError, CameraSizeChanged
from mirrormount_beam.selection import WHOLE
from mirrormount_beam.webcams import quiet

_LIST, _ABOUT = "frames.jsonl", "camera.json"
_IMAGES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"})
_KINDS = (_IMAGES, frozenset({".npy"}), frozenset({".csv"}))  # a folder has pictures of one kind: the first it has
_ALL = frozenset().union(*_KINDS)
_OF_SYSTEM = {"thumbs.db", "desktop.ini"}
_NAMED = 5  # files that a warning names
_PERIOD_S = 1 / 30  # between pictures that have no times
_WHOLE = 0.98  # part of a video's frames: some files tell their number from the duration
_NO_LIMITS = Limits(sys.maxsize, 1e-9, True)

_log = logging.getLogger("mirrormount_beam")


def open_file(path: str) -> "Folder":
    """A recording, a folder of pictures, one picture or a stack of them, or a video. Raises CameraError."""
    place = Path(path)
    if place.is_dir():
        return open_folder(path)
    return Folder(place.name, [place]) if place.suffix.lower() in _ALL else Video(place)


def open_folder(path: str) -> "Folder":
    """A recording or a folder of pictures. Raises CameraAbsent, CameraError."""
    folder = Path(path)
    if not folder.is_dir():
        raise CameraAbsent(f"{path}: no such folder")
    if (folder / _LIST).is_file():
        return Recording(folder)
    there = sorted((file for file in folder.iterdir() if file.is_file()), key=_by_number)
    kind = next((kind for kind in _KINDS if any(file.suffix.lower() in kind for file in there)), frozenset())
    pictures = [file for file in there if file.suffix.lower() in kind]
    if not pictures:
        raise CameraAbsent(f"{folder}: no pictures in it ({', '.join(sorted(_ALL))})")
    others = [file.name for file in there if file not in set(pictures)]
    _warn(folder, tuple(name for name in others if not name.startswith(".") and name.lower() not in _OF_SYSTEM))
    return Folder(folder.name, pictures)


def _by_number(file: Path) -> list[Any]:
    """The order of names as a person counts: frame2 comes before frame10."""
    parts = re.split("([0-9]+)", file.name.lower())
    return [int(part) if at % 2 else part for at, part in enumerate(parts)]


@functools.cache  # a page opens its camera again and again
def _warn(folder: Path, others: tuple[str, ...]) -> None:
    if others:
        named = ", ".join(others[:_NAMED]) + (f" and {len(others) - _NAMED} more" if others[_NAMED:] else "")
        _log.warning("%s: left out, for they are no pictures of this folder: %s", folder, printable(named, 1000))


class Folder:
    """A Camera: pictures of files in their order, 30 in a second of their own clock. A stack has a picture a page."""

    controls = Controls(None, None)

    def __init__(self, name: str, pictures: list[Path]) -> None:
        self.name = name
        self.selection = WHOLE
        self._files = pictures
        self._now_s = 0.0
        self.size = self._first_size()

    def _first_size(self) -> Size:
        rows, columns = to_grey(next(self._pictures()).image).shape
        return Size(columns, rows)

    def frames(self) -> Iterator[Image]:
        """Each picture once. Raises CameraError."""
        for frame in checked(self._pictures(), self.name, self.size, _NO_LIMITS, selection=self.selection):
            self._now_s = frame.time_s
            yield frame

    def _pictures(self) -> Iterator[Picture]:
        pictures = (picture for file in self._files for picture in _named(file))
        return (Picture(image, at * _PERIOD_S, name) for at, (image, name) in enumerate(pictures))

    def monotonic(self) -> float:
        """The time of the image that was returned last."""
        return self._now_s

    def close(self) -> None:
        """No effect: nothing is open."""


class Video(Folder):
    """A Camera: each frame of a video file, with its time in the video."""

    def __init__(self, file: Path) -> None:
        super().__init__(file.name, [file])

    def _pictures(self) -> Iterator[Picture]:
        (file,) = self._files
        with quiet():
            capture = cv2.VideoCapture(str(file))
        try:
            rate_hz = capture.get(cv2.CAP_PROP_FPS)
            period_s = 1 / rate_hz if 0.001 < rate_hz < 1e6 else _PERIOD_S
            time_s = -period_s
            expected, count = capture.get(cv2.CAP_PROP_FRAME_COUNT), 0
            good, image = capture.read()
            if not good:
                raise CameraError(f"{file}: no video, and no picture, that OpenCV can read")
            while good:
                count += 1
                told_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000  # 0 or nothing of a video that has no times
                time_s = told_s if told_s > time_s else time_s + period_s
                yield Picture(image, time_s, f"{file.name} at {time_s:.3f} s")
                good, image = capture.read()
            if count < _WHOLE * expected:
                _log.warning("%s: damaged: it ends after %d of %d frames", file, count, expected)
        finally:
            capture.release()


class Recording(Folder):
    """A Camera: what another one recorded, with its times and marks, as fast as it is read."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.selection = WHOLE
        self._now_s = 0.0
        try:
            about = files.read_json(folder / _ABOUT)
            self.name = str(about["name"])
            self.size = Size(int(about["width"]), int(about["height"]))
            fixed = about.get("exposure_fixed"), about.get("gain_fixed")
            self.controls = Controls(*fixed, about.get("exposure"), about.get("exposure_unit"), about.get("gain"))
        except (OSError, ValueError, KeyError, TypeError, OverflowError) as e:
            raise CameraError(f"{folder / _ABOUT}: not the head of a recording: {e}") from e

    def frames(self) -> Iterator[Image]:
        """The recorded frames. Raises CameraError at a line or a picture that cannot be read."""
        number = 0
        with (self._folder / _LIST).open("rb") as lines:  # a line that is no text is that line's error
            for number, line in enumerate(lines, 1):
                try:
                    one = files.parse_json(line)
                    name, time_s = str(one["file"]), float(one["time_s"])
                    count, repeated, late = int(one["number"]), bool(one["repeated"]), bool(one["late"])
                except (ValueError, KeyError, TypeError, OverflowError) as e:
                    raise CameraError(f"{self._folder / _LIST}, line {number}: {e}") from e
                if Path(name).name != name:
                    raise CameraError(f"{self._folder / _LIST}, line {number}: {name[:80]!r} is no file's name")
                picture = next(read_pictures(self._folder / name))
                image, colour = in_one_channel(picture, self.selection)  # it is grey, unless somebody has changed it
                if image.shape != (self.size.height, self.size.width):
                    raise CameraSizeChanged(f"{self.name}: {name} has not {self.size} pixels")
                image.flags.writeable = False
                self._now_s = time_s
                yield Image(image, time_s, count, repeated, late, self.selection, colour, name)
        if not number:
            raise CameraError(f"{self._folder / _LIST}: no frame was recorded")


# ---- pictures of a file


def read_pictures(file: Path) -> Iterator[NDArray[Any]]:
    """The pictures of a file, one or a stack, of 8 or 16 bits, colours as BGR. Raises CameraError."""
    return (_in_16_bits(picture, file) for picture in _read(file))


def _named(file: Path) -> Iterator[tuple[NDArray[Any], str]]:
    """The pictures of a file, each with a name for people: one of several has its page in it."""
    pictures = read_pictures(file)
    first, second = next(pictures, None), next(pictures, None)
    if first is not None:
        yield first, file.name if second is None else f"{file.name} page 1"
    rest = () if second is None else itertools.chain([second], pictures)
    yield from ((picture, f"{file.name} page {page}") for page, picture in enumerate(rest, 2))


def _read(file: Path) -> Iterator[NDArray[Any]]:
    suffix = file.suffix.lower()
    read = _of_numpy if suffix == ".npy" else _of_table if suffix == ".csv" else _of_opencv
    try:
        return read(file)
    except OSError as e:
        raise CameraError(f"{file}: {e.strerror or e}") from e


def read_dark(file: Path) -> Dark:
    """The hot pixels of a picture without the beam, or of the mean of a stack of them. Raises CameraError."""
    return Dark.of(np.stack([to_grey(picture) for picture in read_pictures(file)]))


def read_mask(file: Path) -> NDArray[np.bool_]:
    """What a picture hides: where it is brighter than half of its brightest pixel. Raises CameraError."""
    if file.suffix.lower() not in _ALL:
        raise CameraError(f"{file}: a mask is a picture ({', '.join(sorted(_ALL))})")
    picture = next(_read(file))
    grey = picture if picture.ndim == 2 else picture[:, :, :3].max(axis=2)
    return np.asarray(grey > grey.max() / 2)


def _of_opencv(file: Path) -> Iterator[NDArray[Any]]:
    data = np.frombuffer(file.read_bytes(), np.uint8)
    stack = file.suffix.lower() in (".tif", ".tiff")
    pictures: Any = ()
    try:
        with quiet():
            if stack:
                _, pictures = cv2.imdecodemulti(data, cv2.IMREAD_UNCHANGED)
            else:
                image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
                pictures = () if image is None else (image,)
    except cv2.error:
        pass
    if not len(pictures):
        raise CameraError(
            f"{file}: OpenCV cannot read this TIFF: it has 32 bits without sign, a rare compression, or is damaged."
            " Save it with 16 bits, or as .npy"
            if stack
            else f"{file}: it is no picture, or damaged: remove it"
        )
    return iter(pictures)


def _of_numpy(file: Path) -> Iterator[NDArray[Any]]:
    """Of shape (rows, columns), or with colours at the end (3 or 4), or with pictures at the front."""
    try:
        array = np.load(file, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError) as e:
        raise CameraError(f"{file}: it is no array of NumPy: {e}") from e
    if not isinstance(array, np.ndarray):
        raise CameraError(f"{file}: it is no array of NumPy")
    axes = array.ndim - (array.ndim > 2 and array.shape[-1] in (3, 4))
    if axes not in (2, 3):
        raise CameraError(f"{file}: an array of shape {array.shape} is no picture (rows, columns) and no stack of them")
    return iter(array[np.newaxis] if axes == 2 else array)


def _of_table(file: Path) -> Iterator[NDArray[Any]]:
    """Numbers with a comma, a semicolon or a space between them; a line of the file is a row of the picture."""
    try:
        lines = file.read_text("utf-8-sig").splitlines()
        comma = next((mark for mark in ";\t," if lines and mark in lines[0]), None)
        rows = [row for line in lines if (row := line.strip().rstrip(comma or " "))]
        if not rows:
            raise ValueError("it is empty")
        return iter([np.loadtxt(rows, delimiter=comma, ndmin=2)])
    except ValueError as e:
        raise CameraError(f"{file}: it is no table of numbers: {e}") from e


def _in_16_bits(image: NDArray[Any], file: Path) -> NDArray[Any]:
    """Grey values as they are, or rounded to whole numbers of 16 bits. Raises CameraError."""
    if image.dtype.newbyteorder("=") in (np.uint8, np.uint16):
        return image
    if image.dtype.kind not in "iuf" or not image.size:
        raise CameraError(f"{file}: {image.dtype} of shape {image.shape} is no picture: its grey values are numbers")
    low, high = image.min(), image.max()
    is_whole = image.dtype.kind != "f" or high > 1 or bool((image == np.rint(image)).all())
    if not (low >= 0 and high <= 0xFFFF and is_whole):  # of nan, too
        raise CameraError(
            f"{file}: its grey values are {image.dtype}, {low:g} … {high:g}; a picture has whole numbers, 0 … 65535:"
            " shift and scale all pictures in the same way, and save them with 16 bits"
        )
    return np.rint(image).astype(np.uint16)


# ---- writing


def record(camera: Camera, folder: Path, frames: Iterator[Image]) -> int:
    """Write images into a new folder; how many. What was written stays if the camera fails. Raises CannotWrite."""
    count = 0
    try:
        folder.mkdir(parents=True)
        width, height = camera.size
        about = {"name": camera.name, "width": width, "height": height, **camera.controls._asdict()}
        (folder / _ABOUT).write_text(json.dumps(about) + "\n", "utf-8")
        with (folder / _LIST).open("x", encoding="utf-8", buffering=1) as lines:
            for frame in frames:
                name = f"{count:06d}.png"
                good, data = cv2.imencode(".png", frame.image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
                if not good:
                    raise CannotWrite(f"{folder / name}: the picture cannot be encoded")
                (folder / name).write_bytes(data.tobytes())
                about = {"file": name, "time_s": frame.time_s, "number": frame.number}
                marks = {"repeated": bool(frame.repeated), "late": bool(frame.late)}
                lines.write(json.dumps({**about, **marks}) + "\n")
                count += 1
    except FileExistsError as e:
        raise CannotWrite(f"{folder}: exists; a recording is a new folder") from e
    except OSError as e:
        raise CannotWrite(f"{e.filename or folder}: {e.strerror}") from e
    return count
