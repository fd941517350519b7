"""The beam, seen by cameras: frames, the spot in them, and its scale in millimetres and milliradians.

from mirrormount.beam import find_spot
spot = find_spot(picture)
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mirrormount.beam.picture import Dark
    from mirrormount.beam.reasons import Reason
    from mirrormount.beam.spot import NoSpot, Spot, find_spot

__all__ = ["Dark", "NoSpot", "Reason", "Spot", "find_spot"]

_MODULES = {"Dark": "picture", "Reason": "reasons", "NoSpot": "spot", "Spot": "spot", "find_spot": "spot"}


def __getattr__(name: str) -> object:
    """The public names, imported at their first use: a page that lists cameras needs no fit."""
    if name in _MODULES:
        return getattr(import_module(f"mirrormount.beam.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
