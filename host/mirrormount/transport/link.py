"""Lines over a port, with time-outs; and the lines by which a program that serves a board refuses a client.

A link knows no commands. Only one thread at a time exchanges lines; a stop is written to the port beside it.
"""

import threading
import time
from contextlib import AbstractContextManager, nullcontext
from typing import cast

from mirrormount.errors import ConnectionLost, NoAnswer, NotAMount
from mirrormount.transport.ports import ClockedPort, Port

# A New Focus controller on Ethernet begins with these bytes, and some drivers wait for them.
GREETING = bytes((0xFF, 0xFB, 0x01, 0xFF, 0xFB, 0x03))

# These lines refuse a client.
TAKEN = "mirrormount: this board has a client already"
NO_BOARD = "mirrormount: the board is not there"
AT_PROMPT = "mirrormount: the board is at its Python prompt, which is not served on TCP"
NOT_ALLOWED = "mirrormount: this computer may not drive the board (mirrormount serve --allow)"

_LONGEST_LINE = 65536  # bytes; a board's lines have some hundreds
_LATE_S = 0.1  # after this much silence no part of an earlier answer follows


def refusal_line(text: str) -> bytes:
    """A refusal as it goes over the wire."""
    return text.encode() + b"\r\n"


class Link:
    """Lines over a port. One caller at a time: hold `lock` for an exchange."""

    def __init__(self, port: Port) -> None:
        self.port = port
        self.lock = threading.RLock()
        self._clock = cast(ClockedPort, port) if port.lockstep else time
        self._buffer = bytearray()
        self._stale = False  # True: an answer that no caller awaits may still arrive

    @property
    def lockstep(self) -> bool:
        """True if time passes only during read() and sleep()."""
        return self.port.lockstep

    def monotonic(self) -> float:
        """The clock of the time-outs, in seconds."""
        return self._clock.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self._clock.sleep(seconds)

    def write(self, data: bytes) -> None:
        """Send bytes. Raises ConnectionLost."""
        with self.lock:
            self.port.write(data)

    def ask(self, data: bytes, timeout_s: float, gate: AbstractContextManager[object] | None = None) -> str:
        """Send, and return the next line. gate is held while the bytes are written. Raises NoAnswer, ConnectionLost."""
        with self.lock:
            if self._stale:
                self.drain(_LATE_S)
            self._stale = True  # until the answer is complete, for Ctrl-C may come before that
            with gate or nullcontext():
                self.port.write(data)
            return self.read_line(timeout_s)

    def read_line(self, timeout_s: float) -> str:
        """The next line, without its end. Raises NoAnswer, ConnectionLost, NotAMount for a line without end."""
        end = self.monotonic() + timeout_s
        self._stale = True
        while b"\n" not in self._buffer:
            if len(self._buffer) > _LONGEST_LINE:
                raise NotAMount(f"more than {_LONGEST_LINE} bytes without the end of a line")
            left = end - self.monotonic()
            # Read even if no time is left: the answer may have come while this process did not run.
            came = self.port.read(max(0.0, left))
            if not came and left <= 0:
                raise NoAnswer(f"no answer within {timeout_s:g} s")
            self._buffer += came
        line, _, rest = bytes(self._buffer).partition(b"\n")
        self._buffer[:] = rest
        self._stale = False
        return line.decode("ascii", "replace").strip("\r")

    def drain(self, quiet_s: float, longest_s: float = 2.0) -> bytes:
        """Read until quiet_s pass without a byte (at most longest_s). Returns the bytes, buffered ones first."""
        received = bytes(self._buffer)
        self._buffer.clear()
        end = self.monotonic() + longest_s
        while self.monotonic() < end:
            try:
                data = self.port.read(quiet_s)
            except ConnectionLost:
                if received:  # the last bytes of the board; the next call raises
                    return received
                raise
            if not data:
                break
            received = (received + data)[:_LONGEST_LINE]  # the rest of a flood is dropped
        if quiet_s >= _LATE_S:
            self._stale = False
        return received

    def close(self) -> None:
        """Close the port."""
        self.port.close()
