"""Cameras by their addresses: webcams, cameras of the network, files, and cameras of a virtual table."""

import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self

from mirrormount.device import table_file
from mirrormount.device.table_file import AUTOMATIC, CameraSettings
from mirrormount.errors import BadAddress, BadValue
from mirrormount.markup import html_text
from mirrormount.terminal import printable
from mirrormount.transport.ports import TABLE_SCHEMES, open_table
from mirrormount.values import is_name
from mirrormount_beam import genicam
from mirrormount_beam.camera import Camera, Controls, Image, Limits, Size
from mirrormount_beam.errors import CameraAbsent
from mirrormount_beam.observe import SETTLE_S, SpotObserver
from mirrormount_beam.recordings import Folder, open_file, read_mask
from mirrormount_beam.scale import Scale
from mirrormount_beam.selection import Selection
from mirrormount_beam.spot.find import NoSpot, Spot, find_spot
from mirrormount_beam.spot.picture import as_png, html_picture
from mirrormount_beam.webcams import open_webcam


def open_camera(
    address: str,
    *,
    limits: Limits = Limits(),  # noqa: B008
    settings: CameraSettings = CameraSettings(),  # noqa: B008
) -> Camera:
    """Open a camera.

    address: an index ("0"), a device (/dev/video0), a part of a webcam's name or place, http://… or rtsp://…,
    genicam:// with a part of a scientific camera's name, a folder, a file with pictures, a video, or virtual-table://…,
    with #2 for the second camera of the table; or a camera's name in table.toml. limits: of a webcam. settings: those
    that table.toml has hold where these say nothing.
    Raises BadAddress, BadFile, BadValue, CameraError, CannotOpen, ExtraMissing.
    """
    entry = _known(address)
    settings = settings.over(entry.settings)
    camera = _opened(entry.camera, limits, settings)
    try:
        select(camera, settings)
    except BaseException:
        camera.close()
        raise
    return camera


class SpotCamera:
    """A camera that is asked for the spot.

    with SpotCamera.open("0") as camera:
        spot = camera.spot()

    camera: the Camera itself, for all else. last: the image that spot() has looked at last, and what was in it.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.last: tuple[Image, Spot | NoSpot] | None = None
        self._lock = threading.Lock()  # a cell of a notebook and the page of show() may ask at the same time
        settle_s = 0.0 if isinstance(camera, Folder) else SETTLE_S  # no mount moves the beam in pictures of files
        self._observer = SpotObserver(camera, settle_s=settle_s)

    @classmethod
    def open(cls, address: str, settings: CameraSettings = CameraSettings()) -> Self:  # noqa: B008
        """Open a camera by its address. Raises what open_camera() raises."""
        return cls(open_camera(address, settings=settings))

    def spot(self) -> Spot | NoSpot:
        """The spot, or why there is none, in an image that is exposed from now on, when a mount that moved has settled.

        Of files it is the next picture. Raises CameraError, also if no such image comes or the files are at their end.
        """
        with self._lock:
            image = self._observer.settled()
            found = find_spot(image)
            self.last = image, found
        return found

    def png(self) -> bytes | None:
        """The last image with the spot drawn into it; None before the first. The camera is not asked."""
        if not self.last:
            return None
        image, found = self.last
        return as_png(image.selection.shown(image.image), found)

    def _repr_html_(self) -> str:
        picture = self.png()
        name = html_text(self.camera.name)
        return (
            f"{html_picture(picture, 'the last picture')}<p>{name}</p>" if picture else f"<p>{name}: not asked yet</p>"
        )

    def close(self) -> None:
        """Release the camera."""
        self.camera.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def select(camera: Camera, settings: CameraSettings) -> None:
    """Say what of the camera's pictures is looked at. Raises BadValue, CameraError."""
    mask = read_mask(Path(settings.mask)) if settings.mask else None
    selection = Selection(settings.region, mask, settings.channel or AUTOMATIC, settings.contrast or 0.0)
    selection.part((camera.size.height, camera.size.width))
    camera.selection = selection


def _opened(address: str, limits: Limits, settings: CameraSettings) -> Camera:
    is_file = os.path.isdir(address) or os.path.isfile(address)
    if settings.asked_of_webcam and (is_file or _is_of_table(address)):
        raise BadValue(f"{printable(address)} is no webcam: it has no {', '.join(settings.asked_of_webcam)} to set")
    if _is_of_table(address):
        return _of_table(address)
    if is_file:
        return open_file(address)
    scheme, mark, part = address.partition("://")
    if mark and scheme == genicam.SCHEME:
        return genicam.open_genicam(part, limits=limits, settings=settings)
    return open_webcam(address, limits=limits, settings=settings)


def open_beside_mount(address: str, settings: CameraSettings = CameraSettings()) -> Camera:  # noqa: B008
    """As open_camera(), for a mount opened by itself. Raises BadAddress for a camera of a virtual table, too."""
    if _is_of_table(_known(address).camera):
        raise BadAddress(
            f"{printable(address)} sees the mounts of its own table only: a command with --virtual has both, and 1 or 2"
            " is the camera"
        )
    return open_camera(address, settings=settings)


def _known(address: str) -> table_file.CameraEntry:
    """What a name in table.toml stands for, else the address itself. Raises BadAddress, BadFile."""
    if not address.strip():
        raise BadAddress("the camera's name is empty: leave it out, or give one (see: mirrormount camera list)")
    entry = table_file.read().cameras.get(address) if is_name(address) else None
    return entry or table_file.CameraEntry(address)


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
    def selection(self) -> Selection:
        return self._camera.selection

    @selection.setter
    def selection(self, selection: Selection) -> None:
        self._camera.selection = selection

    @property
    def scale(self) -> Scale | None:
        return getattr(self._camera, "scale", None)

    def frames(self) -> Iterator[Image]:
        return self._camera.frames()

    def monotonic(self) -> float:
        return self._camera.monotonic()

    def close(self) -> None:
        self._camera.close()
        self._close_owner()
