"""A file with the true turns of the screws: one JSON object a line, at each end of a motion.

A move of many steps rests between its pulses, and the pins alone cannot tell such a rest from the end of the move. So
what the host sends is read, too: the drive after a rest belongs to the same motion unless an order for that motor has
come since the last drive began. Then the line of that rest is taken back, and one comes at the end.
"""

import contextlib
import json
import re
from collections.abc import Iterable
from pathlib import Path

from mirrormount.errors import BadAddress, CannotWrite
from mirrormount_sim.bench import Bench

_BETWEEN = re.compile(rb"[\r\n;]")
_COMMAND = re.compile(rb"(?:[0-9]+>)?([1-9]?)(\*?[A-Za-z]{2,})([^!]*)")
_ORDERS = (b"PR", b"PA", b"XU", b"MV", b"MT", b"OR", b"ST", b"AB", b"RS", b"*RST")  # they begin or end a motion
_MOST_OPEN = 256  # bytes of a line that has no end


class Truth:
    """{"t_us": microseconds since power-up, "m1_screw_rev": revolutions, "m2_screw_rev": …}. Raises BadAddress."""

    def __init__(self, file: Path, start_us: int) -> None:
        self._start_us = start_us
        try:
            self._file = file.open("w+b")
        except OSError as e:
            raise BadAddress(f"cannot write the truth to {file}: {e.strerror or e}") from e
        self._orders = Orders()
        self._ordered: set[str] = set()  # motors with an order since their last drive began
        self._last: dict[str, int] = {}  # where the line of a motor's last rest is in the file
        self._driven: set[str] = set()  # motors that have not been at rest since their drive

    def watch(self, bench: Bench) -> None:
        """Write down each end of a motion on this bench from now on."""
        self._motors = tuple(bench.trains)
        bench.on_rest, bench.on_drive = self._rests, self._drives

    def hear(self, received: Iterable[int]) -> None:
        """The host has sent these bytes to the board."""
        self._take(self._orders.read(bytes(received)))

    def _take(self, axes: Iterable[str]) -> None:
        for axis in axes:
            self._ordered.update([f"m{axis}"] if axis else self._motors)

    def _drives(self, us: int, motor: str, screws: dict[str, float]) -> None:
        """A drive begins, after a pause."""
        self._take(self._orders.pending())
        goes_on = motor not in self._ordered
        self._ordered.discard(motor)
        if motor in self._driven and not goes_on:
            self._rests(us, motor, screws)  # the next motion begins while it turns: that ends the one before
        if goes_on:
            self._take_back(motor)
        else:
            self._last.pop(motor, None)
        self._driven.add(motor)

    def _rests(self, us: int, motor: str, screws: dict[str, float]) -> None:
        line = {"t_us": us - self._start_us} | {f"{name}_screw_rev": rev for name, rev in screws.items()}
        text = json.dumps(line).encode() + b"\n"
        self._driven.discard(motor)
        self._last[motor] = self._file.tell()
        self._write(text)

    def _take_back(self, motor: str) -> None:
        """It was no end: the line goes."""
        at = self._last.pop(motor, None)
        if at is None:
            return
        self._file.seek(at)
        line = self._file.readline()
        after = self._file.read()
        self._file.seek(at)
        self._write(after)
        self._file.truncate()
        self._last = {name: where - len(line) if where > at else where for name, where in self._last.items()}

    def _write(self, text: bytes) -> None:
        try:
            self._file.write(text)
            self._file.flush()
        except OSError as e:
            raise CannotWrite(f"cannot write the truth to {self._file.name}: {e.strerror}") from e

    def close(self) -> None:
        """Close the file; a failed write was reported when it happened."""
        with contextlib.suppress(OSError):
            self._file.close()


class Orders:
    """Finds what begins or ends a motion in what a host sends: commands, frames, stops (docs/protocol.md)."""

    def __init__(self) -> None:
        self._open = b""  # what has no end yet

    def read(self, data: bytes) -> list[str]:
        """The axes of the orders in these bytes: "1", "2" …; "" stands for all."""
        *ended, rest = _BETWEEN.split(self._open + data)
        self._open = rest[-_MOST_OPEN:]
        return [axis for words in ended for axis in _axes_of(words)]

    def pending(self) -> list[str]:
        """The same of what has no line end, as frames."""
        if re.match(rb"\s*[1-9A-Za-z*]", self._open) and b"!" not in self._open:
            return []  # a line: not executed yet
        axes = _axes_of(self._open)
        self._open = b""
        return axes


def _axes_of(words: bytes) -> list[str]:
    words = words.replace(b" ", b"").strip(b"\0")
    if not words or (words.endswith(b"?") and b"!" not in words):
        return []
    command = _COMMAND.fullmatch(words)
    if not command:
        return [""]  # a frame, a stop, or malformed, which stops
    return [command[1].decode()] if command[2].upper().startswith(_ORDERS) else []
