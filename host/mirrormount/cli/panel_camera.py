"""The camera of `mirrormount panel`: a real one beside any board, or one of a virtual table with its mount."""

import argparse
import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from mirrormount.cli.command import from_extra, virtual_address, virtual_camera
from mirrormount.transport.open import TABLE_SCHEMES

if TYPE_CHECKING:
    from mirrormount.beam.live import LiveCamera
    from mirrormount.panel.camera_view import CameraView
    from mirrormount.supervise.reconnect import Address


@contextlib.contextmanager
def opened(args: argparse.Namespace, address: str | None) -> "Iterator[tuple[Address, CameraView[LiveCamera] | None]]":
    """Where the board is, and the camera; None without one. Raises MountError."""
    if args.camera is None:
        yield address, None
        return
    with from_extra("camera", "cameras need"):
        from mirrormount.beam.live import LiveCamera
        from mirrormount.beam.open_camera import open_camera
        from mirrormount.panel.camera_view import CameraView
    if args.virtual:
        with _on_table(args) as found:
            yield found
        return
    name: str = in_real_time(args.camera)
    live = LiveCamera(name, lambda: open_camera(name))
    with contextlib.closing(live):
        live.open()
        yield address, CameraView(live)


def in_real_time(camera: str) -> str:
    """A camera's address; that of a virtual table which says nothing else runs by the wall clock."""
    table, mark, number = camera.partition("#")
    if table.partition("://")[0] in TABLE_SCHEMES and "speed=" not in table:
        table += ("&" if "?" in table else "?") + "speed=1"
    return table + mark + number


@contextlib.contextmanager
def _on_table(args: argparse.Namespace) -> "Iterator[tuple[Address, CameraView[LiveCamera] | None]]":
    """The mount of a virtual table, and one of its two cameras."""
    from mirrormount.beam.live import LiveCamera
    from mirrormount.panel.camera_view import CameraView
    from mirrormount.virtual.table import open_table

    which = virtual_camera(args.camera)
    table = open_table(virtual_address(args, "virtual-table", mounts="1", speed="1") or "")
    with contextlib.closing(table):
        camera = table.cameras[which - 1]
        live = LiveCamera(camera.name, lambda: camera)
        with contextlib.closing(live):
            live.open()
            ports = iter([table.ports[0]])
            yield lambda: next(ports, None) or table.replug(0), CameraView(live)
