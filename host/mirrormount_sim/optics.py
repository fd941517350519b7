"""Light: the path of the beam over mirrors, how it drifts, and what a screen or a webcam shows of the spot.

The table is the plane of x and z; y is up. Each mirror folds the beam by 90 degrees, in turn to the left and to the
right. A plane's coordinates are (right, up) as seen along the beam, from where the beam hits it with all mirrors at
rest. Lengths in metres, coordinates in the planes in millimetres, angles in radians.

A webcam's picture has gain, exposure, noise, hot pixels, a ghost, ambient light; the shapes of beams and the defects of
chips are in beams.py. Grey values are those at gain 1 and at EXPOSURE_S unless a name says otherwise. No number is of a
certain camera: all are assumed, in the range of webcams of 20 to 50 dollars.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirrormount_sim.beams import GAUSSIAN, GOOD, Beam, Defects, Window, expose, patch, window_light
from mirrormount_sim.profiles import DAY_S

SPOT_MM = 2.0  # radius of the spot (one standard deviation); assumed
_NOISE = 2.0  # read noise, grey levels; assumed
_FLOOR = 10.0  # dark level


@dataclass(frozen=True)
class View:
    """The part of the screen in the picture: left, right, bottom, top in mm, and the pixels' size in mm."""

    left: float
    right: float
    bottom: float
    top: float
    pixel: float = 0.25

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return round((self.top - self.bottom) / self.pixel), round((self.right - self.left) / self.pixel)

    def picture(self, spot_mm: tuple[float, float], noise: np.random.Generator) -> np.ndarray:
        """A grey picture (rows x columns, float, 0 ... 255; row 0 is the top) of the spot at spot_mm."""
        rows, columns = self.shape
        x = self.left + (np.arange(columns) + 0.5) * self.pixel - spot_mm[0]
        y = self.top - (np.arange(rows) + 0.5) * self.pixel - spot_mm[1]
        light = np.exp(-(y[:, None] ** 2 + x[None, :] ** 2) / (2 * SPOT_MM**2))
        return np.clip(np.round(_FLOOR + 220 * light + noise.normal(0, _NOISE, (rows, columns))), 0, 255)

    def centroid(self, picture: np.ndarray) -> tuple[float, float] | None:
        """Where the spot is in a picture, (right, up) in mm: first moments above half of its height.

        None if nothing in the picture stands clear of the noise.
        """
        dark = float(np.median(picture))
        peak = float(picture.max())
        if peak - dark < 20 * _NOISE:
            return None
        weight = np.clip(picture - (dark + peak) / 2, 0, None)
        rows, columns = np.indices(picture.shape)
        total = weight.sum()
        x = self.left + (float((weight * columns).sum() / total) + 0.5) * self.pixel
        y = self.top - (float((weight * rows).sum() / total) + 0.5) * self.pixel
        return x, y


Vector = tuple[float, float, float]
Spot = tuple[float, float] | None  # (right, up) in mm; None: the beam does not come there

UP: Vector = (0.0, 1.0, 0.0)
MIRROR_RADIUS_M = 0.0127  # the paper, section II: mounts of one-inch mirrors


@dataclass(frozen=True)
class Geometry:
    """Distances along the beam. All are assumed, as in the trial that the design of the holding loop stands on."""

    laser_m: float = 0.5  # from the laser to the first mirror
    between_m: float = 0.6  # from the first mirror to the second
    cameras_m: tuple[float, ...] = (0.4, 1.6)  # from the last mirror to each camera


DEFAULT = Geometry()


@dataclass(frozen=True)
class _Mirror:
    """A mirror at rest: its centre, its normal, and the direction that is horizontal in it."""

    centre: Vector
    normal: Vector
    across: Vector

    def turned(self, yaw: float, pitch: float) -> Vector:
        """The normal, turned about the vertical by yaw and then about the mirror's own horizontal by pitch."""
        along = _scaled(self.across, math.sin(yaw) * math.cos(pitch))
        out = _scaled(self.normal, math.cos(yaw) * math.cos(pitch))
        return _sum(_sum(along, _scaled(UP, math.sin(pitch))), out)


@dataclass(frozen=True)
class _Plane:
    centre: Vector
    ahead: Vector
    right: Vector


# ---- the path of the beam


