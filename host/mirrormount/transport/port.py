"""The interface of an open port to a board: bytes in, bytes out; and of a table that has several. Imports nothing."""

from collections.abc import Sequence
from typing import Any, Protocol

WRITE_S = 2.0  # longest time that a write waits


class Port(Protocol):
    """An open port. lockstep: time passes only in read() and sleep(), and the port is a ClockedPort."""

    lockstep: bool

    def read(self, timeout_s: float) -> bytes: ...

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class ClockedPort(Port, Protocol):
    """A port with a clock of its own, in seconds."""

    def monotonic(self) -> float: ...

    def sleep(self, seconds: float) -> None: ...


class Table(Protocol):
    """Boards and cameras that share a clock, in seconds.

    A mount is `Mount(Link(port))`; a camera is a mirrormount.beam.camera.Camera, which is of a floor above.
    """

    @property
    def ports(self) -> Sequence[Port]: ...

    @property
    def cameras(self) -> Sequence[Any]: ...

    def now_s(self) -> float: ...

    def sleep(self, seconds: float) -> None:
        """Let the table's time pass."""
        ...

    def close(self) -> None: ...
