"""Table: the mounts and cameras that table.toml names, open and supervised.

with Table.open() as table, table.loop("my loop") as loop:   # what align and hold need
    loop.take_control()
"""

import contextlib
from collections.abc import Mapping
from functools import partial
from types import TracebackType
from typing import Self

from mirrormount.beam import scale
from mirrormount.beam.eyes import CameraEye
from mirrormount.beam.open_camera import open_camera
from mirrormount.beam.supervised import SupervisedTable
from mirrormount.common.errors import BadFile, NotCalibrated
from mirrormount.common.keep_alive import PATIENCE_S
from mirrormount.device import table_file
from mirrormount.device.table_file import CameraEntry
from mirrormount.supervise.of_table import Supervised, supervised


class Table:
    """An open table. supervisors: by the name of the mount; two mounts on one board share one. eyes: by name.

    Use open(), and close() or `with`.
    """

    def __init__(self, mounts: Mapping[str, Supervised], eyes: Mapping[str, CameraEye]) -> None:
        self.supervisors = {name: supervisor for name, (supervisor, _) in mounts.items()}
        self.axes = {name: axes for name, (_, axes) in mounts.items()}
        self.eyes = dict(eyes)
        self._closing = contextlib.ExitStack()

    @classmethod
    def open(cls, patience_s: float = PATIENCE_S) -> Self:
        """Open all mounts and cameras of the table's file; motors that moved are stopped.

        patience_s: silence of a loop after which what it moves is stopped.
        Raises BadFile if it names none, NotCalibrated for a camera without a scale, CameraError, and as Mount.open().
        """
        table = table_file.read()
        for what, entries in (("mount", table.mounts), ("camera", table.cameras)):
            if not entries:
                raise BadFile(f"{table_file.path()} names no {what}: `mirrormount table {what} NAME` gives it a name")
        with contextlib.ExitStack() as opened:
            eyes = {}
            for name, entry in table.cameras.items():
                eyes[name] = _eye(name, entry)
                opened.callback(eyes[name].close)
            mounts = supervised(table.mounts, patience_s)
            for supervisor in dict.fromkeys(supervisor for supervisor, _ in mounts.values()):
                opened.enter_context(supervisor)
            made = cls(mounts, eyes)
            made._closing = opened.pop_all()
            return made

    def loop(self, name: str) -> SupervisedTable:
        """A client of all mounts under a name that people read."""
        mounts = [(mount, supervisor, self.axes[mount]) for mount, supervisor in self.supervisors.items()]
        return SupervisedTable(name, mounts, tuple(self.eyes.values()))

    def stop(self, cause: str = "the program asked for it") -> None:
        """All motors of all mounts off, now; returns at once. Any thread."""
        for supervisor in dict.fromkeys(self.supervisors.values()):
            supervisor.stop(cause)

    def close(self) -> None:
        """Motors off, ports and cameras closed. Raises MountError if motors did not stop."""
        self._closing.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _eye(name: str, entry: CameraEntry) -> CameraEye:
    camera = open_camera(entry.camera)
    try:
        mm_per_px = scale.read(camera).mm_per_px
    except NotCalibrated as e:
        camera.close()
        raise NotCalibrated(f"{name}: {e}; errors are told in um, so it is needed: `mirrormount camera scale`") from e
    except BaseException:
        camera.close()
        raise
    middle = (camera.size.width - 1) / 2, (camera.size.height - 1) / 2
    um = 1000 * mm_per_px
    distance_m = None if entry.distance_mm is None else entry.distance_mm / 1000
    return CameraEye(
        name, camera, entry.target_px or middle, (um, um), distance_m, reopen=partial(open_camera, entry.camera)
    )
