"""Looks at the spot between moves: the mean place of some fresh frames. Imports camera, spot, beam_errors.

Fresh: exposed after the mount has come to rest. Repeated frames are no measurements and are left out.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from mirrormount.beam import NoSpot, Spot, find_spot
from mirrormount.beam.camera import Camera, Frame
from mirrormount.common.beam_errors import CameraGone, CameraRepeats, SpotLost

FRAMES = 6  # of a look: the mean of six is 2.4 times better than one, and lasts 0.2 s
SETTLE_S = 0.4  # after a move: twenty time constants of a motor that coasts (docs/virtual-board.md)
MOST_REFUSED = 15  # frames without a spot, one after the other: half a second of a webcam
_MOST_STALE = 150  # frames that are too old or repeated, one after the other: five seconds of a webcam

Finder = Callable[[Frame], Spot | NoSpot]


@dataclass(frozen=True, slots=True)
class Sighting:
    """The spot's place: mean of `frames` frames, in px; time_s: of the last one, on the camera's clock.

    error_x, error_y: standard errors of the means, by the scatter of the frames and by the spots' own errors, whichever
    is larger. refused: frames without a spot that were left out. peak: mean, in grey values above the background.
    """

    x: float
    y: float
    error_x: float
    error_y: float
    time_s: float
    frames: int
    refused: int = 0
    peak: float = 0.0


class Observer:
    """Eyes of an experiment. seen(frame, spot) is called with each frame that is used, for a live picture.

    most_refused: frames in a row without a spot, after which it is lost.
    """

    def __init__(
        self,
        camera: Camera,
        find: Finder = find_spot,
        *,
        settle_s: float = SETTLE_S,
        most_refused: int = MOST_REFUSED,
        seen: Callable[[Frame, Spot], object] | None = None,
    ) -> None:
        self.camera = camera
        self.settle_s = settle_s
        self.last: tuple[Frame, Spot] | None = None  # the newest spot and its frame
        self._find = find
        self._most_refused = most_refused
        self._seen = seen
        self._frames: Iterator[Frame] = camera.frames()

    def look(self, frames: int = FRAMES) -> Sighting:
        """The mean place in so many frames that are exposed when the mount has settled, from now on.

        Raises SpotLost with the reason, CameraError.
        """
        places: list[tuple[float, float, float, float, float]] = []
        refused = in_a_row = 0
        time_s = self.camera.monotonic()
        for frame in self.settled():
            spot = self._find(frame)
            if isinstance(spot, NoSpot):
                refused, in_a_row = refused + 1, in_a_row + 1
                if in_a_row >= self._most_refused:
                    raise SpotLost(f"{self.camera.name}: {spot}")
                continue
            in_a_row = 0
            self.last = frame, spot
            if self._seen:
                self._seen(frame, spot)
            places.append((spot.x, spot.y, spot.sigma_x, spot.sigma_y, spot.peak))
            time_s = frame.time_s
            if len(places) >= frames:
                break
        x, y, sigma_x, sigma_y, peak = np.array(places).T
        return Sighting(
            float(x.mean()),
            float(y.mean()),
            _error(x, sigma_x),
            _error(y, sigma_y),
            time_s,
            len(places),
            refused,
            float(peak.mean()),
        )

    def settled(self) -> Iterator[Frame]:
        """New frames that are exposed when the mount has settled, from now on. Raises CameraError."""
        after_s = self.camera.monotonic() + self.settle_s
        stale = 0
        for frame in self._frames:
            black = frame.repeated and frame.image.min() == frame.image.max()  # find_spot says so, in words
            if frame.time_s < after_s or (frame.repeated and not black):
                stale += 1
                if stale >= _MOST_STALE:
                    raise CameraRepeats(f"{self.camera.name}: no fresh frame among {stale}")
                continue
            stale = 0
            yield frame
        raise CameraGone(f"{self.camera.name}: no more frames")


def _error(places: "np.ndarray", sigmas: "np.ndarray") -> float:
    """The standard error of a mean of places with standard errors of their own."""
    n = len(places)
    scatter = float(np.std(places, ddof=1)) if n > 1 else 0.0
    return max(scatter, float(np.sqrt(np.mean(sigmas**2)))) / math.sqrt(n)
