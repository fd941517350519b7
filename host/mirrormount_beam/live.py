"""What a camera shows now: its newest image, and the spot in it, or why there is none.

LiveCamera has a thread of its own that takes the images; a loop that holds a beam shows those that it takes itself.
Whoever reads the newest image never waits for the camera. A camera that fails is told in one line and opened again,
every two seconds.
"""

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount.errors import MountError
from mirrormount.terminal import printable
from mirrormount_beam.camera import Camera, Controls, Dark, Image, Size, as_bytes, range_of
from mirrormount_beam.errors import CameraGone
from mirrormount_beam.scale import Scale
from mirrormount_beam.selection import WHOLE, Selection
from mirrormount_beam.spot.find import NoSpot, Spot, find_spot

RATE_HZ = 15.0  # At most so many images in a second: to find a spot takes 6 ms.
_IDLE_S = 0.5  # The time between two images while no page is open; the camera stays open.
_WANTED_S = 3.0  # Images come at the full rate for so long after a page has asked for one.
RETRY_S = 2.0  # The time between two attempts to open the camera.
_OLD_S = 2.0  # A picture of this age does not show what is there now.
_SILENT, _REPEATS = "no new picture", "nothing but one and the same picture"
_WIDEST = 960  # The width of a picture for a browser, in pixels, at most.
_QUALITY = 80  # The quality of JPEG pictures.

_log = logging.getLogger("mirrormount_beam")


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """An image and what was found in it. number: counts from 1. at_s: when it was exposed, by time.monotonic."""

    number: int
    frame: Image
    found: Spot | NoSpot
    at_s: float


def as_jpeg(image: "NDArray[Any]", end: int | None = None) -> bytes:
    """A picture for a browser, not wider than 960 pixels. end: the grey value that becomes white."""
    image = as_bytes(image, end)
    if image.shape[1] > _WIDEST:
        size = (_WIDEST, max(1, round(image.shape[0] * _WIDEST / image.shape[1])))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()


class LiveView:
    """What a camera shows now, for whoever looks on: its newest image, and the spot in it. Any thread; nobody waits.

    old_s: age of a picture that is not what is there now. silence: what is then told, in words.
    """

    def __init__(self, name: str, old_s: float = _OLD_S, silence: str = _SILENT) -> None:
        self.name = name
        self._old_s, self._silence = old_s, silence
        self._last: Seen | None = None
        self._failure = "no picture yet"
        self._changed = threading.Condition()
        self._jpeg: tuple[int, bytes] = (0, b"")
        self._end = 0

    @property
    def last(self) -> Seen | None:
        """The newest image, however old; None before the first."""
        return self._last

    @property
    def trouble(self) -> str:
        """Why the last image does not show what is there now, in one line; "" if it does."""
        last = self._last
        if self._failure or last is None:
            return self._failure
        age_s = time.monotonic() - last.at_s
        return f"{self.name}: {self._silence} for {age_s:.0f} s" if age_s > self._old_s else ""

    @property
    def size(self) -> Size:
        """Of the newest image; 0 x 0 before the first."""
        last = self._last
        return Size(last.frame.image.shape[1], last.frame.image.shape[0]) if last else Size(0, 0)

    def jpeg(self, seen: Seen) -> bytes:
        """The picture for a browser, not wider than 960 pixels. It is made once for all who look."""
        number, data = self._jpeg
        if number != seen.number:
            self._end = max(self._end, range_of(seen.frame.image))  # that of one dim picture would make it flicker
            data = as_jpeg(seen.frame.selection.shown(seen.frame.image), self._end)
            self._jpeg = seen.number, data
        return data

    def show(self, frame: Image, found: Spot | NoSpot, age_s: float) -> None:
        """This is the newest image; it was exposed age_s ago."""
        at_s = time.monotonic() - max(0.0, age_s)
        with self._changed:
            self._last = Seen(self._last.number + 1 if self._last else 1, frame, found, at_s)
            self._failure = ""
            self._changed.notify_all()

    def fail(self, why: str) -> None:
        """The camera has failed; the newest image stays."""
        with self._changed:
            self._failure = printable(why, 300)
            self._changed.notify_all()


