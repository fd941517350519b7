"""Gates: what makes the loop switch all motors off. Each is declared once; docs/hold.md has the table of them. Pure."""

from dataclasses import dataclass

from mirrormount.beam.events import GateClosed
from mirrormount.beam.looking import Fault
from mirrormount.beam.reasons import Reason
from mirrormount.common.beam_errors import GateEnded


@dataclass(frozen=True, slots=True)
class Gate:
    """cause, remedy: in words. opens_itself: the loop goes on when the cause has gone and the spot is where it was."""

    number: int
    name: str
    cause: str
    remedy: str
    opens_itself: bool


NO_SPOT = Gate(
    1,
    "no spot",
    "two frames in a row of a camera show no spot, or five none that is clear",
    "look for something in the beam, or switch on the laser; a lost beam is found by `mirrormount scan find`",
    True,
)
UNCLEAR = Gate(
    2,
    "spot not clear",
    "the spot is saturated, or a second one is nearly as bright",
    "a shorter exposure, or cover the reflection",
    True,
)
JUMPED = Gate(
    3,
    "spot jumped",
    "the spot is further off than one correction brings it, or is not back where it was when it was lost",
    "look at what was moved; then tell the loop to go on, or align anew",
    False,
)
NO_HELP = Gate(
    4,
    "corrections do not help",
    "three corrections in a row made the error larger, or did not do what the calibration says",
    "calibrate anew: a camera was turned, mounts or wires were exchanged, or the supply has changed",
    False,
)
STUCK = Gate(
    5,
    "axis does not move",
    "an axis was driven beyond its gap and the spot did not move: it is at its end, or motor or coupler is loose",
    "turn the screw back by hand to the middle of its way and align anew; look at the coupler",
    False,
)
CAMERA_GONE = Gate(
    6, "camera gone", "a camera was unplugged or delivers no frames", "plug it in; the loop tries every second", True
)
CAMERA_REPEATS = Gate(
    7,
    "camera repeats",
    "a camera returns one and the same picture",
    "unplug the camera and plug it in; end programs that show its picture",
    True,
)
TOO_OLD = Gate(
    8,
    "frames too old",
    "a camera's frames are older than the loop may use",
    "end what keeps the computer busy; a shorter exposure",
    True,
)
BOARD = Gate(
    9,
    "board",
    "a board refused a pulse, ended it early, or does not answer",
    "what the line says (docs/errors.md); then tell the loop to go on",
    False,
)
CONTROL = Gate(
    10,
    "somebody took over",
    "a person took control of a mount, or pressed STOP",
    "when the person has finished, tell the loop to go on",
    False,
)
GATES = (NO_SPOT, UNCLEAR, JUMPED, NO_HELP, STUCK, CAMERA_GONE, CAMERA_REPEATS, TOO_OLD, BOARD, CONTROL)

_OF_FAULTS = {"gone": CAMERA_GONE, "repeats": CAMERA_REPEATS, "old": TOO_OLD}


class Closed(Exception):
    """A gate closes. detail: what was seen. Never leaves the loop."""

    def __init__(self, gate: Gate, detail: str) -> None:
        super().__init__(detail)
        self.gate = gate
        self.detail = detail

    def event(self, time_s: float) -> GateClosed:
        """What is told of it."""
        gate = self.gate
        return GateClosed(time_s, gate.number, gate.name, self.detail, gate.remedy, gate.opens_itself)

    def error(self) -> GateEnded:
        """For a run that ends by it."""
        return GateEnded(f"gate {self.gate.number}, {self.gate.name}: {self.detail}; {self.gate.remedy}")


def of_fault(fault: Fault) -> Closed:
    """The gate that a camera's fault closes."""
    if fault.kind == "spot":
        unclear = fault.reason in (Reason.SATURATED, Reason.SPLIT)
        return Closed(UNCLEAR if unclear else NO_SPOT, fault.text)
    return Closed(_OF_FAULTS[fault.kind], fault.text)
