"""The interface of an open port to a board: bytes in, bytes out. Imports nothing."""

from typing import Protocol

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
