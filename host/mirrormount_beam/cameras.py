"""Cameras by their addresses: webcams, folders of pictures, recordings, and those of a virtual table.

A webcam is opened through OpenCV's VideoCapture, by index, device or name.

A recording is a folder. frames.jsonl has a line of JSON for each image: file, time_s, number, repeated, late.
camera.json has the camera's name, width, height and Controls. The pictures are PNG, 8 bit, lossless.
"""

import contextlib
import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount import files
from mirrormount.device import table_file
from mirrormount.errors import BadAddress, CannotWrite
from mirrormount.terminal import printable
from mirrormount.transport.ports import TABLE_SCHEMES, open_table
from mirrormount.values import is_name
from mirrormount_beam.camera import (
    OF_DRIVER,
    Camera,
    Controls,
    Image,
    Limits,
    Picture,
    Size,
    as_bytes,
    checked,
    to_grey,
)
from mirrormount_beam.errors import CameraAbsent, CameraError, CameraGone, CameraSizeChanged
from mirrormount_beam.scale import Scale

# ---- webcams

SYSFS = Path("/sys/class/video4linux")
_TRIED = 6  # indices that are tried where the system does not list cameras
_INDEX_DIGITS = 9  # of an index: OpenCV takes a C int
_SILENT_S = 5.0  # without an image for so long, the camera is gone


class Capture(Protocol):
    """The part of cv2.VideoCapture that is used."""

    def isOpened(self) -> bool: ...

    def read(self) -> tuple[bool, Any]: ...

    def get(self, propId: int) -> float: ...

    def set(self, propId: int, value: float) -> bool: ...

    def release(self) -> None: ...


class Device(NamedTuple):
    """A camera of this computer: its number for OpenCV, and its name."""

    number: int
    name: str


def listed() -> list[Device] | None:
    """The cameras that Linux lists, capture devices only; None where the system has no such list."""
    if not sys.platform.startswith("linux"):
        return None
    found = []
    for folder in sorted(SYSFS.glob("video*"), key=lambda path: int(path.name[5:] or 0)):
        with contextlib.suppress(OSError, ValueError):
            if (folder / "index").read_text().strip() == "0":  # the others are metadata of the same camera
                found.append(Device(int(folder.name[5:]), (folder / "name").read_text().strip()))
    return found


def tried() -> list[Device]:
    """The first indices that OpenCV can open; each camera is switched on for a moment."""
    found = []
    for index in range(_TRIED):
        capture = _capture(index)
        if capture.isOpened():
            found.append(Device(index, f"camera {index}"))
        capture.release()
    return found


def open_webcam(which: str, *, limits: Limits = Limits()) -> "Webcam":  # noqa: B008
    """The webcam of an index ("0"), a device or video file, or a part of a name. Raises CameraAbsent."""
    if which.isascii() and which.isdigit() and len(which) <= _INDEX_DIGITS:
        return Webcam(_capture(int(which)), _name(int(which)), limits)
    if os.path.exists(which):
        return Webcam(_capture(which), which, limits)
    matching = [device for device in listed() or [] if which.lower() in device.name.lower()]
    if len(matching) != 1:
        known = ", ".join(f"{device.number} {device.name}" for device in listed() or []) or "none"
        number = "several cameras" if matching else "no camera"
        raise CameraAbsent(f"{number} of the name {which[:80]!r}; there is: {known}")
    return Webcam(_capture(matching[0].number), matching[0].name, limits)


def _name(index: int) -> str:
    return next((device.name for device in listed() or [] if device.number == index), f"camera {index}")


