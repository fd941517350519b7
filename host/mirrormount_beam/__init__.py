"""The beam, seen by cameras: images, the spot in them, and its scale in millimetres and milliradians.

from mirrormount_beam import Table, find_spot
spot = find_spot(picture)
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mirrormount_beam.camera import Dark
    from mirrormount_beam.spot.find import NoSpot, NoSpotReason, Spot, find_spot
    from mirrormount_beam.table import Table

__all__ = ["Dark", "NoSpot", "NoSpotReason", "Spot", "Table", "find_spot"]


def __getattr__(name: str) -> object:
    """The public names, imported at their first use: the types of cameras need no OpenCV."""
    if name == "Table":
        from mirrormount_beam.table import Table

        return Table
    if name == "Dark":
        from mirrormount_beam.camera import Dark

        return Dark
    if name in __all__:
        from mirrormount_beam.spot import find

        return getattr(find, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
