"""The beam, seen by cameras: images, the spot in them, and its scale in millimetres and milliradians.

from mirrormount_beam import SpotCamera
with SpotCamera.open("0") as camera:
    spot = camera.spot()
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mirrormount_beam.camera import Dark
    from mirrormount_beam.cameras import SpotCamera, open_camera
    from mirrormount_beam.spot.find import NoSpot, NoSpotReason, Spot, find_spot
    from mirrormount_beam.table import Table

__all__ = ["Dark", "NoSpot", "NoSpotReason", "Spot", "SpotCamera", "Table", "find_spot", "open_camera"]


def __getattr__(name: str) -> object:
    """The public names, imported at their first use: the types of cameras need no OpenCV."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "Table":
        from mirrormount_beam import table as module
    elif name == "Dark":
        from mirrormount_beam import camera as module
    elif name in ("SpotCamera", "open_camera"):
        from mirrormount_beam import cameras as module
    else:
        from mirrormount_beam.spot import find as module
    return getattr(module, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
