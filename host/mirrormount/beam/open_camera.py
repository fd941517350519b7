"""Opens a camera by its address: a webcam, a folder of pictures, a recording, or one of a virtual table."""

import os
from collections.abc import Callable, Iterator

from mirrormount.beam.camera import Camera, Controls, Frame, Size
from mirrormount.beam.checked import Limits
from mirrormount.beam.recording import open_folder
from mirrormount.beam.scale import Scale
from mirrormount.beam.webcam import open_webcam
from mirrormount.common.beam_errors import CameraAbsent
from mirrormount.common.errors import BadAddress
from mirrormount.common.names import is_name
from mirrormount.common.printable import printable
from mirrormount.device import table_file
from mirrormount.transport.open import TABLE_SCHEMES, open_table


def open_camera(address: str, *, limits: Limits = Limits()) -> Camera:  # noqa: B008
    """Open a camera.

    address: an index ("0"), a device (/dev/video0), a part of a webcam's name, a folder, or virtual-table://…, with #2
    for the second camera of the table; or a camera's name in table.toml. limits: of a webcam. Raises BadAddress,
    BadFile, CameraError, CannotOpen.
    """
    address = _known(address)
    if _is_of_table(address):
        return _of_table(address)
    if os.path.isdir(address):
        return open_folder(address)
    return open_webcam(address, limits=limits)


def open_beside_mount(address: str) -> Camera:
    """As open_camera(), for a mount opened by itself. Raises BadAddress for a camera of a virtual table, too."""
    if _is_of_table(_known(address)):
        raise BadAddress(
            f"{printable(address)} sees the mounts of its own table only: give --virtual, and 1 or 2 as the camera"
        )
    return open_camera(address)


def _known(address: str) -> str:
    """The address that a name in table.toml stands for. Raises BadAddress, BadFile."""
    if not address.strip():
        raise BadAddress("the camera's name is empty: leave it out, or give one (see: mirrormount camera list)")
    entry = table_file.read().cameras.get(address) if is_name(address) else None
    return entry.camera if entry else address


def _is_of_table(address: str) -> bool:
    return address.partition("://")[0] in TABLE_SCHEMES


def _of_table(address: str) -> Camera:
    table_address, _, number = address.partition("#")
    table = open_table(table_address)
    try:
        if number and not (number.isascii() and number.isdigit() and len(number) < 10):
            raise BadAddress(f"after # comes the camera's number, 1 to {len(table.cameras)}, not {number[:20]!r}")
        at = int(number or 1)
        if not 1 <= at <= len(table.cameras):
            raise CameraAbsent(f"{table_address}: it has {len(table.cameras)} cameras, no number {at}")
        return _Owned(table.cameras[at - 1], table.close)
    except BaseException:
        table.close()
        raise


class _Owned:
    """A camera that is closed with all that was opened for it."""

    def __init__(self, camera: Camera, close: Callable[[], None]) -> None:
        self._camera = camera
        self._close_owner = close

    @property
    def name(self) -> str:
        return self._camera.name

    @property
    def size(self) -> Size:
        return self._camera.size

    @property
    def controls(self) -> Controls:
        return self._camera.controls

    @property
    def scale(self) -> Scale | None:
        return getattr(self._camera, "scale", None)

    def frames(self) -> Iterator[Frame]:
        return self._camera.frames()

    def monotonic(self) -> float:
        return self._camera.monotonic()

    def close(self) -> None:
        self._camera.close()
        self._close_owner()
