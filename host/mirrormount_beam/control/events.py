"""What the loop tells: every observation, correction and pulse, its state, and the interlocks.

Plain data; imports no NumPy.

`listen(event)` of a loop is called in the loop's own thread and must return at once. to_json() makes one line of a
log of an event, from_json() an event of the line. time_s is the table's clock in each.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

Pair = tuple[float, float]  # (x, y); in um and urad x to the right and y up in the picture


@dataclass(frozen=True, slots=True)
class SpotSeen:
    """The spot in one camera: the mean of `frames` frames.

    px: place in pixels, x to the right and y down. sigma_px: standard errors. error_um: how far from the target.
    exposed_s: middle of the last exposure, on the table's clock.
    """

    camera: str
    px: Pair
    sigma_px: Pair
    error_um: Pair
    exposed_s: float
    frames: int = 1


@dataclass(frozen=True, slots=True)
class SpotMissed:
    """One camera shows no spot; reason is in words."""

    camera: str
    reason: str


@dataclass(frozen=True, slots=True)
class Observed:
    """One observation by all cameras. spots: in the table's order.

    angle_urad: how far the beam's angle is off; None without a spot in each camera or without distances.
    free_um: for each camera, how far off the spot would be if nothing had been moved since the loop began (estimated
    from the pulses and the response); empty where it is not known.
    """

    time_s: float
    spots: tuple[SpotSeen | SpotMissed, ...]
    angle_urad: Pair | None = None
    free_um: tuple[Pair, ...] = ()

    @property
    def complete(self) -> bool:
        """True if each camera shows a spot."""
        return all(isinstance(spot, SpotSeen) for spot in self.spots)

    @property
    def worst_um(self) -> float:
        """The largest error along x or y in any camera; nan without any spot."""
        seen = [abs(um) for spot in self.spots if isinstance(spot, SpotSeen) for um in spot.error_um]
        return max(seen, default=math.nan)


@dataclass(frozen=True, slots=True)
class Estimated:
    """What a loop that holds a beam takes for the errors from now on: the last observation and those before it,
    weighted by their noise. errors_um: for each camera; angle_urad: as of Observed."""

    time_s: float
    errors_um: Mapping[str, Pair]
    angle_urad: Pair | None = None


@dataclass(frozen=True, slots=True)
class Pulsed:
    """One motor was driven. us: signed length of all pulses together. purpose: CORRECT, TAKE_UP, CREEP or MEASURE."""

    time_s: float
    actuator: str
    us: int
    purpose: str


@dataclass(frozen=True, slots=True)
class SignalRead:
    """The signal that is maximised: the mean of some readings and its standard error, in the source's unit."""

    time_s: float
    value: float
    error: float


CORRECT, TAKE_UP, CREEP, MEASURE = "correct", "take-up", "creep", "measure"


@dataclass(frozen=True, slots=True)
class Corrected:
    """A correction: what was asked of each actuator, in steps, and what came of it.

    before_um, expected_um, after_um: errors of all cameras (x, y of the first, x, y of the second). reversals: of
    these actuators the direction changed.
    """

    time_s: float
    number: int
    steps: Mapping[str, float]
    before_um: tuple[float, ...]
    expected_um: tuple[float, ...]
    after_um: tuple[float, ...]
    reversals: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class StateChanged:
    """What the loop does from now on, and why; why says in one line why it does nothing, too.

    state: one of CALIBRATING, ALIGNING, HOLDING, CORRECTING, CREEPING, WAITING (for an interlock
    that clears itself), STOPPED (a person has to act), ENDED.
    """

    time_s: float
    state: str
    why: str = ""


CALIBRATING, ALIGNING, HOLDING, CORRECTING = "calibrating", "aligning", "holding", "correcting"
CREEPING, WAITING, STOPPED, ENDED = "creeping through the gap", "waiting", "stopped", "ended"


@dataclass(frozen=True, slots=True)
class InterlockTripped:
    """An interlock stopped all motors. number, name: interlocks.py; cause: what was seen; remedy: what to do.

    clears_itself: the loop goes on when the cause has gone; otherwise a person tells it to.
    """

    time_s: float
    number: int
    name: str
    cause: str
    remedy: str
    clears_itself: bool


@dataclass(frozen=True, slots=True)
class InterlockCleared:
    """The cause of an interlock has gone; the loop goes on."""

    time_s: float
    number: int
    name: str


@dataclass(frozen=True, slots=True)
class ResponseChanged:
    """The response was refined. matrix_um: row for row, um for a step (cameras' x, y; actuators), positive direction.

    change: the largest relative change of a column since the calibration.
    """

    time_s: float
    matrix_um: tuple[tuple[float, ...], ...]
    change: float


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a calibration is: the part that is done (0 … 1), and what comes."""

    time_s: float
    done: float
    what: str


Event = (
    Observed
    | Estimated
    | Pulsed
    | SignalRead
    | Corrected
    | StateChanged
    | InterlockTripped
    | InterlockCleared
    | ResponseChanged
    | Progress
)
Listen = Callable[[Event], object]

_KINDS: dict[str, type[Any]] = {
    "observation": Observed,
    "estimate": Estimated,
    "pulse": Pulsed,
    "signal": SignalRead,
    "correction": Corrected,
    "state": StateChanged,
    "interlock tripped": InterlockTripped,
    "interlock cleared": InterlockCleared,
    "response": ResponseChanged,
    "progress": Progress,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def silent(_event: Event) -> None:
    """For a loop to which nobody listens."""


def to_json(event: Event) -> dict[str, Any]:
    """Plain data for json.dumps: the fields, and the kind under "event"."""
    return {"event": _NAMES[type(event)], **asdict(event)}


def from_json(data: Mapping[str, Any]) -> Event:
    """The event that to_json() made this of. Raises KeyError or TypeError if it is none."""
    fields = {name: _tuples(value) for name, value in data.items() if name != "event"}
    kind = _KINDS[data["event"]]
    if kind is Observed:
        fields["spots"] = tuple((SpotSeen if "px" in spot else SpotMissed)(**spot) for spot in fields["spots"])
    return kind(**fields)


def _tuples(value: Any) -> Any:
    """JSON's lists as tuples, all the way down."""
    if isinstance(value, list | tuple):
        return tuple(_tuples(item) for item in value)
    if isinstance(value, Mapping):
        return {name: _tuples(item) for name, item in value.items()}
    return value
