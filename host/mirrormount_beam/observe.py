"""Where the spot is: the mean position in fresh images, or why there is none.

An image is fresh if it was exposed after the last motion has come to rest. A repeated image is no measurement and is
left out. SpotObserver has one camera, as measurements need it; Observer has all cameras of a table with their targets,
as the loop needs it. A vector of errors has x and y (up) of each camera in turn, in um.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from mirrormount.errors import MountError
from mirrormount_beam.camera import Image, Size
from mirrormount_beam.control.events import Listen, Observed, Pair, SpotMissed, SpotSeen
from mirrormount_beam.control.interfaces import LoopTable
from mirrormount_beam.errors import CameraError, CameraGone, CameraRepeats, SpotLost
from mirrormount_beam.spot.find import BY_CHANCE, NoSpot, NoSpotReason, Spot, find_spot

if TYPE_CHECKING:
    from mirrormount_beam.table import TargetCamera

FRAMES = 6  # of a measurement: the mean of six is 2.4 times better than one, and lasts 0.2 s
SETTLE_S = 0.4  # after a move: twenty time constants of a motor that coasts (docs/virtual-board.md)
PULSE_SETTLE_S = 0.01  # from the end of a pulse of the loop, which has its own rest after it, to the first exposure

Vector = NDArray[np.float64]
Finder = Callable[[Image], Spot | NoSpot]


@dataclass(frozen=True)
class Patience:
    """How many images in a row may be of no use before an observation is given up.

    missed: without a spot, for a reason that noise does not make. doubted: without a spot at all. repeated: the same
    picture again. stale: exposed before the last motion was over. old: older than oldest_s when they come.
    """

    missed: int
    doubted: int
    repeated: int
    stale: int
    old: int = 1
    oldest_s: float = math.inf


OF_MEASUREMENT = Patience(missed=15, doubted=15, repeated=150, stale=150)  # half a second and five of a webcam
# The loop stops all motors after two images without any spot, and after five whose light is not that of a clear spot,
# which noise alone may do to one.
OF_LOOP = Patience(missed=2, doubted=5, repeated=4, stale=40, old=4, oldest_s=1.0)


@dataclass(frozen=True, slots=True)
class Sighting:
    """The spot's place: mean of `frames` images, in px; time_s: of the last one, on the camera's clock.

    error_x, error_y: standard errors of the means, by the scatter of the images and by the spots' own errors, whichever
    is larger. peak: mean, in grey values above the background.
    """

    x: float
    y: float
    error_x: float
    error_y: float
    time_s: float
    frames: int
    peak: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Fault:
    """Why a camera shows no place. reason: of an image without a spot; kind: "spot", "gone", "repeats", "old"."""

    kind: str
    camera: str
    error: MountError
    reason: NoSpotReason | None = None

    def __str__(self) -> str:
        return str(self.error)


class FrameSource(Protocol):
    """What an observer needs of a Camera."""

    @property
    def name(self) -> str: ...

    @property
    def size(self) -> Size: ...

    def frames(self) -> Iterator[Image]: ...

    def monotonic(self) -> float: ...


class Misses:
    """Counts images in a row without a spot."""

    def __init__(self, patience: Patience = OF_LOOP) -> None:
        self._patience = patience
        self._all = self._sure = 0

    def too_many(self, found: Spot | NoSpot | None) -> bool:
        """Take the next image; None: there is none. True from the last one that may miss on."""
        if found:
            self._all = self._sure = 0
            return False
        self._all += 1
        self._sure += found is None or found.reason not in BY_CHANCE
        return self._sure >= self._patience.missed or self._all >= self._patience.doubted


# ---- one camera


class SpotObserver:
    """One camera. last: the newest spot and its frame."""

    def __init__(
        self,
        camera: FrameSource,
        find: Finder = find_spot,
        patience: Patience = OF_MEASUREMENT,
        *,
        settle_s: float = SETTLE_S,
    ) -> None:
        self.camera = camera
        self.find = find
        self.settle_s = settle_s
        self.last: tuple[Image, Spot] | None = None
        self._patience = patience
        self._frames: Iterator[Image] | None = None
        self._after_s = -math.inf

    def moved(self) -> None:
        """A motion has come to rest just now: images that are exposed before the mount has settled do not count."""
        self._after_s = self.camera.monotonic() + self.settle_s

    def observe(self, frames: int = FRAMES) -> Sighting:
        """The mean place in so many images that are exposed when the mount has settled, from now on.

        Raises SpotLost with the reason, CameraError.
        """
        self.moved()
        found = self.mean(frames)
        if isinstance(found, Fault):
            raise found.error
        return found

    def settled(self) -> Image:
        """One image that is exposed when the mount has settled, from now on. Raises CameraError."""
        self.moved()
        found = next(self._fresh())
        if isinstance(found, Fault):
            raise found.error
        return found

    def mean(self, frames: int) -> Sighting | Fault:
        """The mean place in so many fresh images, or why there is none."""
        spots: list[Spot] = []
        misses = Misses(self._patience)
        time_s = -math.inf
        for frame in self._fresh():
            if isinstance(frame, Fault):
                return frame
            spot = self.find(frame)
            if misses.too_many(spot):
                assert not spot
                return Fault("spot", self.camera.name, SpotLost(f"{self.camera.name}: {spot}"), spot.reason)
            if spot:
                self.last = frame, spot
                spots.append(spot)
                time_s = frame.time_s
                if len(spots) >= frames:
                    break
        x, y, sigma_x, sigma_y, peak = np.array([(s.x, s.y, s.sigma_x, s.sigma_y, s.peak) for s in spots]).T
        errors = _error(x, sigma_x), _error(y, sigma_y)
        return Sighting(float(x.mean()), float(y.mean()), *errors, time_s, len(spots), float(peak.mean()))

    def next_frame(self) -> Image:
        """The camera's next image, whatever it shows. Raises CameraError; then the camera is asked anew next time."""
        if self._frames is None:
            self._frames = self.camera.frames()
        try:
            return next(self._frames)
        except StopIteration:
            self._frames = None
            raise CameraGone(f"{self.camera.name}: no more frames") from None
        except CameraError:
            self._frames = None
            raise

    def _fresh(self) -> Iterator[Image | Fault]:
        """Fresh images, until one of no use is one too many."""
        name, patience = self.camera.name, self._patience
        repeated = stale = old = 0
        while True:
            try:
                frame = self.next_frame()
            except CameraError as e:
                yield Fault("gone", name, e)
                return
            age_s = self.camera.monotonic() - frame.time_s
            if frame.repeated and not self._is_flat(frame):
                repeated += 1
            elif age_s > patience.oldest_s:
                old += 1
            elif frame.time_s < self._after_s:
                stale += 1
            else:
                repeated = stale = old = 0
                yield frame
            if repeated >= patience.repeated:
                yield Fault("repeats", name, CameraRepeats(f"{name} repeats one picture: no fresh one in {repeated}"))
            if old >= patience.old:
                yield Fault("old", name, CameraError(f"{name}: its frames are {age_s:.1f} s old"))
            if stale >= patience.stale:
                yield Fault("old", name, CameraRepeats(f"{name}: no frame from after the last motion among {stale}"))

    def _is_flat(self, frame: Image) -> bool:
        """True for a picture of one grey value, which a camera in the dark repeats: find_spot() tells that in words."""
        return frame.image.min() == frame.image.max() and not self.find(frame)


