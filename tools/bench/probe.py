"""Makes a pin show when the firmware's loop looks at its input: low while it does, high in between.

The firmware runs unchanged from the raw prompt, but for the lane's look(), with which it looks and in which alone it
sleeps. That is wrapped in native code, which adds some 10 us to each look. The loop looks several times in a pass, so
what the pin shows as high is a piece of a pass: how long something that arrives may have to wait.
"""

from lab import Board, Edge

from mirrormount.virtual.emulator import RawPrompt

PASS = "pass"
_GPIO = 22  # free: see the table in docs/bring-up.md

_PROGRAM = """
import micropython
from machine import Pin
from mountfw.build import build
from mountfw.ports import micropython as port
pin = Pin(%d, Pin.OUT, value=0)
low = pin.low
high = pin.high
board = port.find_board()
a = build(port, board)
looked = a._look
@micropython.native
def look(most, wait_ms):
    low()
    found = looked(most, wait_ms)
    high()
    return found
a._look = a._lane.look = look
try:
    a.run()
finally:
    port.leave(board)
"""


_POLLED = """
from mountfw.build import build
from mountfw.ports import micropython as port
from machine import Pin
for number in (10, 11, 12, 13):  # what ran before has set them
    Pin(number).irq(None)
port.on_rise = lambda number, handler: None
board = port.find_board()
try:
    build(port, board).run()
finally:
    port.leave(board)
"""


# The loop notes how long a pass has taken: there, at the end of each, something is done while a motor is driven.
_WHILE_DRIVING = """
import gc
from mountfw.build import build
from mountfw.ports import micropython as port
board = port.find_board()
a = build(port, board)
about = a.queries.about
passed = about.passed
def ended(us):
    passed(us)
    %s a.controller.driving():
        %s
about.passed = ended
try:
    a.run()
finally:
    port.leave(board)
"""


def start_probe(board: Board) -> None:
    """Start the firmware anew, with the probe. The board is at its prompt for a moment."""
    board.simulation.probes[_GPIO] = PASS
    _start(board, _PROGRAM % _GPIO)


def start_polled(board: Board) -> None:
    """Start the firmware anew, as on a port that has no interrupts."""
    _start(board, _POLLED)


def start_hanging(board: Board) -> None:
    """Start the firmware anew; the loop hangs with the first drive, until the watchdog resets the board."""
    _start(board, _WHILE_DRIVING % ("while", "pass"))


def start_collecting(board: Board) -> None:
    """Start the firmware anew; garbage is collected in each pass while a motor is driven."""
    _start(board, _WHILE_DRIVING % ("if", "gc.collect()"))


def _start(board: Board, program: str) -> None:
    RawPrompt(board)
    board.simulation.lit = False
    board.give(program.encode() + b"\x04")
    board.boot()
    board.clear()


def longest_pass_us(edges: list[Edge]) -> int:
    """The longest time that the pin was high; 0 if it never was."""
    longest, since = 0, None
    for us, pin, duty in edges:
        if pin == PASS:
            if duty:
                since = us if since is None else since
            elif since is not None:
                longest, since = max(longest, us - since), None
    return longest
