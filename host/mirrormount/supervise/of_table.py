"""The mounts that table.toml names, each with a supervisor; two mounts on one board share one."""

from collections.abc import Mapping

from mirrormount.common.axis_names import axis_name, paired
from mirrormount.device.table_file import MountEntry
from mirrormount.supervise.supervisor import Supervisor

Supervised = tuple[Supervisor, tuple[str, str]]  # the names that its axes x and y have there


def supervised(entries: Mapping[str, MountEntry], patience_s: float) -> dict[str, Supervised]:
    """Supervisors, not open yet: one for each board, under the name of its first mount, which finds it on any port."""
    boards: dict[str, tuple[Supervisor, int]] = {}
    mounts: dict[str, Supervised] = {}
    for name, entry in entries.items():
        key = entry.board.upper() if entry.board else f"port {entry.port}"
        supervisor, x_axis = boards.setdefault(key, (Supervisor(name, patience_s=patience_s), entry.x_axis))
        axes = axis_name(entry.x_axis, x_axis), axis_name(paired(entry.x_axis), x_axis)
        mounts[name] = supervisor, axes
    return mounts
