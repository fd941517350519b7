"""Webcams and cameras of the network, through OpenCV's VideoCapture: by index, device, place, name or address."""

import contextlib
import math
import os
import re
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import cv2

from mirrormount.device import table_file
from mirrormount.device.table_file import CameraSettings
from mirrormount.terminal import NETWORK, printable, without_credentials
from mirrormount.transport.ports import TABLE_SCHEMES
from mirrormount.values import did_you_mean, is_name
from mirrormount_beam.camera import OF_DRIVER, Controls, Image, Limits, Picture, Size, checked
from mirrormount_beam.errors import CameraAbsent, CameraGone, CameraSettingRefused
from mirrormount_beam.selection import WHOLE

# ---- which cameras there are

SYSFS = Path("/sys/class/video4linux")
PLACES = Path("/dev/v4l")  # of links whose names tell the socket (by-path) and the maker and serial number (by-id)
_TRIED = 6  # indices that are tried where the system does not list cameras
_INDEX_DIGITS = 9  # of an index: OpenCV takes a C int


class Device(NamedTuple):
    """A camera of this computer: its number for OpenCV, its name, and paths that tell it from others of the name."""

    number: int
    name: str
    paths: tuple[str, ...] = ()

    def has_name(self, part: str) -> bool:
        """True if that is a part of its name, or of one of its paths."""
        return any(part.lower() in text.lower() for text in (self.name, *self.paths))

    def __str__(self) -> str:
        return "  ".join([f"{self.number}  {printable(self.name)}", *map(printable, self.paths)])


def listed() -> list[Device] | None:
    """The cameras that Linux lists, capture devices only; None where the system has no such list."""
    if not sys.platform.startswith("linux"):
        return None
    paths: dict[str, list[str]] = {}
    for path in sorted(PLACES.glob("by-path/*")) + sorted(PLACES.glob("by-id/*")):
        paths.setdefault(os.path.basename(os.path.realpath(path)), []).append(str(path))
    found = []
    for folder in sorted(SYSFS.glob("video*"), key=lambda path: int(path.name[5:] or 0)):
        with contextlib.suppress(OSError, ValueError):
            if (folder / "index").read_text().strip() == "0":  # the others are metadata of the same camera
                name = (folder / "name").read_text().strip()
                found.append(Device(int(folder.name[5:]), name, tuple(paths.get(folder.name, ()))))
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


def open_webcam(
    which: str,
    *,
    limits: Limits = Limits(),  # noqa: B008
    settings: CameraSettings = CameraSettings(),  # noqa: B008
) -> "Webcam":
    """The webcam of an index ("0"), a device, a part of a name or a path; or a camera of the network.

    Raises CameraAbsent, CameraSettingRefused.
    """
    if which.partition("://")[0].lower() in NETWORK:
        return Webcam(_stream(which), without_credentials(which), limits, settings)
    if which.isascii() and which.isdigit() and len(which) <= _INDEX_DIGITS:
        number = int(which)
        name = next((device.name for device in listed() or [] if device.number == number), f"camera {number}")
        return Webcam(_capture(number, settings.backend), name, limits, settings)
    if os.path.exists(which) and PLACES not in Path(which).parents:
        return Webcam(_capture(which, settings.backend), which, limits, settings)
    devices = listed() or []
    matching = [device for device in devices if device.has_name(which)]
    if len(matching) != 1:
        number = "several cameras" if matching else "no camera, file or folder"
        known = ", ".join(f"{device.number} {device.name}" for device in devices) or "none"
        paths = ", ".join(path for device in matching for path in device.paths[:1])
        told = f"; these tell them apart: {paths}" if paths else _meant(which)
        raise CameraAbsent(
            printable(f"{number} of the name {without_credentials(which)[:80]!r}; there is: {known}{told}", 1000)
        )
    device = matching[0]
    # a camera that was named by its place keeps a scale of its own, apart from others of its name
    place = next((os.path.basename(path) for path in device.paths if which.lower() in path.lower()), None)
    name = device.name if which.lower() in device.name.lower() or not place else f"{device.name} ({place})"
    return Webcam(_capture(device.number, settings.backend), name, limits, settings)


