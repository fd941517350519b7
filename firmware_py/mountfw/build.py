"""Composes the firmware: build() makes an App of a port (the hardware's verbs) and a board file. Runs once."""

from mountfw import board_file, codes
from mountfw.app import App
from mountfw.dialect.commands import Commands
from mountfw.dialect.line import Line
from mountfw.dialect.queries import About
from mountfw.encoded import make
from mountfw.gated import Gated
from mountfw.motion.bridge import EnableBridge, TwoPwmBridge
from mountfw.motion.controller import Controller
from mountfw.motion.endstop import EndStop
from mountfw.own_reply import OwnReply
from mountfw.presize import presize
from mountfw.store import Records
from mountfw.wire.error_queue import ErrorQueue
from mountfw.wire.frame import Frame
from mountfw.wire.receiver import Receiver
from mountfw.wire.replies import Replies

built = None  # the App of the last build(): repl.py continues with it


def _enable_bridge(port, board, pins):
    enable = port.output(pins["en"], board.PWM_HZ)
    legs = port.output(pins["pos"]), port.output(pins["neg"])
    return EnableBridge(enable, *legs, board.DEAD_TIME_US, port.pause_us, port.ticks_us)


def _two_pwm_bridge(port, board, pins):
    legs = port.output(pins["pos"], board.PWM_HZ), port.output(pins["neg"], board.PWM_HZ)
    make = getattr(port, "TwoPwmBridge", TwoPwmBridge)  # a port may have one of its platform's own
    return make(*legs, board.DEAD_TIME_US, port.pause_us, port.ticks_us)


BRIDGES = {"enable": _enable_bridge, "two-pwm": _two_pwm_bridge}  # by a board file's BRIDGE


def make_bridge(port, board, pins):
    """The bridge of one axis, on these pins of a board file. Raises ValueError for a BRIDGE that is not in BRIDGES."""
    if board.BRIDGE not in BRIDGES:
        raise ValueError("BRIDGE is %r, not one of %s" % (board.BRIDGE, ", ".join(sorted(BRIDGES))))
    return BRIDGES[board.BRIDGE](port, board, pins)


def make_axis(number, port, board, pins, error_queue):
    """Axis `number`, on these pins of a board file, with its interrupts."""
    positive = EndStop(port.reader(pins["stop_pos"]))
    negative = EndStop(port.reader(pins["stop_neg"]))
    axis = make(port, pins, number, make_bridge(port, board, pins), positive, negative, error_queue, port.ticks_us)
    for name in ("stop_pos", "stop_neg"):
        if pins[name] is not None:
            port.on_rise(pins[name], axis.drive.guard)
    return axis


def build(port, board):
    """An App on a port (see ports/), wired and with as many axes as a board file says (see boards/).

    Raises ValueError if the board file has a fault; then no pin is touched.
    """
    global built
    # the check takes a Pico 34 ms, and find() has done it
    wrong = "" if board is board_file.checked else board_file.fault(board_file.values(board), False)
    if wrong:
        raise ValueError(wrong)
    error_queue = ErrorQueue()
    cause = port.reset_cause()
    own = OwnReply(port.pack)
    replies = Replies(own)
    frame = Frame(port.pack)
    line = Line()
    axes = [make_axis(i + 1, port, board, pins, error_queue) for i, pins in enumerate(board_file.axes(board))]
    number = getattr(board, "EMERGENCY_STOP", None)
    emergency_stop = EndStop(port.reader(number))
    emergency_stop.fitted = number is not None
    records = Records(port, axes, error_queue)
    controller = Controller(axes, error_queue, emergency_stop, records, port.boot_id(), port.ticks_ms)
    if cause == codes.WATCHDOG:
        error_queue.push(codes.WATCHDOG_RESET)
    about = About(board.NAME, port.unique_id(), port.firmware_hash, cause, port.free_memory)
    if number is not None:
        port.on_rise(number, controller.guard)
    commands = Commands(controller, line, replies, about)
    receiver = Receiver(frame, line, port.pack, own)
    gated = Gated(port.gate(board) if hasattr(port, "gate") else None, controller, about)
    built = App(port, controller, commands, receiver, frame, replies, own, gated)
    for thing, most in ((receiver, 18), (frame, 13), (replies, 13), (own, 24), (controller, 18)):
        presize(thing, most)
    for axis in axes:
        for thing, most in ((axis, 60), (axis.drive, 32), (axis.position, 18), (axis.drive.bridge, 13)):
            presize(thing, most)
    return built
