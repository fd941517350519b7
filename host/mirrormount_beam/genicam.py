"""Scientific and industrial cameras of the standard GenICam, through the package Harvesters (extra genicam).

The driver of a camera's maker brings a GenTL producer, a file *.cti, and puts its folder into GENICAM_GENTL64_PATH.
"""

import contextlib
import logging
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mirrormount.device.table_file import CameraSettings
from mirrormount.errors import ExtraMissing
from mirrormount.terminal import install_command, printable
from mirrormount_beam.camera import Limits
from mirrormount_beam.errors import CameraAbsent, CameraError
from mirrormount_beam.webcams import FIRST_S, GENICAM, Webcam

SCHEME = "genicam"
PRODUCERS = "GENICAM_GENTL64_PATH"  # of the environment; the standard gives it this name
_FORMATS = {"Mono8", "Mono10", "Mono12", "Mono14", "Mono16", "RGB8", "BGR8", "RGBa8", "BGRa8"}
_NODES = {  # the standard's names of what OpenCV has numbers for
    cv2.CAP_PROP_FRAME_WIDTH: ("Width", int),
    cv2.CAP_PROP_FRAME_HEIGHT: ("Height", int),
    cv2.CAP_PROP_EXPOSURE: ("ExposureTime", float),
    cv2.CAP_PROP_GAIN: ("Gain", float),
}

_log = logging.getLogger("mirrormount_beam")


def listed() -> Iterator[tuple[str, str]]:
    """Address and name of each camera; none without Harvesters or a producer."""
    with contextlib.suppress(ExtraMissing, CameraAbsent), _harvester() as harvester:
        for device in harvester.device_info_list:
            yield f"{SCHEME}://{device.id_}", _name(device)


def open_genicam(part: str, *, limits: Limits, settings: CameraSettings) -> Webcam:
    """The camera with that part in its name, or the only one. Raises ExtraMissing, CameraError."""
    with contextlib.ExitStack() as opened:
        harvester = opened.enter_context(_harvester())
        devices = list(enumerate(harvester.device_info_list))
        matching = [(at, each) for at, each in devices if part.lower() in f"{_name(each)} {each.id_}".lower()]
        if len(matching) != 1:
            known = ", ".join(f"{each.id_} {_name(each)}" for _, each in devices) or "none"
            which = "several cameras" if matching else "no camera"
            raise CameraAbsent(printable(f"{which} of GenICam with {part[:80]!r} in the name; there is: {known}", 1000))
        at, device = matching[0]
        name = _name(device)
        try:
            with _ctrl_c_kept():
                acquirer = harvester.create(at)
        except Exception as e:  # of a maker's library
            raise CameraAbsent(f"{name}: cannot be opened: {printable(str(e))}") from e
        capture = GenicamCapture(acquirer, opened.pop_all())
    try:
        capture.check_format(name)
    except CameraError:
        capture.release()
        raise
    return Webcam(capture, name, limits, settings)


@contextlib.contextmanager
def _ctrl_c_kept() -> Iterator[None]:
    """Harvesters takes Ctrl-C for itself in the main thread; but Ctrl-C must stop the motors."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def _harvester() -> Iterator[Any]:
    """Harvesters with all producers of this computer. Raises ExtraMissing, CameraAbsent."""
    try:
        from harvesters.core import Harvester  # pyright: ignore[reportMissingImports]  # an extra that few install
    except ModuleNotFoundError as e:
        raise ExtraMissing(
            f"{SCHEME}:// needs a package that is not installed ({e.name}): {install_command(SCHEME)}"
        ) from e
    harvester = Harvester()
    folders = [Path(folder) for folder in os.environ.get(PRODUCERS, "").split(os.pathsep) if folder]
    producers = [file for folder in folders for file in sorted(folder.glob("*.cti"))]
    if not producers:
        raise CameraAbsent(f"no folder of {PRODUCERS} has a GenTL producer (*.cti): install the camera maker's driver")
    try:
        try:
            for producer in producers:
                harvester.add_file(str(producer))
            harvester.update()
        except Exception as e:  # of a maker's library
            raise CameraAbsent(f"the GenTL producers of {PRODUCERS} cannot be used: {printable(str(e))}") from e
        yield harvester
    finally:
        harvester.reset()


def _name(device: Any) -> str:
    """Model and serial number, by which a scale of the camera is saved."""
    return f"{device.model} {device.serial_number}"


class GenicamCapture:
    """A camera of Harvesters in the form of an OpenCV capture, so that it is a Webcam with all that belongs to one."""

    def __init__(self, acquirer: Any, owner: contextlib.ExitStack) -> None:
        self._acquirer, self._owner = acquirer, owner
        self._nodes = acquirer.remote_device.node_map
        self._started = False

    def check_format(self, name: str) -> None:
        """Raises CameraError for a form of the pictures that is not read, such as those of a colour filter."""
        form = self._nodes.PixelFormat.value
        if form not in _FORMATS:
            can = ", ".join(each for each in self._nodes.PixelFormat.symbolics if each in _FORMATS) or "none of them"
            raise CameraError(f"{name}: pictures in the form {form} are not read; set {can} in the maker's program")

    def isOpened(self) -> bool:
        return True

    def getBackendName(self) -> str:
        return GENICAM

    def read(self) -> tuple[bool, Any]:
        """The next picture; none if the camera is silent or gone."""
        try:
            if not self._started:
                self._acquirer.start()
                self._started = True
            with self._acquirer.fetch(timeout=FIRST_S) as buffer:
                picture = buffer.payload.components[0]
                return True, np.array(picture.data.reshape(picture.height, picture.width, -1))
        except Exception as e:  # of a maker's library
            _log.info("a camera of GenICam has ended: %s", e)
            return False, None

    def get(self, propId: int) -> float:
        try:
            return float(getattr(self._nodes, _NODES[propId][0]).value)
        except Exception:  # the camera has no such node, or does not tell it now
            return -1.0

    def set(self, propId: int, value: float) -> bool:
        try:
            if propId == cv2.CAP_PROP_AUTO_EXPOSURE:
                self._nodes.ExposureAuto.value = "Off"
            else:
                name, kind = _NODES[propId]
                getattr(self._nodes, name).value = kind(value)
        except Exception:  # no such node, out of range, or not to be written now
            return False
        return True

    def release(self) -> None:
        with contextlib.suppress(Exception), self._owner:  # of a maker's library: the camera may be unplugged
            if self._started:
                self._acquirer.stop()
            self._acquirer.destroy()
