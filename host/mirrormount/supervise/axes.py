"""The axes of a mount by their names, in the order of the panel."""

from mirrormount.device.mount import Mount
from mirrormount.device.status import AxisStatus, Status


def axis_names(mount: Mount) -> tuple[str, ...]:
    """The names of all axes, those of the pad first: x, y."""
    return tuple(mount.by_name)


def axis_status(status: Status | None, name: str) -> AxisStatus | None:
    """The status of the axis of that name; None if unknown."""
    return status.by_name.get(name) if status else None
