"""mirrormount: drive a motorised mirror mount from Python.

from mirrormount import Mount
with Mount.open() as mount:
    mount.x.step(5)
"""

from mirrormount.errors import MountError
from mountfw import __version__

TYPE_CHECKING = False  # typing has it, too, and takes longer than all else here
if TYPE_CHECKING:
    from mirrormount.device.mount import Mount
    from mirrormount.device.status import Limits

__all__ = ["Limits", "Mount", "MountError", "__version__"]


def __getattr__(name: str) -> object:
    """Limits and Mount, imported at their first use: `mirrormount stop` asks a running program without them."""
    if name in ("Limits", "Mount"):
        from mirrormount.device import mount

        return getattr(mount, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), "Limits", "Mount"]
