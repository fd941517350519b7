"""Composes the firmware: build() makes an App of a port (the hardware's verbs) and a board file. Runs once."""

from mountfw import board_file, boards, codes
from mountfw.app import App, Input
from mountfw.board_file import BRIDGES
from mountfw.boards import DRIVES
from mountfw.dialect.commands import Commands
from mountfw.dialect.error_queue import ErrorQueue
from mountfw.dialect.line import Line
from mountfw.dialect.queries import About
from mountfw.encoder.axis import EncodedAxis
from mountfw.homing import Homing
from mountfw.motion.axis import Axis
from mountfw.motion.controller import Controller
from mountfw.motion.drive import EndStop
from mountfw.motion.gate import Gated
from mountfw.ports import bridges
from mountfw.store import Records
from mountfw.wire.frame import Frame
from mountfw.wire.receiver import Receiver
from mountfw.wire.replies import Replies


def build(port, board):
    """An App on a port (see ports/), wired and with as many axes as a board file says (see boards/).

    Raises ValueError if the board file has a fault; then no pin is touched.
    """
    # the check takes a Pico 8 ms, and find_board() has done it
    wrong = "" if board is board_file.checked else board_file.fault(board_file.values(board), False)
    if wrong:
        raise ValueError(wrong)
    error_queue = ErrorQueue()
    cause = port.reset_cause()
    replies = Replies()
    frame = Frame(port.pack)
    line = Line()
    receiver = Receiver(frame, line, port.pack)  # its ring needs 4 KB in one piece: before encoders are loaded
    parts = port, board, error_queue, receiver
    axes = [make_axis(i + 1, pins, *parts) for i, pins in enumerate(boards.axes(board))]
    emergency_stop = make_emergency_stop(port, board)
    records = Records(port, axes, error_queue)
    controller = Controller(axes, error_queue, emergency_stop, records)
    if cause == codes.WATCHDOG:
        error_queue.push(codes.WATCHDOG_RESET)
    about = About(board.NAME, port, cause)
    power = getattr(board, "POWER", None)
    if power is not None:
        about.power = port.analog(power)
    if emergency_stop.fitted:
        port.on_rise(board.EMERGENCY_STOP, controller.guard)
    commands = Commands(controller, line, replies, about)
    gated = Gated(port.gate(board) if hasattr(port, "gate") else None, controller, about)
    parts = controller, receiver, frame, replies, commands
    source = port.lane(*parts, board) if hasattr(port, "lane") else Input(port, receiver)
    app = App(port, controller, commands, receiver, frame, replies, gated, source)
    App.built = app
    return app


def make_bridge(port, board, pins):
    """The bridge of one axis, on these pins of a board file."""
    kind, duties, tuned = BRIDGES[board.BRIDGE]
    make = getattr(port, kind, None)  # the port may have one of its platform's own
    if not make:
        make = getattr(bridges, kind)
    names = [name for name in DRIVES if pins[name] is not None]
    tunable = getattr(port, "TUNABLE", False) and board_file.tunable(board, pins)
    if tunable:
        duties = tuned
    parts = [port.output(pins[name], board.PWM_HZ if name in duties else 0) for name in names]
    bridge = make(*(parts + [board.DEAD_TIME_US, port.pause_us, port.ticks_us]))
    bridge.made_hz = board.PWM_HZ if tunable else 0
    return bridge


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
