"""Estimates in pixels as lengths, angles of the beam and angles of the mirror, where a camera has a scale."""

from dataclasses import asdict, dataclass

from mirrormount.beam.estimate import Estimate
from mirrormount.beam.scale import Measured, Scale


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
        if self.scale is None or self.distance_mm is None:
            return None
        return _estimate(self.scale.mirror_mrad(_measured(px), in_plane=axis == "x"), 1000.0, "urad", px)

    def shown(self, px: Estimate) -> Estimate:
        """In the best unit that is known: urad of the beam, else mm, else px."""
        return self.beam_urad(px) or self.mm(px) or px

    def to_json(self) -> dict[str, float | None] | None:
        """What is known."""
        return asdict(self.scale) if self.scale else None


def _measured(px: Estimate) -> Measured:
    return Measured(px.value, px.error)


def _estimate(measured: Measured, factor: float, unit: str, px: Estimate) -> Estimate:
    return Estimate(measured.value * factor, measured.sigma * factor, unit, px.count)