class BeamPath:
    """The way from a laser over so many mirrors to the cameras' planes."""

    def __init__(self, mirrors: int, geometry: Geometry) -> None:
        self._laser = _Plane((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), _cross(UP, (1.0, 0.0, 0.0)))
        place, ahead = self._laser.centre, self._laser.ahead
        self._mirrors: list[_Mirror] = []
        for number in range(mirrors):
            place = _sum(place, _scaled(ahead, geometry.between_m if number else geometry.laser_m))
            folded = _cross(UP, ahead) if number % 2 else _cross(ahead, UP)
            normal = _unit(_sum(folded, _scaled(ahead, -1)))
            self._mirrors.append(_Mirror(place, normal, _cross(UP, normal)))
            ahead = folded
        right = _cross(UP, ahead)
        self._planes = [_Plane(_sum(place, _scaled(ahead, m)), ahead, right) for m in geometry.cameras_m]

    def spots(
        self, offset_mm: tuple[float, float], angle_rad: tuple[float, float], mirrors_rad: list[tuple[float, float]]
    ) -> list[Spot]:
        """Where the beam hits the planes. offset_mm, angle_rad: of the laser's beam, to the right and up.

        mirrors_rad: yaw and pitch of each mirror.
        """
        laser = self._laser
        point = _sum(_scaled(laser.right, offset_mm[0] * 1e-3), _scaled(UP, offset_mm[1] * 1e-3))
        sideways = _sum(_scaled(laser.right, math.tan(angle_rad[0])), _scaled(UP, math.tan(angle_rad[1])))
        ray = _unit(_sum(laser.ahead, sideways))
        for mirror, (yaw, pitch) in zip(self._mirrors, mirrors_rad, strict=True):
            normal = mirror.turned(yaw, pitch)
            hit = _hit(point, ray, mirror.centre, normal)
            if hit is None or math.dist(hit, mirror.centre) > MIRROR_RADIUS_M:
                return [None] * len(self._planes)
            point, ray = hit, _sum(ray, _scaled(normal, -2 * _dot(ray, normal)))
        return [self._on(plane, point, ray) for plane in self._planes]

    @staticmethod
    def _on(plane: _Plane, point: Vector, ray: Vector) -> Spot:
        hit = _hit(point, ray, plane.centre, plane.ahead)
        if hit is None:
            return None
        offset = _sum(hit, _scaled(plane.centre, -1))
        return _dot(offset, plane.right) * 1e3, _dot(offset, UP) * 1e3


def _hit(point: Vector, ray: Vector, centre: Vector, normal: Vector) -> Vector | None:
    """Where a ray meets the plane through centre. None if that is not ahead of it."""
    slope = _dot(ray, normal)
    if not slope:
        return None
    way = _dot(_sum(centre, _scaled(point, -1)), normal) / slope
    return _sum(point, _scaled(ray, way)) if way > 0 else None