class LiveCamera(LiveView):
    """A camera and its thread. open_camera(): opens it, at the start and after each failure; name: for people.

    A Camera itself: frames() are those that the thread has seen from then on, found() the spots in them.
    """

    controls = Controls(None, None)
    selection: Selection = WHOLE  # each image has its own

    def __init__(
        self, name: str, open_camera: Callable[[], Camera], dark: Dark | None = None, *, retry_s: float = RETRY_S
    ) -> None:
        super().__init__(name)
        self._open_camera = open_camera
        self._dark = dark
        self._retry_s = retry_s
        self._camera: Camera | None = None
        self._wanted_s = float("-inf")
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name=f"watch {name}", daemon=True)

    def open(self, *, absent: bool = False) -> None:
        """Open the camera, and watch it. Raises CameraError, BadAddress, CannotOpen.

        absent: begin without one that cannot be opened; it is tried again every two seconds.
        """
        if not absent:
            self._camera = self._open_camera()
            self.name = self._camera.name
        self._thread.start()

    def close(self) -> None:
        """End the thread; the camera is closed there."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(2)

    # ---- for who looks: any thread

    @property
    def last(self) -> Seen | None:
        """The newest image, however old; None before the first."""
        self._wanted_s = time.monotonic()
        return super().last

    @property
    def scale(self) -> Scale | None:
        """The camera's own, if it knows it."""
        return getattr(self._camera, "scale", None)

    def monotonic(self) -> float:
        """time.monotonic: frames() have times on this clock."""
        return time.monotonic()

    def frames(self) -> Iterator[Image]:
        """Images that come from now on. Raises CameraGone while the camera is in trouble."""
        for seen in self.seen():
            yield replace(seen.frame, time_s=seen.at_s, number=seen.number)

    def seen(self) -> Iterator[Seen]:
        """What is seen from now on. Raises CameraGone while the camera is in trouble."""
        number = self._last.number if self._last else 0
        while True:
            seen = self.after(number, _OLD_S)
            if seen is None:
                raise CameraGone(self.trouble or f"{self.name}: no new picture for {_OLD_S:g} s")
            number = seen.number
            yield seen

    def found(self, frame: Image) -> Spot | NoSpot:
        """The spot in an image of frames()."""
        last = self._last
        if last and last.number == frame.number:
            return last.found
        return find_spot(frame, self._dark)

    def after(self, number: int, timeout_s: float) -> Seen | None:
        """Wait for an image with a higher number; None if none comes."""
        self._wanted_s = time.monotonic()
        with self._changed:
            came = self._changed.wait_for(lambda: self._is_after(number) or self._closing.is_set(), timeout_s)
            return self._last if came and self._is_after(number) else None

    def _is_after(self, number: int) -> bool:
        return self._last is not None and self._last.number > number

    # ---- the camera's thread

    def _watch(self) -> None:
        while not self._closing.is_set():
            camera = self._camera
            try:
                if camera is None:
                    camera = self._camera = self._open_camera()
                    self.name = camera.name
                self._look(camera)
                self.fail(f"{self.name}: no more pictures")
            except MountError as e:
                self.fail(str(e))
            except Exception as e:  # of a camera's library: it may be anything, and ends nothing but this picture
                _log.exception("a camera has failed")
                self.fail(f"{self.name}: the camera has failed ({type(e).__name__})")
            self._camera = None
            if camera is not None:
                with contextlib.suppress(Exception):  # it has failed already
                    camera.close()
            self._closing.wait(self._retry_s)
        with self._changed:
            self._changed.notify_all()

    def _look(self, camera: Camera) -> None:
        """Take its images until it ends. Raises CameraError."""
        began_s = time.monotonic()
        for frame in camera.frames():
            self._silence = _REPEATS if frame.repeated else _SILENT
            if not frame.repeated:  # a repeated picture is as old as the first of its kind
                self.show(frame, find_spot(frame, self._dark), camera.monotonic() - frame.time_s)
            wanted = time.monotonic() - self._wanted_s < _WANTED_S
            period_s = 1 / RATE_HZ if wanted else _IDLE_S
            if self._closing.wait(max(0.0, began_s + period_s - time.monotonic())):
                return
            began_s = time.monotonic()