def _meant(which: str) -> str:
    """Of a name that is nearly one of the table's, or an address that begins nearly right: did_you_mean()."""
    scheme, mark, _ = which.partition("://")
    if mark:
        return did_you_mean(scheme, (*NETWORK, *TABLE_SCHEMES))
    return did_you_mean(which, table_file.read().cameras) if is_name(which) else ""


# ---- OpenCV

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # FFmpeg is silent: it prints lines of its own, with addresses
_BACKENDS = {"any": cv2.CAP_ANY, "dshow": cv2.CAP_DSHOW, "msmf": cv2.CAP_MSMF, "v4l2": cv2.CAP_V4L2}
_OF_SYSTEM = {"win32": "dshow", "linux": "v4l2"}  # MSMF may take 12 s for the first frame, and hides its exposure
_DEVICE = re.compile("/dev/video[0-9]+")  # any other file is a pipe
FIRST_S, _SILENT_S = 20.0, 5.0  # without a first, without a further image for so long, the camera is gone


class Capture(Protocol):
    """The part of cv2.VideoCapture that is used."""

    def isOpened(self) -> bool: ...

    def getBackendName(self) -> str: ...

    def read(self) -> tuple[bool, Any]: ...

    def get(self, propId: int) -> float: ...

    def set(self, propId: int, value: float) -> bool: ...

    def release(self) -> None: ...


def _capture(source: int | str, backend: str | None = None) -> Capture:
    is_device = isinstance(source, int) or _DEVICE.fullmatch(source)
    usual = _OF_SYSTEM.get(sys.platform, "any") if is_device else "any"
    with quiet():
        return cv2.VideoCapture(source, _BACKENDS[backend or usual])


