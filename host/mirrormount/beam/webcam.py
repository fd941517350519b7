"""A webcam through OpenCV's VideoCapture, by index, device or name, and the webcams that there are."""

import contextlib
import math
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import cv2

from mirrormount.beam.camera import OF_DRIVER, Controls, Frame, Size
from mirrormount.beam.checked import Limits, Picture, checked
from mirrormount.common.beam_errors import CameraAbsent, CameraGone

SYSFS = Path("/sys/class/video4linux")
_TRIED = 6  # indices that are tried where the system does not list cameras
_INDEX_DIGITS = 9  # of an index: OpenCV takes a C int
_SILENT_S = 5.0  # without a frame for so long, the camera is gone


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
    """A Camera. A thread reads all frames and keeps the newest one, so that a frame is fresh when it is returned."""

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

    def frames(self) -> Iterator[Frame]:
        """Fresh frames; numbers count all that the camera returned. Raises CameraError."""
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
