"""mirrormount: drive a motorised mirror mount from Python.

from mirrormount import Mount
with Mount.open() as mount:
    mount.x.step(5)
"""

from mirrormount.common.errors import MountError
from mirrormount.device.mount import Limits, Mount
from mountfw import __version__

__all__ = ["Limits", "Mount", "MountError", "__version__"]
