"""How many mrad of the mirror a step is, where that is known: for a position in mrad beside the one in steps."""

from mirrormount.common.errors import BadFile, NotCalibrated
from mirrormount.device import calibration
from mirrormount.device.mount import Mount
from mirrormount.device.settings import AXES

Scales = dict[str, float | None]


def read(mount: Mount) -> Scales:
    """mrad a step of each axis: the mean of both directions; None where it was not measured with today's step."""
    return {name: _of_axis(mount, name) for name in AXES}


def _of_axis(mount: Mount, name: str) -> float | None:
    axis = getattr(mount, name)
    step = calibration.Step(*axis.ask_whole("XP?", "XD?", "XI?"))
    try:
        both = [calibration.mrad_per_step(mount.board_id, axis.number, name, way, step) for way in (1, -1)]
    except (NotCalibrated, BadFile):
        return None
    return sum(both) / 2
