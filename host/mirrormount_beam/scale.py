"""From pixels to millimetres on the screen and milliradians of beam and mirror, with standard errors.

A mirror that turns by a about an axis normal to the plane of incidence turns the beam by 2 a; about an axis in that
plane and in the mirror's surface, by 2 a cos(angle of incidence). Both follow from r = d - 2 (d·n) n with the normal n
turned by a: the change of r is -2 ((d·dn) n + (d·n) dn).

The scales of cameras are in cameras.toml in the user's folder for settings, a table for each camera's name.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount import files
from mirrormount.device import calibration
from mirrormount.errors import BadFile, BadValue, NotCalibrated
from mirrormount_beam.camera import Camera, Size, as_bytes, to_grey
from mirrormount_beam.estimates import Estimate

_TILTED = 0.03  # ratio of a checkerboard's two scales, less 1, above which it is seen at an angle
_HEADING = """mirrormount: the scales of cameras (docs/beam.md).
mm_per_px: millimetres on the screen. distance_mm: from mirror to screen. incidence_deg: 0 where the beam returns.
Each sigma_ is the standard error of the number of that name."""


class Measured(NamedTuple):
    """A number and its standard error."""

    value: float
    sigma: float


@dataclass(frozen=True)
class Scale:
    """The scale of a camera of a size in pixels. The screen is normal to the beam. sigma_*: standard errors."""

    width: int
    height: int
    mm_per_px: float
    sigma_mm_per_px: float
    distance_mm: float | None = None
    sigma_distance_mm: float = 0.0
    incidence_deg: float | None = None
    sigma_incidence_deg: float = 0.0

    def mm(self, pixels: Measured) -> Measured:
        """A length on the screen, mm."""
        return _product(pixels, Measured(self.mm_per_px, self.sigma_mm_per_px))

    def beam_mrad(self, pixels: Measured) -> Measured:
        """The angle of the beam for a shift of the spot, mrad; of small angles. Raises NotCalibrated."""
        if self.distance_mm is None:
            raise NotCalibrated("the distance from the mirror to the screen is not known: give distance_mm")
        length = self.mm(pixels)
        part = math.hypot(_relative(length), self.sigma_distance_mm / self.distance_mm)
        angle = 1000 * length.value / self.distance_mm
        return Measured(angle, abs(angle) * part if length.value else 1000 * length.sigma / self.distance_mm)

    def mirror_mrad(self, pixels: Measured, *, in_plane: bool) -> Measured:
        """The angle of the mirror, mrad. in_plane: the spot moves in the plane of incidence. Raises NotCalibrated."""
        beam = self.beam_mrad(pixels)
        if in_plane:
            return Measured(beam.value / 2, beam.sigma / 2)
        if self.incidence_deg is None:
            raise NotCalibrated("the angle of incidence at the mirror is not known: give incidence_deg")
        incidence, sigma = math.radians(self.incidence_deg), math.radians(self.sigma_incidence_deg)
        angle = beam.value / (2 * math.cos(incidence))
        return Measured(angle, math.hypot(beam.sigma / (2 * math.cos(incidence)), angle * math.tan(incidence) * sigma))


class Axes(NamedTuple):
    """Two axes of a mount, seen by a camera.

    rotation_rad: by how much the picture's x axis is turned against the direction of axis x. cross_talk: the part of a
    move of axis y that goes along axis x (sine of the deviation from 90°). mirrored: the picture is a mirror image.
    """

    x_px: Measured
    y_px: Measured
    rotation_rad: Measured
    cross_talk: Measured
    mirrored: bool


def axes(x_shift: tuple[Measured, Measured], y_shift: tuple[Measured, Measured]) -> Axes:
    """Axes from the shift (x, y), px, of one step of each axis, right and up positive on the mount.

    A picture has y downwards, so an upright one shows a step up as a negative y. Raises BadValue if nothing moved.
    """
    x_px, x_angle = _polar(x_shift)
    y_px, y_angle = _polar(y_shift)
    turned = math.remainder(x_angle.value - y_angle.value, math.tau)
    mirrored = turned < 0
    apart = abs(turned) - math.pi / 2
    sigma = math.hypot(x_angle.sigma, y_angle.sigma)
    return Axes(x_px, y_px, x_angle, Measured(-math.sin(apart), sigma * math.cos(apart)), mirrored)


def _polar(shift: tuple[Measured, Measured]) -> tuple[Measured, Measured]:
    (x, sigma_x), (y, sigma_y) = shift
    length = math.hypot(x, y)
    if length == 0:
        raise BadValue("the spot did not move: no direction")
    along = math.hypot(x * sigma_x, y * sigma_y) / length
    across = math.hypot(y * sigma_x, x * sigma_y) / length
    return Measured(length, along), Measured(math.atan2(y, x), across / length)


def of_ruler(
    start: tuple[float, float],
    end: tuple[float, float],
    length: Measured,
    *,
    sigma_px: float = 0.5,
) -> Measured:
    """mm a pixel, from two points in the picture and their distance, mm. sigma_px: error of each point."""
    pixels = math.dist(start, end)
    if pixels < 10 or not length.value > 0:
        raise BadValue(f"a ruler needs two points at least 10 pixels apart and a length above 0, not {pixels:.3g} px")
    value = length.value / pixels
    return Measured(value, value * math.hypot(_relative(length), math.sqrt(2) * sigma_px / pixels))


def of_pitch(pitch_um: Measured) -> Measured:
    """mm a pixel of a sensor without a lens, from the distance of its pixels, um. Raises BadValue."""
    if not 0.1 < pitch_um.value < 100:
        raise BadValue(f"the pitch of pixels is 0.1 to 100 um, not {pitch_um.value:g}")
    return Measured(pitch_um.value / 1000, pitch_um.sigma / 1000)


def of_checkerboard(image: NDArray[Any], square: Measured, corners: tuple[int, int]) -> Measured:
    """mm a pixel, from a printed checkerboard. square: mm. corners: inner corners (along a row, of rows).

    Raises BadValue if it is not in the picture, or seen at an angle.
    """
    grey = as_bytes(to_grey(image))
    found, coarse = cv2.findChessboardCorners(grey, corners)
    if not found:
        raise BadValue(f"no checkerboard with {corners[0]} x {corners[1]} inner corners in the picture")
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.001)
    seen = cv2.cornerSubPix(grey, coarse, (5, 5), (-1, -1), criteria).reshape(-1, 2).astype(float)
    down, along = np.divmod(np.arange(len(seen)), corners[0])
    design = np.column_stack([np.ones(len(seen)), along, down])
    affine, *_ = np.linalg.lstsq(design, seen, rcond=None)
    large, small = np.linalg.svd(affine[1:], compute_uv=False)
    if large / small - 1 > _TILTED:
        angle = math.degrees(math.acos(small / large))
        raise BadValue(f"the checkerboard is seen at an angle of about {angle:.0f}°: turn it, or the camera")
    rest = seen - design @ affine
    noise = math.sqrt(float((rest**2).sum()) / (rest.size - 6))
    spread = math.sqrt(float(np.linalg.inv(design.T @ design)[1, 1]))
    pixels = math.sqrt(large * small)
    part = math.hypot(_relative(square), noise * spread / pixels, (large / small - 1) / 2)
    return Measured(square.value / pixels, square.value / pixels * part)


def path() -> Path:
    """The path of the file of cameras' scales."""
    return calibration.path().with_name("cameras.toml")


