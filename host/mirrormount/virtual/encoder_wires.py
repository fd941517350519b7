"""What a board is told of its encoders' wires: beforehand, for the interval that it is granted.

A drive that changes in the interval makes the rest of it void: the board ends the interval there and then, and is told
anew. So each change is at its true time, however long the interval.
"""

from collections.abc import Iterator

from mirrormount.virtual.bench import Bench
from mirrormount.virtual.wiring import BUS, ENCODERS

# records of the seam; virtual/fakes/_seam.py explains them
_CHANGE, _ENDS = b"QN"


class EncoderWires:
    """What one board, since it was switched on, has been told."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._wires = {
            motor: (ENCODERS[motor] if encoder.kind == "motor" else (BUS + ENCODERS[motor][0],))
            for motor, encoder in bench.encoders.items()
            if motor in ENCODERS
        }
        self._known: dict[int, int] = {}  # wire to level, before those of _told
        self._told: list[tuple[int, int, int]] = []  # (us, wire, level)
        self._new = True

    def tell(self, now_us: int, until_us: int) -> Iterator[tuple[int, int, int, int]]:
        """Records (kind, wire, level, us) for a board that has come to now_us and may go on to until_us."""
        if self._new:
            self._new = False
            for pin in self._bench.wires:
                yield _ENDS, pin, 1, 0
        self._bench.look_ahead(until_us)
        self._known.update((wire, level) for us, wire, level in self._told if us <= now_us)
        told = []
        for motor, wires in self._wires.items():
            encoder = self._bench.encoders[motor]
            shown = {wire: self._known.get(wire) for wire in wires}
            changes = [(now_us, encoder.at(now_us))]
            changes += [(change.us, change.wires) for change in encoder.between(now_us, until_us)]
            for us, levels in changes:
                for wire, level in zip(wires, levels, strict=True):
                    if level != shown[wire]:
                        shown[wire] = level
                        told.append((us, wire, level))
            encoder.forget(now_us)
        self._told = sorted(told, key=lambda change: change[0])
        for us, wire, level in self._told:
            yield _CHANGE, wire, level, us
