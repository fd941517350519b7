"""The beam, seen by cameras: frames, the spot in them, and its scale in millimetres and milliradians.

from mirrormount.beam import Table, find_spot
spot = find_spot(picture)
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mirrormount.beam.spot import Dark, NoSpot, Reason, Spot, find_spot
    from mirrormount.beam.table import Table

__all__ = ["Dark", "NoSpot", "Reason", "Spot", "Table", "find_spot"]


def __getattr__(name: str) -> object:
    """The public names, imported at their first use: the types of cameras need no OpenCV."""
    if name == "Table":
        from mirrormount.beam.table import Table

        return Table
    if name in __all__:
        from mirrormount.beam import spot

        return getattr(spot, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
