"""The interface of a virtual board's port in real time, its input queue, and the port in this process."""

import socket
from typing import Protocol

BUFFER = 512  # bytes in the board's input before the host has to wait
WAITING_MOST = 1 << 20  # bytes of a client that may wait for the board


class Waiting:
    """Received bytes that the board has no room for. A stop overtakes them, and makes those before it void."""

    def __init__(self) -> None:
        self.bytes = bytearray()

    def add(self, data: bytes) -> None:
        """Append received bytes."""
        waited = len(self.bytes)
        self.bytes += data
        stop = max(self.bytes.rfind(b"!", waited), self.bytes.rfind(b"00000000", max(0, waited - 7)))
        stop = max(stop, self.bytes.rfind(b"\x03", waited))  # Ctrl-C: it turns off as well
        if stop > BUFFER:
            self.bytes[:stop] = b"!\n"  # the board may be in the middle of a message: this ends it

    def keep_stop(self) -> None:
        """Of what waits only a stop counts: who wrote it has left without having been served."""
        stops = any(stop in self.bytes for stop in (b"!", b"00000000", b"\x03"))
        self.bytes[:] = b"!\n" if stops else b""

    def take(self, most: int) -> bytes:
        """The next bytes for the board."""
        data = bytes(self.bytes[:most])
        del self.bytes[:most]
        return data


class Port(Protocol):
    """A port for one client. No method blocks."""

    @property
    def address(self) -> str: ...

    def watched(self) -> list[int]:
        """File descriptors to wait for."""
        ...

    def take(self, most: int, *, at_prompt: bool = False) -> bytes:
        """Received bytes: commands, or Python while the board is at its prompt."""
        ...

    @property
    def waits(self) -> bool:
        """True if take() returns bytes although no file descriptor is readable."""
        ...

    def give(self, data: bytes) -> int:
        """Send bytes to the client. Returns how many were sent."""
        ...

    def connected(self) -> bool: ...

    def plug(self, there: bool) -> None:
        """The board's USB is there, or not any more."""
        ...

    def refuse(self, text: str) -> None:
        """Send the text as a line to a client of this port and drop its input: another port's client is served."""
        ...

    def waits_in_vain(self) -> None:
        """Another port's client is served. If this port's has left meanwhile, only a stop of its input counts."""
        ...

    @property
    def prompt(self) -> bool:
        """True if clients of this port may use the board's Python prompt."""
        ...

    def close(self) -> None: ...


class PairPort:
    """One end of a socket pair whose other end is in this process."""

    prompt = True
    waits = False

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        end.setblocking(False)
        self.address = "virtual://"

    def watched(self) -> list[int]:
        return [self._end.fileno()]

    def connected(self) -> bool:
        return True

    def plug(self, there: bool) -> None:
        pass

    def take(self, most: int, *, at_prompt: bool = False) -> bytes:
        try:
            return self._end.recv(most)
        except OSError:
            return b""

    def give(self, data: bytes) -> int:
        try:
            return self._end.send(data)
        except OSError:
            return 0

    def refuse(self, text: str) -> None:
        pass

    def waits_in_vain(self) -> None:
        pass

    def close(self) -> None:
        self._end.close()