def _stream(address: str) -> Capture:
    """A camera of the network; FFmpeg waits no longer than a Webcam."""
    waits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, FIRST_S, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _SILENT_S]
    with quiet():
        return cv2.VideoCapture(address, cv2.CAP_FFMPEG, [int(n * 1000) if isinstance(n, float) else n for n in waits])


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Without the warnings that OpenCV prints about a camera or a file that it cannot open."""
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

    def __init__(
        self,
        capture: Capture,
        name: str,
        limits: Limits = Limits(),  # noqa: B008
        settings: CameraSettings = CameraSettings(),  # noqa: B008
        *,
        first_s: float = FIRST_S,
        silent_s: float = _SILENT_S,
    ) -> None:
        if not capture.isOpened():
            capture.release()
            looks = "a browser shows whether there is a picture, and whether user and password are right"
            if name.partition("://")[0].lower() not in NETWORK:
                looks = "`mirrormount camera list` lists cameras; with --virtual none is needed"
            raise CameraAbsent(f"{name}: cannot be opened: {looks}")
        self.name = name
        self.selection = WHOLE
        self._capture = capture
        self._limits = limits
        self._first_s, self._silent_s = first_s, silent_s
        try:
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
            self.controls = _set(capture, name, settings)
        except BaseException:
            capture.release()
            raise
        self.size = _size(capture)
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
        return checked(self._pictures(), self.name, self.size, self._limits, numbers=numbers, selection=self.selection)

    def _pictures(self) -> Iterator[Picture]:
        while True:
            with self._ready:
                patience_s = self._silent_s if self._read else self._first_s
                fresh = self._ready.wait_for(lambda: self._read > self._taken or self._ended, patience_s)
                if self._read == self._taken:
                    why = "it has ended or was unplugged" if fresh else f"no frame for {patience_s:g} s"
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


# ---- what a camera is asked for

GENICAM = "GENICAM"  # no backend of OpenCV: mirrormount_beam/genicam.py
# what switches automatic exposure off, by OpenCV's name of the backend
_MANUAL = {"V4L2": 1, "DSHOW": 0, "MSMF": 0, GENICAM: 0}
_SIXTEEN_BITS = ("Y10 ", "Y12 ", "Y16 ")  # OpenCV would cut them to 8


def _set(capture: Capture, name: str, settings: CameraSettings) -> Controls:
    """Ask for the settings, in an order that drivers need: each may change those behind it.

    Raises CameraSettingRefused for what the camera has not taken.
    """
    if settings.fourcc is not None:
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*settings.fourcc))
        if settings.fourcc in _SIXTEEN_BITS:
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    if settings.width_px and settings.height_px:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, settings.width_px)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, settings.height_px)
        size = _size(capture)
        if size != (settings.width_px, settings.height_px):
            asked = f"--size {settings.width_px}x{settings.height_px}"
            raise CameraSettingRefused(f"{name}: it does not take {asked}: it has {size.width}x{size.height}")
    if settings.fourcc is not None and (has := _fourcc(capture)) != settings.fourcc:
        raise CameraSettingRefused(f"{name}: it does not take --fourcc {settings.fourcc.strip()}: it has {has}")
    if settings.exposure is not None:
        if _switch_automatic_off(capture) is False:
            raise CameraSettingRefused(f"{name}: it does not take --exposure: it has an automatic one that stays on")
        _ask(capture, name, "exposure", cv2.CAP_PROP_EXPOSURE, settings.exposure)
    if settings.gain is not None:
        _ask(capture, name, "gain", cv2.CAP_PROP_GAIN, settings.gain)
    return _controls(capture, settings)


def _ask(capture: Capture, name: str, what: str, number: int, value: float) -> None:
    good = capture.set(number, value)
    has = capture.get(number)
    if not (good and math.isclose(has, value, rel_tol=1e-3, abs_tol=1e-6)):
        told = f"{has:g}" if good or has != -1 else "none to set"  # -1 is what OpenCV returns where it does not know
        raise CameraSettingRefused(f"{name}: it does not take --{what} {value:g}: it has {told}")


def _size(capture: Capture) -> Size:
    return Size(int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))


def _fourcc(capture: Capture) -> str:
    """Four characters, or the number if it is none."""
    number = int(capture.get(cv2.CAP_PROP_FOURCC))
    text = "".join(chr(number >> shift & 0xFF) for shift in (0, 8, 16, 24)) if number > 0 else ""
    return text if text.isprintable() and text else f"number {number}"


def _switch_automatic_off(capture: Capture) -> bool | None:
    """Whether exposure is fixed now; None where OpenCV does not tell. Only V4L2 tells its state, 1 is manual."""
    backend = capture.getBackendName()
    if backend not in _MANUAL:
        return None
    manual = _MANUAL[backend]
    if backend != "V4L2":
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, manual)
        return None
    before = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE)
    if before in (-1, manual):
        return True if before == manual else None
    if capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, manual) and capture.get(cv2.CAP_PROP_AUTO_EXPOSURE) == manual:
        return True
    return None if before == 0 else False


def _controls(capture: Capture, settings: CameraSettings) -> Controls:
    """Exposure and gain, fixed where V4L2 can or they were asked for, and their numbers where OpenCV knows them."""
    exposure_fixed: bool | None = True
    if settings.exposure is None:  # other backends than V4L2 do not tell whether there is something to switch off
        exposure_fixed = _switch_automatic_off(capture) if capture.getBackendName() == "V4L2" else None
    gain_fixed = True if settings.gain is not None else _fix_gain(capture)
    exposure, gain = capture.get(cv2.CAP_PROP_EXPOSURE), capture.get(cv2.CAP_PROP_GAIN)
    told = settings.exposure is not None or (math.isfinite(exposure) and exposure not in (-1, 0))
    set_or_above_0 = math.isfinite(gain) and (gain > 0 or gain_fixed is True)
    return Controls(
        exposure_fixed,
        gain_fixed,
        exposure if told else None,
        OF_DRIVER if told else None,
        gain if set_or_above_0 else None,
    )


def _fix_gain(capture: Capture) -> bool | None:
    """Whether the gain stays when it is set to its own value."""
    gain = capture.get(cv2.CAP_PROP_GAIN)
    if gain < 0:
        return None
    return True if capture.set(cv2.CAP_PROP_GAIN, gain) and capture.get(cv2.CAP_PROP_GAIN) == gain else None
