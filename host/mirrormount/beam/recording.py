"""Pictures on the disk as a camera: a folder of pictures, or a recording; and the writer of a recording.

A recording is a folder. frames.jsonl has a line of JSON for each frame: file, time_s, number, repeated, late.
camera.json has the camera's name, width, height and Controls. The pictures are PNG, 8 bit, lossless.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount.beam.camera import Camera, Controls, Frame, Size
from mirrormount.beam.checked import Limits, Picture, as_bytes, checked
from mirrormount.beam.picture import to_grey
from mirrormount.common import json_text
from mirrormount.common.beam_errors import CameraAbsent, CameraError, CameraSizeChanged
from mirrormount.common.errors import CannotWrite

_LIST, _ABOUT = "frames.jsonl", "camera.json"
_PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}
_PERIOD_S = 1 / 30  # between the pictures of a folder, which have no times


def open_folder(path: str) -> "Folder":
    """A recording or a folder of pictures. Raises CameraAbsent, CameraError."""
    folder = Path(path)
    if not folder.is_dir():
        raise CameraAbsent(f"{path}: no such folder")
    return Recording(folder) if (folder / _LIST).is_file() else Folder(folder)


class Folder:
    """A Camera: the pictures of a folder in the order of their names, 30 in a second of their own clock."""

    controls = Controls(None, None)

    def __init__(self, folder: Path) -> None:
        self.name = folder.name
        self._files = sorted(file for file in folder.iterdir() if file.suffix.lower() in _PICTURES)
        if not self._files:
            raise CameraAbsent(f"{folder}: no pictures in it ({', '.join(sorted(_PICTURES))})")
        first = to_grey(read_picture(self._files[0]))
        self.size = Size(first.shape[1], first.shape[0])
        self._now_s = 0.0

    def frames(self) -> Iterator[Frame]:
        """Each picture once. Raises CameraError."""
        for frame in checked(self._pictures(), self.name, self.size, Limits(len(self._files) + 1, 0.001, True)):
            self._now_s = frame.time_s
            yield frame

    def _pictures(self) -> Iterator[Picture]:
        return (Picture(read_picture(file), at * _PERIOD_S) for at, file in enumerate(self._files))

    def monotonic(self) -> float:
        """The time of the frame that was returned last."""
        return self._now_s

    def close(self) -> None:
        """No effect: nothing is open."""


class Recording(Folder):
    """A Camera: what another one recorded, with its times and marks, as fast as it is read."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._now_s = 0.0
        try:
            about = json_text.read(folder / _ABOUT)
            self.name = str(about["name"])
            self.size = Size(int(about["width"]), int(about["height"]))
            fixed = about.get("exposure_fixed"), about.get("gain_fixed")
            self.controls = Controls(*fixed, about.get("exposure"), about.get("exposure_unit"), about.get("gain"))
        except (OSError, ValueError, KeyError, TypeError, OverflowError) as e:
            raise CameraError(f"{folder / _ABOUT}: not the head of a recording: {e}") from e

    def frames(self) -> Iterator[Frame]:
        """The recorded frames. Raises CameraError at a line or a picture that cannot be read."""
        number = 0
        with (self._folder / _LIST).open("rb") as lines:  # a line that is no text is that line's error
            for number, line in enumerate(lines, 1):
                try:
                    one = json_text.loads(line)
                    name, time_s = str(one["file"]), float(one["time_s"])
                    count, repeated, late = int(one["number"]), bool(one["repeated"]), bool(one["late"])
                except (ValueError, KeyError, TypeError, OverflowError) as e:
                    raise CameraError(f"{self._folder / _LIST}, line {number}: {e}") from e
                if Path(name).name != name:
                    raise CameraError(f"{self._folder / _LIST}, line {number}: {name[:80]!r} is no file's name")
                image = as_bytes(to_grey(read_picture(self._folder / name)))
                if image.shape != (self.size.height, self.size.width):
                    raise CameraSizeChanged(f"{self.name}: {name} has not {self.size} pixels")
                image.flags.writeable = False
                self._now_s = time_s
                yield Frame(image, time_s, count, repeated=repeated, late=late)
        if not number:
            raise CameraError(f"{self._folder / _LIST}: no frame was recorded")


def read_picture(file: Path) -> NDArray[Any]:
    """A picture as it is, colours as BGR. Raises CameraError."""
    try:
        image = cv2.imdecode(np.frombuffer(file.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, cv2.error) as e:
        raise CameraError(f"{file}: {getattr(e, 'strerror', None) or 'no picture'}") from e
    if image is None:
        raise CameraError(f"{file}: it is no picture, or damaged: remove it")
    return image


def record(camera: Camera, folder: Path, frames: Iterator[Frame]) -> int:
    """Write frames into a new folder; how many. What was written stays if the camera fails. Raises CannotWrite."""
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