def write(camera: Camera, scale: Scale) -> Path:
    """Save the scale of a camera, beside those of other ones. Raises BadFile, BadValue, CannotWrite."""
    if Size(scale.width, scale.height) != camera.size:
        raise BadValue(f"the scale is of {scale.width} x {scale.height} pixels, the camera has {camera.size}")
    tables = files.read_toml(path())
    tables[camera.name] = {key: value for key, value in asdict(scale).items() if value is not None}
    files.write_atomic(path(), files.toml_text_for(path(), tables, _HEADING), make_folder=True)
    return path()


def read(camera: Camera) -> Scale:
    """The scale of a camera: its own if it knows it, as a virtual one does, else the saved one.

    Raises NotCalibrated if there is none, or of another size; BadFile.
    """
    own: Scale | None = getattr(camera, "scale", None)
    if own is not None:
        return own
    tables = files.read_toml(path())
    if camera.name not in tables:
        raise NotCalibrated(f"no scale is saved for {camera.name} ({path()}): run `mirrormount camera scale`")
    scale = _parsed(tables[camera.name], f"{path()}: [{camera.name}]")
    if Size(scale.width, scale.height) != camera.size:
        was = Size(scale.width, scale.height)
        raise NotCalibrated(
            f"the scale of {camera.name} is of {was} pixels, and the camera has {camera.size}:"
            " run `mirrormount camera scale` again"
        )
    return scale


