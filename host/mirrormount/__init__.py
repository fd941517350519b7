"""mirrormount: drive a motorised mirror mount from Python.

    from mirrormount import Mount
    with Mount.open() as mount:
        mount.x.step(5)
"""

from mountfw import __version__

from mirrormount.client import Mount
from mirrormount.errors import MountError

__all__ = ["Mount", "MountError", "__version__"]
