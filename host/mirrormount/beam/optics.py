"""Estimates in pixels as lengths, angles of the beam and angles of the mirror, where a camera has a scale."""

from collections.abc import Callable, Mapping
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


# units of lengths in the picture and of angles (as in common/units.py), with what of Optics has how much of them
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
