"""Makes the parts that differ from board to board: bridges, axes, emergency stop."""

from mountfw import bridges
from mountfw.board_file import BRIDGES
from mountfw.boards import DRIVES
from mountfw.encoder.axis import EncodedAxis
from mountfw.end_stop import EndStop
from mountfw.homing import Homing
from mountfw.motion.axis import Axis


def make_bridge(port, board, pins):
    """The bridge of one axis, on these pins of a board file."""
    kind, duties = BRIDGES[board.BRIDGE]
    make = getattr(port, kind, None)  # the port may have one of its platform's own
    if not make:
        make = getattr(bridges, kind)
    names = [name for name in DRIVES if pins[name] is not None]
    parts = [port.output(pins[name], board.PWM_HZ if name in duties else 0) for name in names]
    return make(*(parts + [board.DEAD_TIME_US, port.pause_us, port.ticks_us]))


def make_axis(number, pins, port, board, error_queue, receiver):
    """Axis `number`, on these pins of a board file, with its interrupts, and its encoder if the port can read it."""
    stops = [EndStop(port.reader(pins[name])) for name in ("stop_pos", "stop_neg")]
    homing = Homing if stops[0].has_input or stops[1].has_input else None
    parts = [number, make_bridge(port, board, pins)] + stops + [homing, error_queue, port.ticks_us]
    reader = port.encoder(number, pins) if "encoder" in pins or "shaft" in pins else None
    axis = Axis(*parts) if reader is None else EncodedAxis(*parts, reader, receiver)  # pyright: ignore[reportCallIssue]
    for name in ("stop_pos", "stop_neg"):
        if pins[name] is not None:
            port.on_rise(pins[name], axis.drive.guard)
    return axis


def make_emergency_stop(port, board):
    """The emergency stop of a board file; not fitted where it names none."""
    number = getattr(board, "EMERGENCY_STOP", None)
    emergency_stop = EndStop(port.reader(number))
    emergency_stop.fitted = number is not None
    return emergency_stop
