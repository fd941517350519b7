"""A port around a port that passes a copy of its traffic on. Imports port."""

from typing import Protocol

from mirrormount.transport.port import Port


class Log(Protocol):
    """A receiver of the copy."""

    def add(self, data: bytes, *, to_board: bool) -> None: ...


class TappedPort:
    """A port whose traffic is logged."""

    def __init__(self, port: Port, log: Log) -> None:
        self._port = port
        self._log = log
        self.lockstep = port.lockstep

    def read(self, timeout_s: float) -> bytes:
        """As Port.read()."""
        data = self._port.read(timeout_s)
        if data:
            self._log.add(data, to_board=False)
        return data

    def write(self, data: bytes) -> None:
        """As Port.write(). The log gets its copy afterwards: a stop does not wait for it."""
        self._port.write(data)
        self._log.add(data, to_board=True)

    def close(self) -> None:
        """As Port.close()."""
        self._port.close()
