"""Looks of the loop: the errors of all spots in fresh frames, or why there is none. Imports events, loop_table.

Fresh: exposed after the last motion has come to rest. A vector of errors has x and y (up) of each camera in turn, in
um.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mirrormount.beam.camera import Frame
from mirrormount.beam.control.events import Listen, Looked, Pair, SpotMissed, SpotSeen
from mirrormount.beam.control.interfaces import Eye, LoopTable
from mirrormount.beam.reasons import BY_CHANCE, Reason
from mirrormount.beam.spot import NoSpot, Spot
from mirrormount.common.beam_errors import CameraError

SETTLE_S = 0.01  # from the end of a pulse, which has its own rest after it, to the first exposure that counts
REPEATED = 4  # equal frames in a row: a camera whose noise differs from frame to frame does not do that
STALE = 40  # frames in a row that were exposed before the last motion
MISSED = 2  # frames in a row without a spot: the motors are off by then ...
DOUBTED = 5  # ... and frames whose light is not that of a clear spot, which noise alone may do to one

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Fault:
    """Why a camera gives no error. reason: of a frame without a spot; kind: "spot", "gone", "repeats", "old"."""

    kind: str
    camera: str
    text: str
    reason: Reason | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """errors_um: nan where a camera shows no spot. noise_um: standard errors by the spots' own. faults: of cameras.

    edge_px: for each camera, how far the spot is from the nearest edge of the picture.
    """

    time_s: float
    errors_um: Vector
    noise_um: Vector
    faults: tuple[Fault, ...]
    edge_px: tuple[float, ...]

    def __bool__(self) -> bool:
        """True if each camera shows a spot."""
        return not self.faults

    @property
    def worst_um(self) -> float:
        """The largest error along an axis in a camera."""
        return float(np.max(np.abs(self.errors_um)))


class Misses:
    """Counts frames in a row without a spot."""

    def __init__(self) -> None:
        self._all = self._sure = 0

    def too_many(self, found: Spot | NoSpot | None) -> bool:
        """Take the next frame; None: there is none. True from the last one that may miss on."""
        if found:
            self._all = self._sure = 0
            return False
        self._all += 1
        self._sure += found is None or found.reason not in BY_CHANCE
        return self._sure >= MISSED or self._all >= DOUBTED


class Looker:
    """Looks at all cameras of a table. oldest_s: age of a frame beyond which it does not count."""

    def __init__(self, table: LoopTable, listen: Listen, *, oldest_s: float = 1.0) -> None:
        self.table = table
        self.oldest_s = oldest_s
        self.free_um: Vector | None = None  # what the loop has moved the spots by; set by it
        self._listen = listen
        self._frames: list[Iterator[Frame] | None] = [None] * len(table.eyes)
        self._after_s = [-math.inf] * len(table.eyes)
        self._turn = 0

    def moved(self) -> None:
        """A motion has come to rest just now: older frames do not count any more."""
        self._after_s = [eye.monotonic() + SETTLE_S for eye in self.table.eyes]

    def look(self, frames: int = 1) -> Look:
        """The mean of so many fresh frames of each camera."""
        table = self.table
        errors, noise = np.full(2 * len(table.eyes), np.nan), np.full(2 * len(table.eyes), np.nan)
        faults: list[Fault] = []
        edges: list[float] = []
        told: list[SpotSeen | SpotMissed] = []
        for number, eye in enumerate(table.eyes):
            found = self._look_with(number, frames)
            if isinstance(found, Fault):
                faults.append(found)
                edges.append(-math.inf)
                told.append(SpotMissed(eye.name, found.text))
                continue
            seen, edge = found
            told.append(seen)
            edges.append(edge)
            errors[2 * number : 2 * number + 2] = seen.error_um
            noise[2 * number : 2 * number + 2] = np.multiply(seen.sigma_px, eye.um_per_px)
        look = Look(table.now_s(), errors, noise, tuple(faults), tuple(edges))
        self._listen(Looked(look.time_s, tuple(told), angle_urad(table.eyes, errors), self._free(errors)))
        return look

    def glance(self) -> Spot | NoSpot | None:
        """One frame of one camera, in turn, while motors run. None if the camera fails.

        It is not compared with the target, for the spot moves.
        """
        number = self._turn = (self._turn + 1) % len(self.table.eyes)
        try:
            return self.table.eyes[number].find(next(self._stream(number)))
        except (CameraError, StopIteration):
            self._frames[number] = None
            return None

    def _free(self, errors: Vector) -> tuple[Pair, ...]:
        if self.free_um is None:
            return ()
        free = errors - self.free_um
        return tuple(in_pairs(free)) if np.isfinite(free).all() else ()

    def _stream(self, number: int) -> Iterator[Frame]:
        stream = self._frames[number]
        if stream is None:
            stream = self._frames[number] = self.table.eyes[number].frames()
        return stream

    def _look_with(self, number: int, frames: int) -> tuple[SpotSeen, float] | Fault:
        """The mean place in one camera, and its distance from the edge."""
        eye = self.table.eyes[number]
        spots: list[Spot] = []
        misses = Misses()
        repeated = stale = old = 0
        time_s = -math.inf
        while len(spots) < frames:
            try:
                frame = next(self._stream(number))
            except (CameraError, StopIteration) as e:
                self._frames[number] = None
                return Fault("gone", eye.name, str(e) or f"{eye.name}: no more frames")
            if frame.repeated:
                repeated += 1
                if repeated >= REPEATED:
                    return Fault("repeats", eye.name, f"{eye.name} repeats one picture")
                continue
            if eye.monotonic() - frame.time_s > self.oldest_s:
                old += 1
                if old >= REPEATED:
                    age_s = eye.monotonic() - frame.time_s
                    return Fault("old", eye.name, f"{eye.name}: its frames are {age_s:.1f} s old")
                continue
            if frame.time_s < self._after_s[number]:
                stale += 1
                if stale >= STALE:
                    return Fault("old", eye.name, f"{eye.name}: no frame from after the last motion among {stale}")
                continue
            spot = eye.find(frame)
            if misses.too_many(spot):
                assert not spot
                return Fault("spot", eye.name, f"{eye.name}: {spot}", spot.reason)
            if spot:
                time_s = frame.time_s
                spots.append(spot)
        return self._seen(eye, spots, time_s)

    def _seen(self, eye: Eye, spots: Sequence[Spot], time_s: float) -> tuple[SpotSeen, float]:
        n = len(spots)
        x, y = sum(spot.x for spot in spots) / n, sum(spot.y for spot in spots) / n
        sigma = (
            math.sqrt(sum(spot.sigma_x**2 for spot in spots)) / n,
            math.sqrt(sum(spot.sigma_y**2 for spot in spots)) / n,
        )
        error = (x - eye.target_px[0]) * eye.um_per_px[0], -(y - eye.target_px[1]) * eye.um_per_px[1]
        edge = min(x, eye.size.width - 1 - x, y, eye.size.height - 1 - y)
        age_s = eye.monotonic() - time_s
        return SpotSeen(eye.name, (x, y), sigma, error, self.table.now_s() - age_s, n), edge


def in_pairs(errors_um: Vector) -> list[Pair]:
    """(x, y) of each camera."""
    return [(float(x), float(y)) for x, y in errors_um.reshape(-1, 2)]


def lever_m(eyes: Sequence[Eye]) -> float | None:
    """What divides an error in um to give the beam's angle in urad: the distance between the cameras, or of the one.

    None where distances are not known. With one camera the beam's place counts as angle.
    """
    distances = [eye.distance_m for eye in eyes]
    if any(distance is None for distance in distances):
        return None
    known = [distance for distance in distances if distance is not None]
    return known[-1] - known[0] if len(known) > 1 else known[0]


def angle_urad(eyes: Sequence[Eye], errors_um: Vector) -> Pair | None:
    """By how much the beam's angle is off (x, y), by the difference of the last and the first camera."""
    lever = lever_m(eyes)
    if not lever or not np.isfinite(errors_um).all():
        return None
    difference = errors_um[-2:] - errors_um[:2] if len(eyes) > 1 else errors_um[:2]
    return float(difference[0] / lever), float(difference[1] / lever)
