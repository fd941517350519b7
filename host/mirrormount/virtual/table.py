"""The optical table: a laser that drifts, mirrors on virtual mounts, and the places of the cameras.

A test may ask it for the truth (spots_mm, mirrors_urad); the product sees it through cameras only, and moves it by
pins only. Units: millimetres in the cameras' planes, microradians of a mirror, seconds of the table's time.
"""

from collections.abc import Callable, Sequence

import numpy as np

from mirrormount.virtual.geometry import BeamPath, Geometry, Spot
from mirrormount.virtual.wander import Wander

LASER_DRIFT_URAD = 3.0  # of the beam's direction after one second, either way, growing as its root; assumed
LASER_JITTER_URAD = 1.0  # of the beam's direction; assumed
MOUNT_DRIFT_URAD = 0.1  # of a mirror after one second; assumed
MOUNT_JITTER_URAD = 0.3  # of a mirror, from the table's vibration; assumed
_MOST_ON_MIRROR_MM = 7.0  # from a mirror's middle: the rest of its radius is for what the mounts do
Mount = Callable[[], list[tuple[float, float]]]
_OFF_MM, _OFF_MRAD = 1.0, 0.8  # a laser that was put down by hand: its offset and angle, before they are scaled


class Laser:
    """The beam's source. Set blocked to stop the beam; offset_mm and angle_urad to displace it."""

    def __init__(self, wander: Wander) -> None:
        self.wander = wander
        self.blocked = False
        self.offset_mm = (0.0, 0.0)
        self.angle_urad = (0.0, 0.0)

    def angle_rad(self, time_s: float) -> tuple[float, float]:
        """The beam's direction, right and up."""
        right, up = self.wander.at(time_s)
        return right + self.angle_urad[0] * 1e-6, up + self.angle_urad[1] * 1e-6


class Table:
    """Laser, mirrors, planes.

    mounts: for each board, in the order of the beam, what returns yaw and pitch of its mirrors now, in radians;
    mirrors: how many they are together.
    """

    def __init__(self, mounts: Sequence[Mount], mirrors: int, geometry: Geometry, seed: int) -> None:
        sources = [np.random.default_rng(source) for source in np.random.SeedSequence(seed).spawn(1 + mirrors)]
        self._mounts = mounts
        self.geometry = geometry
        self.laser = Laser(Wander(sources[0], LASER_DRIFT_URAD, LASER_JITTER_URAD))
        self.vibrations = [Wander(source, MOUNT_DRIFT_URAD, MOUNT_JITTER_URAD) for source in sources[1:]]
        self._knocked = [(0.0, 0.0)] * mirrors
        self._path = BeamPath(mirrors, geometry)

    def bump(self, mirror: int, yaw_urad: float, pitch_urad: float) -> None:
        """Knock a mount: its mirror is turned by so much, at once and for good."""
        yaw, pitch = self._knocked[mirror]
        self._knocked[mirror] = yaw + yaw_urad * 1e-6, pitch + pitch_urad * 1e-6

    def misalign(self, off_mm: float, noise: np.random.Generator) -> None:
        """Displace the laser at random, so that the farthest spot is off_mm from its centre, right or up.

        Offset and angle that nearly cancel at the cameras would be so large that the beam nearly misses a mirror:
        others are drawn then.
        """
        self._displace(off_mm, noise)
        while self._off_mirrors_mm() > _MOST_ON_MIRROR_MM:
            self._displace(off_mm, noise)

    def _off_mirrors_mm(self) -> float:
        """How far from a mirror's middle the displaced beam hits, for small angles."""
        ways_m = (self.geometry.laser_m, self.geometry.laser_m + self.geometry.between_m)[: len(self.vibrations)]
        pairs = zip(self.laser.offset_mm, self.laser.angle_urad, strict=True)
        return max(abs(mm + urad * 1e-3 * way_m) for mm, urad in pairs for way_m in ways_m)

    def _displace(self, off_mm: float, noise: np.random.Generator) -> None:
        drawn = noise.standard_normal(4)
        offset, angle = drawn[:2] * _OFF_MM, drawn[2:] * _OFF_MRAD * 1e-3
        rest = [(0.0, 0.0)] * len(self.vibrations)
        small = 0.1  # of the angle: the beam must not miss a mirror
        spots = self._path.spots(tuple(offset * small), tuple(angle * small), rest)
        scale = small * off_mm / max(abs(x) for spot in spots if spot is not None for x in spot)
        self.laser.offset_mm = float(offset[0] * scale), float(offset[1] * scale)
        self.laser.angle_urad = float(angle[0] * scale * 1e6), float(angle[1] * scale * 1e6)

    def mirrors_rad(self, time_s: float) -> list[tuple[float, float]]:
        """Yaw and pitch of each mirror."""
        driven = [angles for mount in self._mounts for angles in mount()]
        angles = []
        for (yaw, pitch), (knocked_yaw, knocked_pitch), wander in zip(
            driven, self._knocked, self.vibrations, strict=True
        ):
            shaken_yaw, shaken_pitch = wander.at(time_s)
            angles.append((yaw + knocked_yaw + shaken_yaw, pitch + knocked_pitch + shaken_pitch))
        return angles

    def spots_mm(self, time_s: float) -> list[Spot]:
        """The spot in each camera's plane, (right, up) of its centre; None where no light comes."""
        angle, mirrors = self.laser.angle_rad(time_s), self.mirrors_rad(time_s)
        if self.laser.blocked:
            return [None] * len(self.geometry.cameras_m)
        return self._path.spots(self.laser.offset_mm, angle, mirrors)

    def mirrors_urad(self, time_s: float) -> list[tuple[float, float]]:
        """Yaw and pitch of each mirror in microradians."""
        return [(yaw * 1e6, pitch * 1e6) for yaw, pitch in self.mirrors_rad(time_s)]
