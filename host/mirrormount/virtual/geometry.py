"""The beam's way over an optical table, in three dimensions: laser, folding mirrors, planes of cameras.

The table is the plane of x and z; y is up. Each mirror folds the beam by 90 degrees, in turn to the left and to the
right. A plane's coordinates are (right, up) as seen along the beam, from where the beam hits it with all mirrors at
rest. Lengths in metres, coordinates in the planes in millimetres, angles in radians.
"""

import math
from dataclasses import dataclass

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