def read_if_any(camera: Camera, tell: Callable[[str], object]) -> Scale | None:
    """As read(); None where that raises NotCalibrated. tell() gets the reason where a scale is saved all the same."""
    try:
        return read(camera)
    except NotCalibrated as e:
        if camera.name in files.read_toml(path()):
            tell(str(e))
        return None


def _parsed(table: object, where: str) -> Scale:
    if not isinstance(table, Mapping):
        raise BadFile(f"{where} is not a table")
    for key, value in table.items():
        known = key in Scale.__dataclass_fields__
        if not known or isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e9:
            raise BadFile(f"{where} {key}: {'not a number from 0 to 1e9' if known else 'not known'}")
    try:
        scale = Scale(**table)
    except TypeError as e:
        raise BadFile(f"{where}: width, height, mm_per_px and sigma_mm_per_px are needed") from e
    if not scale.mm_per_px or scale.distance_mm == 0 or (scale.incidence_deg or 0) >= 90:
        raise BadFile(f"{where}: mm_per_px and distance_mm are above 0, incidence_deg is below 90")
    return scale


def _relative(number: Measured) -> float:
    return abs(number.sigma / number.value) if number.value else 0.0


def _product(a: Measured, b: Measured) -> Measured:
    return Measured(a.value * b.value, math.hypot(a.sigma * b.value, b.sigma * a.value))


# ---- estimates in the units of a scale


@dataclass(frozen=True)
class Optics:
    """The scale of the camera; None: not known."""

    scale: Scale | None = None

    @property
    def distance_mm(self) -> float | None:
        """From the mirror to the camera's plane; None: not known."""
        return self.scale.distance_mm if self.scale else None

    def mm(self, px: Estimate) -> Estimate | None:
        """A length in the camera's plane."""
        return _estimate(self.scale.mm(_measured(px)), 1.0, "mm", px) if self.scale else None

    def beam_urad(self, px: Estimate) -> Estimate | None:
        """An angle of the beam."""
        if self.scale is None or self.distance_mm is None:
            return None
        return _estimate(self.scale.beam_mrad(_measured(px)), 1000.0, "urad", px)

    def mirror_urad(self, px: Estimate, axis: str) -> Estimate | None:
        """An angle of the mirror, for a horizontal beam: x turns it in the plane of incidence, y across that."""
        if self.scale is None or self.distance_mm is None or (axis != "x" and self.scale.incidence_deg is None):
            return None
        return _estimate(self.scale.mirror_mrad(_measured(px), in_plane=axis == "x"), 1000.0, "urad", px)

    def per_px(self, unit: str, axis: str) -> float | None:
        """How much of a unit of OF_PX one pixel is; None: the scale is not known."""
        convert, of_unit = OF_PX[unit]
        one = convert(self, Estimate(1.0, 0.0, "px"), axis)
        return one.value * of_unit if one else None

    def shown(self, px: Estimate) -> Estimate:
        """In the best unit that is known: urad of the beam, else mm, else px."""
        return self.beam_urad(px) or self.mm(px) or px

    def to_json(self) -> dict[str, float | None] | None:
        """What is known."""
        return asdict(self.scale) if self.scale else None


# units of lengths in the picture and of angles (as in values.py), with what of Optics has how much of them
OF_PX: Mapping[str, tuple[Callable[[Optics, Estimate, str], Estimate | None], float]] = {
    "px": (lambda _optics, px, _axis: px, 1.0),
    "mm": (lambda optics, px, _axis: optics.mm(px), 1.0),
    "urad": (lambda optics, px, axis: optics.mirror_urad(px, axis), 1.0),
    "mrad": (lambda optics, px, axis: optics.mirror_urad(px, axis), 1e-3),
    "beam-urad": (lambda optics, px, _axis: optics.beam_urad(px), 1.0),
    "beam-mrad": (lambda optics, px, _axis: optics.beam_urad(px), 1e-3),
}


def _measured(px: Estimate) -> Measured:
    return Measured(px.value, px.error)


def _estimate(measured: Measured, factor: float, unit: str, px: Estimate) -> Estimate:
    """px: what was converted; of px/sqrt(s) the unit is such a rate, too."""
    return Estimate(measured.value * factor, measured.sigma * factor, unit + px.unit.removeprefix("px"), px.count)