def _error(places: Vector, sigmas: Vector) -> float:
    """The standard error of a mean of places with standard errors of their own."""
    n = len(places)
    scatter = float(np.std(places, ddof=1)) if n > 1 else 0.0
    return max(scatter, float(np.sqrt(np.mean(sigmas**2)))) / math.sqrt(n)


# ---- all cameras of a table


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """All cameras at once. errors_um: nan where a camera shows no spot. faults: of cameras."""

    time_s: float
    errors_um: Vector
    faults: tuple[Fault, ...]

    def __bool__(self) -> bool:
        """True if each camera shows a spot."""
        return not self.faults

    @property
    def worst_um(self) -> float:
        """The largest error along an axis in a camera."""
        return float(np.max(np.abs(self.errors_um)))


class Observer:
    """Observes all spots of a table.

    free_um: what the loop has moved the spots by, once it knows; it sets that.
    """

    def __init__(self, table: LoopTable, listen: Listen, patience: Patience = OF_LOOP) -> None:
        self.table = table
        self.free_um: Vector | None = None
        self._listen = listen
        self._each = [SpotObserver(camera, camera.find, patience, settle_s=PULSE_SETTLE_S) for camera in table.cameras]
        self._turn = 0

    def moved(self) -> None:
        """A motion has come to rest just now: older images do not count any more."""
        for each in self._each:
            each.moved()

    def observe(self, frames: int = 1) -> Observation:
        """The mean of so many fresh images of each camera."""
        cameras = self.table.cameras
        errors = np.full(2 * len(cameras), np.nan)
        faults: list[Fault] = []
        told: list[SpotSeen | SpotMissed] = []
        for number, (camera, each) in enumerate(zip(cameras, self._each, strict=True)):
            found = each.mean(frames)
            if isinstance(found, Fault):
                faults.append(found)
                told.append(SpotMissed(camera.name, str(found)))
                continue
            seen = self._from_target(camera, found)
            told.append(seen)
            errors[2 * number : 2 * number + 2] = seen.error_um
        now_s = self.table.now_s()
        self._listen(Observed(now_s, tuple(told), angle_urad(cameras, errors), self._free(errors)))
        return Observation(now_s, errors, tuple(faults))

    def glance(self) -> Spot | NoSpot | None:
        """One image of one camera, in turn, while motors run. None if the camera fails.

        It is not compared with the target, for the spot moves.
        """
        self._turn = (self._turn + 1) % len(self._each)
        each = self._each[self._turn]
        try:
            return each.find(each.next_frame())
        except CameraError:
            return None

    def _free(self, errors: Vector) -> tuple[Pair, ...]:
        if self.free_um is None:
            return ()
        free = errors - self.free_um
        return tuple(in_pairs(free)) if np.isfinite(free).all() else ()

    def _from_target(self, camera: "TargetCamera", found: Sighting) -> SpotSeen:
        error = (
            (found.x - camera.target_px[0]) * camera.um_per_px[0],
            -(found.y - camera.target_px[1]) * camera.um_per_px[1],
        )
        age_s = camera.monotonic() - found.time_s
        sigma_px = found.error_x, found.error_y
        return SpotSeen(camera.name, (found.x, found.y), sigma_px, error, self.table.now_s() - age_s, found.frames)


def in_pairs(errors_um: Vector) -> list[Pair]:
    """(x, y) of each camera."""
    return [(float(x), float(y)) for x, y in errors_um.reshape(-1, 2)]


def lever_m(cameras: "Sequence[TargetCamera]") -> float | None:
    """What divides an error in um to give the beam's angle in urad: the distance between the cameras, or of the one.

    None where distances are not known. With one camera the beam's place counts as angle.
    """
    distances = [camera.distance_m for camera in cameras]
    if any(distance is None for distance in distances):
        return None
    known = [distance for distance in distances if distance is not None]
    return known[-1] - known[0] if len(known) > 1 else known[0]


def angle_urad(cameras: "Sequence[TargetCamera]", errors_um: Vector) -> Pair | None:
    """By how much the beam's angle is off (x, y), by the difference of the last and the first camera."""
    lever = lever_m(cameras)
    if not lever or not np.isfinite(errors_um).all():
        return None
    difference = errors_um[-2:] - errors_um[:2] if len(cameras) > 1 else errors_um[:2]
    return float(difference[0] / lever), float(difference[1] / lever)
