"""The watchdog, the emergency stop and the end-stop interrupt, on the real image. Times are the board's own."""

import pytest

from mirrormount_sim.emulator import RawPrompt

HUNG_US = 1_000_000  # the watchdog's time (_HUNG_MS of ports/micropython.py)
BITE_US = 50_000  # within which its reset is seen
STARTED_US = 3_000_000

HANGS = """
from mountfw.build import build
from mountfw.ports import micropython as port
from mountfw.ports.micropython_console import any
a = build(port, port.find_board())
def ended(us):
    while a.controller.driving():
        %s
a.queries.about.passed = ended  # what the loop calls at the end of each pass
a.run()
"""


def state(board) -> list[bytes]:
    """boot id, uptime, errors waiting ... of XS?"""
    return board.ask(b"XS?\n", STARTED_US).split(b"|")[0].split(b",")


def reset_cause(board) -> int:
    return int(board.ask(b"XH?\n", STARTED_US).split(b",")[3])


@pytest.mark.parametrize("loop", ["pass", "any(100)"])
def test_a_loop_that_hangs_with_a_motor_on_is_reset_and_the_next_one_says_so(make_board, loop):
    board = make_board()
    boot_id = state(board)[0]
    RawPrompt(board)
    board.send((HANGS % loop).encode() + b"\x04")
    board.run(500_000)
    board.send(b"02550255")
    board.run(100_000)
    assert not board.off()
    start = board.simulation.us
    assert board.run(HUNG_US + BITE_US, board.off)
    assert board.simulation.us - start > 500_000  # it was the watchdog
    board.simulation.lit = False
    board.boot()
    boot, _, waiting = state(board)
    assert boot != boot_id
    assert waiting == b"1"
    assert board.ask(b"TB?\n") == b"66, FIRMWARE HAD HUNG: BOARD WAS RESET\r\n"
    assert reset_cause(board) == 3
    assert board.ask(b"XH?\n").endswith(b",1\r\n")  # the gate is in place again
    assert board.off()


@pytest.mark.full
def test_a_wanted_reset_and_power_up_are_told_from_the_watchdogs(make_board):
    board = make_board()
    assert reset_cause(board) == 1
    RawPrompt(board)
    board.send(b"import machine; machine.reset()\x04")
    board.run(100_000)
    board.simulation.lit = False
    board.boot()
    assert reset_cause(board) == 2
    assert state(board)[2] == b"0"


@pytest.mark.full
def test_the_watchdog_never_bites_at_the_prompt_nor_in_a_long_write_nor_after_a_soft_reset(make_board):
    board = make_board()
    board.send(b"\x03")
    board.until(b">>> ")
    board.send(b"alive = 4711\r")
    board.until(b">>> ")
    board.run(5 * HUNG_US)
    board.send(b"for i in range(40): open('big', 'ab').write(bytes(4096))\r\r\r")  # 40 sectors are erased
    board.until(b">>> ")
    board.run(2 * HUNG_US)
    board.received.clear()  # the prompt that the last empty line brought
    board.send(b"print(alive)\r")
    assert b"4711" in board.until(b"\n>>> ")
    board.send(b"\x04")
    board.until(b"soft reboot")
    board.simulation.lit = False
    board.boot()
    boot = state(board)[0]
    board.run(5 * HUNG_US)
    assert state(board)[0] == boot
    assert reset_cause(board) == 1


def with_emergency_stop(make_board):
    board = make_board(bench="switches")
    prompt = RawPrompt(board)
    prompt.put("mountfw/boards/this.py", b"from mountfw.boards.pico import *\nEMERGENCY_STOP = 14\n")
    board.simulation.reset(power=True)
    board.run(1_000)
    board.simulation.lit = False
    board.boot()
    return board


def off_after_opening(board, switch: str) -> int:
    """Microseconds of the board's time from the switch's opening to the last enable's fall."""
    start = board.simulation.us
    board.simulation.bench.broken.add(switch)
    assert board.run(20_000, board.off)  # the legs fall by the loop, which is sending an echo
    return max(us for us, pin, _ in board.edges_after(start) if pin.endswith("_en")) - start


def test_the_emergency_stop_cuts_both_drives_and_latches(make_board):
    board = with_emergency_stop(make_board)
    board.send(b"02550255")
    assert board.run(50_000, lambda: not board.off())  # the start's garbage may be collected first
    board.run(20_000)
    assert off_after_opening(board, "emergency_stop") < 1_000
    board.until(b"02550255\r\n" + 4 * b"255\r\n")  # the frame's echo ends
    assert board.ask(b"1XE?;2XE?\n").startswith(b"10,")
    board.simulation.bench.broken.clear()
    board.send(b"02550255")
    board.run(20_000)
    assert board.off()
    board.send(b"*RST\n02540254")  # not the same frame again: so soon it would wait for what follows
    assert board.run(50_000, lambda: not board.off())


@pytest.mark.full
def test_an_emergency_stop_that_opens_while_a_frame_is_obeyed_cuts_at_once(make_board):
    board = with_emergency_stop(make_board)
    for opens_us in range(600, 780, 20):
        board.simulation.bench.broken.clear()
        board.ask(b"*RST\n*IDN?\n")
        board.send(b"01000100")  # takes the record of the position off the flash
        board.run(30_000)
        board.send(b"!")
        board.run(30_000)
        board.send(b"02550255")
        board.run(opens_us)
        start = board.simulation.us
        board.simulation.bench.broken.add("emergency_stop")
        board.run(20_000)
        late_us = max((us for us, pin, _ in board.edges_after(start) if pin.endswith("_en")), default=start) - start
        assert board.off() and late_us < 1_000, opens_us


def test_an_end_stop_cuts_the_drive_from_an_interrupt(make_board):
    board = make_board(bench="switches")
    board.send(b"1XL3;1DH0;1MV+\n")
    board.run(50_000)
    assert not board.off()
    assert off_after_opening(board, "m1_sw_pos") < 1_000
    board.run(5_000)
    assert board.ask(b"1XE?\n").startswith(b"4,")
    assert board.ask(b"TE?\n") == b"104\r\n"
