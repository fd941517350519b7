"""A minute of a run in one line: sums from which every longer time is made. Imports over_time. Pure."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

from mirrormount.beam.control.events import (
    CORRECTING,
    CREEPING,
    HOLDING,
    Corrected,
    Estimated,
    Event,
    GateClosed,
    Looked,
    Pulsed,
    ResponseChanged,
    SpotSeen,
    StateChanged,
)
from mirrormount.beam.over_time import OverTime, Sums

MINUTE_S = 60.0
HELD = (HOLDING, CORRECTING, CREEPING)
_GATES_MOST = 20  # lines of a minute; all are counted


@dataclass
class Minute:
    """One minute from begin_s on, on the table's clock. state: that of the loop at its end.

    held: the errors. free_um: what they would be, for each camera. held_s: how long the loop held the beam. drive_us:
    for each actuator, the drive in the positive direction and in the negative one. gates: [time_s, number, name, cause]
    of the first ones. change: as ResponseChanged.change, the last one.
    """

    begin_s: float
    state: str = ""
    held: OverTime = field(default_factory=OverTime)
    free_um: dict[str, Sums] = field(default_factory=dict)
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

    @classmethod
    def after(cls, before: "Minute | None", time_s: float) -> Self:
        """The minute of that time, behind another one."""
        begin_s = time_s // MINUTE_S * MINUTE_S
        if before is None:
            return cls(begin_s)
        return cls(begin_s, before.state, OverTime(before=before.held.before))

    @property
    def errors_um(self) -> Mapping[str, Sums]:
        """Of each camera."""
        return self.held.errors_um

    @property
    def angle_urad(self) -> Sums:
        """Of the beam."""
        return self.held.angle_urad

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
            case Estimated():
                self.held.take(event)
            case Corrected():
                self.corrections += event.number != self._number  # a creep is told pulse by pulse
                self._number = event.number
                self.reversals += len(event.reversals)
            case Pulsed():
                self.pulses += 1
                self.drive_us.setdefault(event.actuator, [0, 0])[event.us < 0] += abs(event.us)
            case GateClosed():
                self.held.pause()
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
            if at < len(look.free_um):
                self.free_um.setdefault(spot.camera, Sums()).last(look.free_um[at], 1.0)


def minute_to_json(minute: Minute) -> dict[str, Any]:
    """Plain data for json.dumps."""
    data = asdict(minute)
    del data["_since_s"], data["_number"], data["held"]["before"]
    return data


def minute_from_json(data: Mapping[str, Any]) -> Minute:
    """The minute that minute_to_json() made this of. Raises TypeError, ValueError, AttributeError if it is none."""
    fields = dict(data)
    held = fields.get("held", {})
    fields["held"] = OverTime(_by_camera(held.get("errors_um", {})), Sums(**held.get("angle_urad", {})))
    fields["free_um"] = _by_camera(fields.get("free_um", {}))
    return Minute(**fields)


def _by_camera(data: Mapping[str, Mapping[str, Any]]) -> dict[str, Sums]:
    return {camera: Sums(**sums) for camera, sums in data.items()}