def _capture(source: int | str) -> cv2.VideoCapture:
    with _quiet():
        return cv2.VideoCapture(source)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without the warnings that OpenCV prints about a camera that is not there."""
    level = cv2.utils.logging.getLogLevel() if hasattr(cv2, "utils") else None
    try:
        if level is not None:
            cv2.utils.logging.setLogLevel(0)
        yield
    finally:
        if level is not None:
            cv2.utils.logging.setLogLevel(level)


class Webcam:
    """A Camera. A thread reads all images and keeps the newest one, so that an image is fresh when it is returned."""

    def __init__(self, capture: Capture, name: str, limits: Limits = Limits(), *, silent_s: float = _SILENT_S) -> None:  # noqa: B008
        if not capture.isOpened():
            capture.release()
            raise CameraAbsent(
                f"{name}: cannot be opened: `mirrormount camera list` lists cameras; with --virtual none is needed"
            )
        self.name = name
        self._capture = capture
        self._limits = limits
        self._silent_s = silent_s
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self.controls = _controls(capture)
        self.size = Size(int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        self._ready = threading.Condition()
        self._newest: Picture | None = None
        self._read = self._taken = 0
        self._ended = self._closed = False
        self._thread = threading.Thread(target=self._drain, name=f"camera {name}", daemon=True)
        self._thread.start()

    def _drain(self) -> None:
        """Read until the camera ends or close(); only this thread uses the capture, and it releases it."""
        while not self._closed:
            good, image = self._capture.read()
            with self._ready:
                if good and image is not None:
                    self._newest = Picture(image, time.monotonic())
                    self._read += 1
                else:
                    self._ended = True
                self._ready.notify_all()
                if self._ended:
                    break
        self._capture.release()

    def frames(self) -> Iterator[Image]:
        """Fresh images; numbers count all that the camera returned. Raises CameraError."""
        numbers = iter(lambda: self._taken - 1, None)
        return checked(self._pictures(), self.name, self.size, self._limits, numbers=numbers)

    def _pictures(self) -> Iterator[Picture]:
        while True:
            with self._ready:
                fresh = self._ready.wait_for(lambda: self._read > self._taken or self._ended, self._silent_s)
                if self._read == self._taken:
                    why = "it has ended or was unplugged" if fresh else f"no frame for {self._silent_s:g} s"
                    raise CameraGone(f"{self.name}: {why}, after {self._read} frames")
                self._taken = self._read
                picture = self._newest
            assert picture is not None
            yield picture

    def monotonic(self) -> float:
        """time.monotonic."""
        return time.monotonic()

    def close(self) -> None:
        """Release the device."""
        self._closed = True
        self._thread.join(self._silent_s)


def _controls(capture: Capture) -> Controls:
    """Exposure and gain, fixed where the camera can, and their numbers where OpenCV knows them."""
    exposure_fixed, gain_fixed = _fix(capture, cv2.CAP_PROP_AUTO_EXPOSURE, (1, 0.25)), _fix_gain(capture)
    exposure, gain = capture.get(cv2.CAP_PROP_EXPOSURE), capture.get(cv2.CAP_PROP_GAIN)
    told = math.isfinite(exposure) and exposure not in (-1, 0)  # what OpenCV returns where it does not know
    set_or_above_0 = math.isfinite(gain) and (gain > 0 or gain_fixed is True)
    return Controls(
        exposure_fixed,
        gain_fixed,
        exposure if told else None,
        OF_DRIVER if told else None,
        gain if set_or_above_0 else None,
    )


def _fix(capture: Capture, automatic: int, manual: tuple[float, ...]) -> bool | None:
    """Whether an automatic control could be switched off: V4L2 calls manual 1, other systems 0.25. None: not told."""
    before = capture.get(automatic)
    for value in manual:
        if capture.set(automatic, value) and capture.get(automatic) == value:
            return True
    return None if before in (-1, 0) else False


def _fix_gain(capture: Capture) -> bool | None:
    """Whether the gain stays when it is set to its own value."""
    gain = capture.get(cv2.CAP_PROP_GAIN)
    if gain < 0:
        return None
    return True if capture.set(cv2.CAP_PROP_GAIN, gain) and capture.get(cv2.CAP_PROP_GAIN) == gain else None


# ---- folders and recordings

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

    def frames(self) -> Iterator[Image]:
        """Each picture once. Raises CameraError."""
        for frame in checked(self._pictures(), self.name, self.size, Limits(len(self._files) + 1, 0.001, True)):
            self._now_s = frame.time_s
            yield frame

    def _pictures(self) -> Iterator[Picture]:
        return (Picture(read_picture(file), at * _PERIOD_S) for at, file in enumerate(self._files))

    def monotonic(self) -> float:
        """The time of the image that was returned last."""
        return self._now_s

    def close(self) -> None:
        """No effect: nothing is open."""


class Recording(Folder):
    """A Camera: what another one recorded, with its times and marks, as fast as it is read."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
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
                image = as_bytes(to_grey(read_picture(self._folder / name)))
                if image.shape != (self.size.height, self.size.width):
                    raise CameraSizeChanged(f"{self.name}: {name} has not {self.size} pixels")
                image.flags.writeable = False
                self._now_s = time_s
                yield Image(image, time_s, count, repeated=repeated, late=late)
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


# ---- addresses


def open_camera(address: str, *, limits: Limits = Limits()) -> Camera:  # noqa: B008
    """Open a camera.

    address: an index ("0"), a device (/dev/video0), a part of a webcam's name, a folder, or virtual-table://…, with #2
    for the second camera of the table; or a camera's name in table.toml. limits: of a webcam. Raises BadAddress,
    BadFile, CameraError, CannotOpen.
    """
    address = _known(address)
    if _is_of_table(address):
        return _of_table(address)
    if os.path.isdir(address):
        return open_folder(address)
    return open_webcam(address, limits=limits)


def open_beside_mount(address: str) -> Camera:
    """As open_camera(), for a mount opened by itself. Raises BadAddress for a camera of a virtual table, too."""
    if _is_of_table(_known(address)):
        raise BadAddress(
            f"{printable(address)} sees the mounts of its own table only: give --virtual, and 1 or 2 as the camera"
        )
    return open_camera(address)


def _known(address: str) -> str:
    """The address that a name in table.toml stands for. Raises BadAddress, BadFile."""
    if not address.strip():
        raise BadAddress("the camera's name is empty: leave it out, or give one (see: mirrormount camera list)")
    entry = table_file.read().cameras.get(address) if is_name(address) else None
    return entry.camera if entry else address


def _is_of_table(address: str) -> bool:
    return address.partition("://")[0] in TABLE_SCHEMES


def _of_table(address: str) -> Camera:
    table_address, _, number = address.partition("#")
    table = open_table(table_address)
    try:
        if number and not (number.isascii() and number.isdigit() and len(number) < 10):
            raise BadAddress(f"after # comes the camera's number, 1 to {len(table.cameras)}, not {number[:20]!r}")
        at = int(number or 1)
        if not 1 <= at <= len(table.cameras):
            raise CameraAbsent(f"{table_address}: it has {len(table.cameras)} cameras, no number {at}")
        return _Owned(table.cameras[at - 1], table.close)
    except BaseException:
        table.close()
        raise


class _Owned:
    """A camera that is closed with all that was opened for it."""

    def __init__(self, camera: Camera, close: Callable[[], None]) -> None:
        self._camera = camera
        self._close_owner = close

    @property
    def name(self) -> str:
        return self._camera.name

    @property
    def size(self) -> Size:
        return self._camera.size

    @property
    def controls(self) -> Controls:
        return self._camera.controls

    @property
    def scale(self) -> Scale | None:
        return getattr(self._camera, "scale", None)

    def frames(self) -> Iterator[Image]:
        return self._camera.frames()

    def monotonic(self) -> float:
        return self._camera.monotonic()

    def close(self) -> None:
        self._camera.close()
        self._close_owner()
