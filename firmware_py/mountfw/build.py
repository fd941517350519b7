"""Composes the firmware: build() makes an App of a port (the hardware's verbs) and a board file. Runs once."""

from mountfw import board_file, boards, codes
from mountfw.app import App, Input
from mountfw.dialect.commands import Commands
from mountfw.dialect.error_queue import ErrorQueue
from mountfw.dialect.line import Line
from mountfw.dialect.queries import About
from mountfw.motion.controller import Controller
from mountfw.motion.gate import Gated
from mountfw.parts import make_axis, make_emergency_stop
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
    if emergency_stop.fitted:
        port.on_rise(board.EMERGENCY_STOP, controller.guard)
    commands = Commands(controller, line, replies, about)
    gated = Gated(port.gate(board) if hasattr(port, "gate") else None, controller, about)
    parts = controller, receiver, frame, replies, commands
    source = port.lane(*parts, board) if hasattr(port, "lane") else Input(port, receiver)
    app = App(port, controller, commands, receiver, frame, replies, gated, source)
    App.built = app
    return app
