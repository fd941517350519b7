"""A minute of a run in one line: sums from which every longer time is made. Pure.

Errors are counted only while the loop held the beam (HOLDING, CORRECTING, CREEPING); `looks` says how many those were.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from mirrormount.beam.events import (
    CORRECTING,
    CREEPING,
    HOLDING,
    Corrected,
    Event,
    GateClosed,
    Looked,
    Pulsed,
    ResponseChanged,
    SpotSeen,
    StateChanged,
)

MINUTE_S = 60.0
HELD = (HOLDING, CORRECTING, CREEPING)
_GATES_MOST = 20  # lines of a minute; all are counted


@dataclass
class Sums:
    """Of the errors of one camera, or of the beam's angle: sums over looks of x and y."""

    looks: int = 0
    x: float = 0.0
    y: float = 0.0
    xx: float = 0.0
    yy: float = 0.0
    most: float = 0.0  # largest magnitude along x or y

    def add(self, x: float, y: float) -> None:
        """One look."""
        self.looks += 1
        self.x += x
        self.y += y
        self.xx += x * x
        self.yy += y * y
        self.most = max(self.most, abs(x), abs(y))

    def join(self, other: "Sums") -> None:
        """Add the looks of another time."""
        self.looks += other.looks
        self.x += other.x
        self.y += other.y
        self.xx += other.xx
        self.yy += other.yy
        self.most = max(self.most, other.most)

    @property
    def rms(self) -> tuple[float, float]:
        """Root of the mean square along x and y, about the target. nan without a look."""
        if not self.looks:
            return math.nan, math.nan
        return math.sqrt(self.xx / self.looks), math.sqrt(self.yy / self.looks)

    @property
    def mean(self) -> tuple[float, float]:
        """Mean along x and y. nan without a look."""
        return (self.x / self.looks, self.y / self.looks) if self.looks else (math.nan, math.nan)


@dataclass
class Minute:
    """One minute from begin_s on, on the table's clock. state: that of the loop at its end.

    errors_um, free_um: for each camera. held_s: how long the loop held the beam. drive_us: for each actuator, the drive
    in the positive direction and in the negative one. gates: [time_s, number, name, cause] of the first ones.
    change: as ResponseChanged.change, the last one.
    """

    begin_s: float
    state: str = ""
    errors_um: dict[str, Sums] = field(default_factory=dict)
    free_um: dict[str, Sums] = field(default_factory=dict)
    angle_urad: Sums = field(default_factory=Sums)
    held_s: float = 0.0
    missed: int = 0
    corrections: int = 0
    pulses: int = 0
    reversals: int = 0
    drive_us: dict[str, list[int]] = field(default_factory=dict)
    gates_closed: int = 0
    gates: list[list[Any]] = field(default_factory=list)
    change: float | None = None
    _since_s: float | None = None  # of the last event
    _number: int = -1  # of the last correction

    def add(self, event: Event) -> None:
        """One event, not older than the one before."""
        since_s = self.begin_s if self._since_s is None else self._since_s
        if self.state in HELD:
            self.held_s += max(0.0, event.time_s - since_s)
        self._since_s = event.time_s
        match event:
            case StateChanged():
                self.state = event.state
            case Looked():
                self._look(event)
            case Corrected():
                self.corrections += event.number != self._number  # a creep is told pulse by pulse
                self._number = event.number
                self.reversals += len(event.reversals)
            case Pulsed():
                self.pulses += 1
                self.drive_us.setdefault(event.actuator, [0, 0])[event.us < 0] += abs(event.us)
            case GateClosed():
                self.gates_closed += 1
                if len(self.gates) < _GATES_MOST:
                    self.gates.append([event.time_s, event.number, event.name, event.cause])
            case ResponseChanged():
                self.change = event.change

    def end(self) -> None:
        """The minute is over: the state lasted to its end."""
        if self.state in HELD:
            self.held_s += max(0.0, self.begin_s + MINUTE_S - (self._since_s or self.begin_s))

    def _look(self, look: Looked) -> None:
        if self.state not in HELD:
            return
        for at, spot in enumerate(look.spots):
            if not isinstance(spot, SpotSeen):
                self.missed += 1
                continue
            self.errors_um.setdefault(spot.camera, Sums()).add(*spot.error_um)
            if at < len(look.free_um):
                self.free_um.setdefault(spot.camera, Sums()).add(*look.free_um[at])
        if look.angle_urad is not None:
            self.angle_urad.add(*look.angle_urad)


def minute_to_json(minute: Minute) -> dict[str, Any]:
    """Plain data for json.dumps."""
    data = asdict(minute)
    del data["_since_s"], data["_number"]
    return data


def minute_from_json(data: Mapping[str, Any]) -> Minute:
    """The minute that minute_to_json() made this of. Raises TypeError, ValueError, AttributeError if it is none."""
    fields = dict(data)
    for name in ("errors_um", "free_um"):
        fields[name] = {camera: Sums(**sums) for camera, sums in fields.get(name, {}).items()}
    fields["angle_urad"] = Sums(**fields.get("angle_urad", {}))
    return Minute(**fields)