def _sum(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _scaled(a: Vector, factor: float) -> Vector:
    return a[0] * factor, a[1] * factor, a[2] * factor


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _unit(a: Vector) -> Vector:
    return _scaled(a, 1 / math.sqrt(_dot(a, a)))


EXPOSURE_S = 0.005  # at which the grey values below are true
_LAMP_PX = 180.0  # radius of the moving light, one standard deviation


# ---- the sensor of a webcam


@dataclass
class Sensor:
    """A camera that looks at a screen, or a bare chip. All may be changed at any time, the size by resize()."""

    exposure_s: float = EXPOSURE_S
    gain: float = 1.0
    width: int = 640
    height: int = 480
    pixel_mm: float = 0.05  # of the plane, for one pixel
    rotation_deg: float = 0.0  # of the camera about the beam; positive turns the picture clockwise
    centre_px: tuple[float, float] = (319.5, 239.5)  # where the plane's centre is, (column, row)
    spot_sigma_mm: float = 0.6  # one standard deviation of the beam's intensity, whatever its shape
    beam: Beam = GAUSSIAN  # its shape
    defects: Defects = GOOD
    window: Window | None = None
    peak: float = 180.0  # of the spot
    black: float = 6.0  # without light
    read_noise: float = 1.5
    electrons: float = 47.0  # for one grey value: shot noise is the root of their number
    ambient: float = 8.0
    ambient_wave: float = 0.0  # the room's light rises and falls by so much ...
    wave_s: float = 40.0  # ... in this time
    lamp: float = 0.0  # a bright place that moves over the picture, at its middle
    ghost: float = 0.0  # of the spot's light, from the second surface of a window or a beam splitter
    ghost_px: tuple[float, float] = (70.0, -28.0)  # from the spot to its ghost
    hot_pixels: int = 0
    seed: int = 1

    def __post_init__(self) -> None:
        self.noise = np.random.default_rng(self.seed)
        self._new_size()

    def resize(self, width: int, height: int) -> None:
        """Frames of another size; the middle of the picture stays."""
        x, y = self.centre_px
        self.centre_px = x + (width - self.width) / 2, y + (height - self.height) / 2
        self.width, self.height = width, height
        self._new_size()

    def _new_size(self) -> None:
        self._light = np.empty((self.height, self.width), np.float32)
        fixed = np.random.default_rng(self.seed)  # hot pixels are of the chip, not of the moment
        self.hot_at = fixed.integers(0, self.width * self.height, self.hot_pixels)
        self._hot = fixed.uniform(40, 250, self.hot_pixels).astype(np.float32)

    def place(self, spot_mm: tuple[float, float]) -> tuple[float, float]:
        """Where in the picture a point (right, up) of the plane is: x (column), y (row) in pixels."""
        right, up = spot_mm[0] / self.pixel_mm, spot_mm[1] / self.pixel_mm
        c, s = math.cos(math.radians(self.rotation_deg)), math.sin(math.radians(self.rotation_deg))
        return self.centre_px[0] + right * c + up * s, self.centre_px[1] + right * s - up * c

    def picture(self, spots_mm: list[tuple[float, float]], time_s: float) -> NDArray[Any]:
        """A frame (rows, columns) with these spots, each of full brightness. Its type is that of beams.expose()."""
        light = self._light
        scale = self.gain * self.exposure_s / EXPOSURE_S
        ambient = self.ambient + self.ambient_wave * math.sin(2 * math.pi * time_s / self.wave_s)
        light[:] = max(0.0, ambient) * scale
        if self.lamp:
            light += self._lamp_light(time_s) * np.float32(self.lamp * scale)
        if self.window:
            light += window_light(self.window, light.shape) * np.float32(scale)
        for spot in spots_mm:
            x, y = self.place(spot)
            self._add(x, y, self.peak * scale)
            if self.ghost:
                self._add(x + self.ghost_px[0], y + self.ghost_px[1], self.ghost * self.peak * scale)
        light.reshape(-1)[self.hot_at] += self._hot * np.float32(scale)
        read_noise, electrons = self.read_noise * self.gain, self.electrons / self.gain
        return expose(light, self.noise, self.defects, black=self.black, read_noise=read_noise, electrons=electrons)

    def _add(self, x: float, y: float, peak: float) -> None:
        """Add a spot."""
        beam = replace(self.beam, sigma=self.spot_sigma_mm / self.pixel_mm)
        rows, columns, spot = patch(beam, x, y, self._light.shape)
        self._light[rows, columns] += spot * np.float32(peak)

    def _lamp_light(self, time_s: float) -> NDArray[np.float32]:
        """The moving light's share at each pixel."""
        turn = 2 * math.pi * time_s / self.wave_s
        x, y = self.width * (0.5 + 0.5 * math.sin(turn)), self.height * (0.5 + 0.5 * math.cos(0.7 * turn))
        across = np.exp(-((np.arange(self.width, dtype=np.float32) - x) ** 2) / (2 * _LAMP_PX**2))
        down = np.exp(-((np.arange(self.height, dtype=np.float32) - y) ** 2) / (2 * _LAMP_PX**2))
        return np.multiply.outer(down.astype(np.float32), across.astype(np.float32))


# ---- a fibre behind a collimator

# Thorlabs F220APC-780, f = 11.07 mm, with fibre 780HP, mode field diameter 5.0 um, at 780 nm (their catalogue)
WAVELENGTH_MM, FOCAL_MM, MODE_FIELD_MM = 780e-6, 11.07, 5.0e-3
FIBRE_WAIST_MM = WAVELENGTH_MM * FOCAL_MM / (math.pi * MODE_FIELD_MM / 2)  # of its mode before the lens: 1.10
FIBRE_ANGLE_RAD = MODE_FIELD_MM / 2 / FOCAL_MM  # at which the light in it is 1/e: 226 urad
FIBRE_M = 0.4  # from the last mirror to the collimator; assumed
FIBRE_NOISE = 0.02  # of the light, one standard deviation from reading to reading; assumed
FIBRE_DARK = 2e-4  # of all light, the same without light; assumed


class Fibre:
    """A single-mode fibre with a collimator, and a beam that has its mode's waist there.

    Two equal Gaussian modes of waist w, d apart and at an angle of theta, overlap by exp(-(d/w)^2 - (theta pi
    w/lambda)^2) (W. B. Joyce and B. C. DeLoach, 1984). A place is a beam's (right, up) in units of w, then its angle in
    units of lambda/(pi w).
    It stands where some turn of the mirrors aims, begins with so much light, and aims in any direction of a place that
    the mirrors reach: with one mount angles only, with two displacements as well.
    """

    def __init__(self, mirrors: int, geometry: Geometry, start: float, noise: np.random.Generator) -> None:
        two = replace(geometry, cameras_m=(FIBRE_M, FIBRE_M + 1.0))
        self._path, self._noise = BeamPath(mirrors, two), noise
        small = 1e-5
        at_rest = self._raw((0.0, 0.0), (0.0, 0.0), [(0.0, 0.0)] * mirrors)
        columns = []
        for axis in range(2 * mirrors):
            turned = [0.0] * (2 * mirrors)
            turned[axis] = small
            pairs = list(zip(turned[::2], turned[1::2], strict=True))
            columns.append((self._raw((0.0, 0.0), (0.0, 0.0), pairs) - at_rest) / small)
        self._reach = np.linalg.qr(np.array(columns).T)[0]  # the places that the mirrors reach, as orthonormal columns
        far = noise.standard_normal(2 * mirrors)
        self._off = self._reach @ (far * math.sqrt(-math.log(start)) / np.linalg.norm(far))
        self._aim: NDArray[np.float64] | None = None

    def _raw(
        self, offset_mm: tuple[float, float], angle_rad: tuple[float, float], mirrors_rad: list[tuple[float, float]]
    ) -> NDArray[np.float64]:
        near, far = self._path.spots(offset_mm, angle_rad, mirrors_rad)
        if near is None or far is None:
            return np.full(4, 1e3)  # no light
        at, ahead = np.array(near), np.array(far)
        return np.concatenate((at / FIBRE_WAIST_MM, (ahead - at) * 1e-3 / FIBRE_ANGLE_RAD))

    def light(
        self, offset_mm: tuple[float, float], angle_rad: tuple[float, float], mirrors_rad: list[tuple[float, float]]
    ) -> tuple[float, float]:
        """The share of the light that is in the fibre, and the largest that the mirrors can bring into it now."""
        place = self._raw(offset_mm, angle_rad, mirrors_rad)
        if self._aim is None:
            self._aim = place + self._off
        off = place - self._aim
        out_of_reach = off - self._reach @ (self._reach.T @ off)
        return math.exp(-float(off @ off)), math.exp(-float(out_of_reach @ out_of_reach))

    def reading(self, light: float) -> float:
        """What a power meter shows, of 1 for all light."""
        by_light, dark = self._noise.standard_normal(2)
        return light * (1 + FIBRE_NOISE * float(by_light)) + FIBRE_DARK * float(dark)


GRID_S = 0.01  # the walk's step; a jitter stays as long
_MOST = 100_000  # steps drawn at once


# ---- the drift of the laser and of the mirrors


class Drift:
    """Two angles (right and up, or yaw and pitch) in radians, as functions of time.

    drift_urad: standard deviation of the walk after one second. jitter_urad: standard deviation about it.
    """

    def __init__(self, noise: np.random.Generator, drift_urad: float, jitter_urad: float) -> None:
        self._noise = noise
        self.drift_urad = drift_urad
        self.jitter_urad = jitter_urad
        self._steps = 0
        self._walk = np.zeros(2)
        self._jitter = np.zeros(2)

    def at(self, time_s: float) -> tuple[float, float]:
        """The angles at a time that is not before the last one asked for."""
        missing = int(time_s / GRID_S) - self._steps
        while missing > 0:
            drawn = self._noise.standard_normal((min(missing, _MOST), 4))
            self._walk += drawn[:, :2].sum(axis=0) * (self.drift_urad * math.sqrt(GRID_S) * 1e-6)
            self._jitter = drawn[-1, 2:] * (self.jitter_urad * 1e-6)
            self._steps += len(drawn)
            missing -= len(drawn)
        return float(self._walk[0] + self._jitter[0]), float(self._walk[1] + self._jitter[1])


@dataclass(frozen=True)
class Day:
    """The drift of an angle with the room's temperature over a day, from the table's beginning on."""

    urad: float
    phase_rad: float

    def at(self, time_s: float) -> float:
        """Radians."""
        turn = 2 * math.pi * time_s / DAY_S
        return self.urad * 1e-6 * (math.sin(turn + self.phase_rad) - math.sin(self.phase_rad))
