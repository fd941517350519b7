"""The scales of a mount's axes, for angles and lengths beside steps."""

from dataclasses import dataclass

from mirrormount.common import units
from mirrormount.common.errors import BadFile, NotCalibrated
from mirrormount.device import calibration
from mirrormount.device.mount import Mount


@dataclass(frozen=True, slots=True)
class AxisScale:
    """One step in mrad of the mirror, of the beam, mm on the screen: the means of both directions. None: not known.

    beam_mrad and screen_mm need the angle of incidence and the distance of the screen beside the mirror's scale.
    """

    mirror_mrad: float
    beam_mrad: float | None = None
    screen_mm: float | None = None


Scales = dict[str, AxisScale | None]


def read(mount: Mount) -> Scales:
    """The scale of each axis; None if not measured for the present step. Raises MountError."""
    return {name: _of_axis(mount, name) for name in mount.by_name}


def _of_axis(mount: Mount, name: str) -> AxisScale | None:
    axis = mount.axis(name)
    step = calibration.Step(*axis.ask_whole("XP?", "XD?", "XI?"))
    try:
        (scale, positive), (_, negative) = (
            calibration.scale_of(mount.board_id, axis.number, name, way, step) for way in (1, -1)
        )
    except (NotCalibrated, BadFile):
        return None
    mirror_mrad = (positive + negative) / 2
    beam_mrad, screen_mm = (_converted(scale, mirror_mrad, unit, name) for unit in ("beam-mrad", "mm"))
    return AxisScale(mirror_mrad, beam_mrad, screen_mm)


def _converted(scale: calibration.Scale, mirror_mrad: float, unit: str, name: str) -> float | None:
    try:
        return units.per_step(scale, mirror_mrad, unit, name)
    except NotCalibrated:
        return None
