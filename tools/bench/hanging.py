"""A loop that does not look at its input in time: it collects garbage, or hangs. Measured as in measure.py."""

from lab import ENABLES, LOST, Board, Lab, last_fall_us
from measure import IDLE_US
from probe import start_collecting, start_hanging

WATCHDOG_US = 1_000_000
DRIVE_US = 200_000


def stop_in_collection(lab: Lab) -> list[float]:
    """ms; both axes run, and the loop collects garbage in each of its passes; `!` comes at any moment."""
    board, random = lab.board(), lab.random
    start_collecting(board)
    times = []
    for _ in lab.trials():
        board.do(b"1MV+;2MV-\n")
        board.run(random.randrange(IDLE_US))
        times.append(board.stopped_after_us(board.give(b"!")) / 1000)
        board.forget()
    return times


def stop_in_hang(lab: Lab) -> list[float]:
    """ms from `!` to both enables low, where the loop has hung since the drive began: runs and frames by turns."""
    board, random = lab.board(), lab.random
    times = []
    for trial in lab.trials():
        _hang(board, b"1MV+;2MV-\n" if trial % 2 else b"0255-255")
        board.run(random.randrange(IDLE_US))
        landed_us = board.give(b"!")
        times.append(_off_after_us(board, landed_us) / 1000)
        _recover(board)
    return times


def end_in_hang(lab: Lab, *, start: bytes) -> list[float]:
    """ms from the end that a drive of DRIVE_US should have had to its enable low; the loop has hung meanwhile."""
    board = lab.board()
    times = []
    for _ in lab.trials():
        began_us = _hang(board, b"1XP%d;1XM%d\n" % (DRIVE_US, DRIVE_US // 1000) + start)
        times.append((_off_after_us(board, began_us) - DRIVE_US) / 1000)
        _recover(board)
    return times


def _hang(board: Board, start: bytes) -> int:
    """Start a drive in which the loop hangs. Returns when the last enable rose."""
    start_hanging(board)
    board.forget()
    board.give(start)
    board.run(1_000_000, lambda: not board.off())
    board.run(20_000)
    return max(us for us, pin, duty in board.edges if pin in ENABLES and duty)


def _off_after_us(board: Board, since_us: int) -> float:
    board.run(2 * WATCHDOG_US, board.off)
    return last_fall_us(board.edges, since_us) - since_us if board.off() else LOST


def _recover(board: Board) -> None:
    """Wait for the watchdog's reset and for the start after it."""
    board.run(2 * WATCHDOG_US, lambda: not board.simulation.usb)
    board.simulation.lit = False
    board.boot()
    board.clear()
