"""The scales of a mount's axes, for a position in mrad beside the one in steps."""

from mirrormount.common.errors import BadFile, NotCalibrated
from mirrormount.device import calibration
from mirrormount.device.mount import Mount

Scales = dict[str, float | None]


def read(mount: Mount) -> Scales:
    """mrad of the mirror a step, for each axis: the mean of both directions; None if not measured for the present step.

    Raises MountError.
    """
    return {name: _of_axis(mount, name) for name in mount.by_name}


def _of_axis(mount: Mount, name: str) -> float | None:
    axis = mount.axis(name)
    step = calibration.Step(*axis.ask_whole("XP?", "XD?", "XI?"))
    try:
        both = [calibration.scale_of(mount.board_id, axis.number, name, way, step)[1] for way in (1, -1)]
    except (NotCalibrated, BadFile):
        return None
    return sum(both) / 2
