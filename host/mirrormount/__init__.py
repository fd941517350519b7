"""mirrormount: drive a motorised mirror mount from Python.

from mirrormount import Mount
with Mount.open() as mount:
    mount.x.step(5)
"""

from mirrormount.client import Limits, Mount
from mirrormount.errors import MountError
from mountfw import __version__

__all__ = ["Limits", "Mount", "MountError", "__version__"]
