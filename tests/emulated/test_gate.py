"""The gate on a real image (docs/gate.md): stops and deadlines while Python hangs, split stops, and that it leaves."""

import random

import pytest
from lab import on_times_us

from mirrormount_sim.emulator import RawPrompt

USB_US = 10  # the emulated controller takes so long for a packet
CUT_US = USB_US + 10
LATE_US = 5
ENABLES = ("m1_en", "m2_en")
VECTORS = (
    "from machine import mem32; print([mem32[a] for a in (0x20000054, 0x20000040, 0xE000E400)], mem32[0x40054038] & 1)"
)

# the firmware's loop. After 2DH9 it hangs whenever a motor has drive. After 2DH8 it waits for the tap to find a stop
# while a motor has drive, and loses the bytes, as a reset of the bus may
LOOP = """
import micropython, sys, time
from machine import mem32
from mountfw.build import build
from mountfw.ports import micropython as port
from mountfw.ports.micropython_console import any
from mountfw.boards import pico
a = build(port, pico)
micropython.kbd_intr(-1)
a.gated.enter()
y, x = a.controller.axes
state = port._gate._state
print('gate', a.queries.about.gate)
while y.position.defined != 77:
    a.run_once()
    if x.position.defined == 9 and a.controller.driving():
        t = time.ticks_ms()
        while time.ticks_diff(time.ticks_ms(), t) < 900:
            pass
    if x.position.defined == 8 and a.controller.driving():
        x.position.defined = 0
        print('deaf')
        while mem32[state + 8] == a.gated.received or not any(0):
            pass
        while any(0):
            sys.stdin.buffer.read(1)
print('counts', mem32[state + 8], a.gated.received, mem32[state + 16], mem32[state + 48])
a._leave(1)
"""


@pytest.fixture
def board(make_board):
    board = make_board("rp2040")
    assert board.ask(b"XH?\n", 2_000_000).endswith(b",1\r\n")
    return board


@pytest.fixture
def prompt(board):
    prompt = RawPrompt(board)
    board.send(LOOP.encode() + b"\x04")
    board.until(b"gate 1\r\n")
    return prompt


def cut_after(board, data: bytes) -> int:
    """Send data, whose last byte completes a stop. Returns the us until both enables stay low."""
    board.simulation.edges.clear()
    sent_us = board.simulation.us
    board.send(data)
    board.run(2_000)
    assert not any(board.drives()[pin] for pin in ENABLES)
    return max((us for us, pin, _ in board.simulation.edges if pin in ENABLES), default=sent_us) - sent_us


def drive(board, frame: bytes = b"02550255") -> None:
    board.send(frame)
    assert board.run(50_000, lambda: all(board.drives()[pin] for pin in ENABLES))
    board.run(random.Random(frame).randrange(3_000))


def counts(board) -> list[int]:
    """Stops that the tap has found and those parsed; is it held?; late looks. The loop ends."""
    board.send(b"2DH0\n1DH77\n")
    return [int(n) for n in board.until(b"\x04>").split(b"counts ")[1].split()[:4]]


def test_a_stop_is_cut_within_microseconds_and_told(board):
    for stop in (b"!", b"00000000", b"XS?;TB?\n!", b"+0000000" + b"0"):
        drive(board)
        assert cut_after(board, stop) <= CUT_US
        board.run(200_000)  # the answers before it are sent: a byte takes 0.6 ms
        assert board.ask(b"\n1XE?\n").startswith((b"2,", b"3,")), stop
    drive(board)
    cut_after(board, b"!")


@pytest.mark.full
def test_it_leaves_before_the_prompt_and_comes_again_after_a_soft_reset(board):
    drive(board)
    board.send(b"\x03")
    board.until(b"\n>>> ")
    assert board.off()
    board.send(VECTORS.encode() + b"\r")
    out = board.until(b"\n>>> ").split(b"\n")[1]
    prompt = RawPrompt(board)
    prompt.reset()  # main.py has not run since
    assert prompt.run(VECTORS).encode().strip() == out.strip()
    assert prompt.run("print(mem32[0x20000040] == mem32[0x20000044], mem32[0x40014014] & 0x300)") == "True 0\r\n"
    board.send(b"\x02\x04")
    board.until(b"soft reboot")
    board.simulation.lit = False
    board.boot()
    assert board.ask(b"XH?\n", 5_000_000).endswith(b",1\r\n")


def test_stops_and_deadlines_hold_while_the_loop_hangs(board, prompt, capsys):
    board.send(b"1XM300;2XM200;1XP100000;2DH9\n")
    board.run(50_000)
    board.simulation.edges.clear()
    board.send(b"1PR1\n")
    board.run(1_500_000)
    (pulse_us,) = on_times_us(board.simulation.edges, "m1_en")
    board.simulation.edges.clear()
    board.send(b"02550255")
    board.run(3_000_000)
    runs_us = [on_times_us(board.simulation.edges, pin)[0] for pin in ENABLES]
    assert [pulse_us, *runs_us] == pytest.approx([100_000, 300_000, 200_000], abs=LATE_US)
    drive(board)
    cut_us = cut_after(board, b"!")
    assert cut_us <= CUT_US
    board.run(3_000_000)
    assert board.ask(b"1XE?\n", 3_000_000).startswith(b"3,")
    found, parsed, held, _late = counts(board)
    assert (found, held) == (parsed, 0)
    with capsys.disabled():
        print(f" [while the loop hangs: pulse {pulse_us}, runs {runs_us}, cut after {cut_us - USB_US} us]", end="")


@pytest.mark.full
def test_the_tap_and_the_parser_count_alike_however_stops_are_split(board, prompt):
    chosen = random.Random(4)
    for _ in range(60):
        text = b"".join(
            chosen.choice((b"0", b"000", b"00000000", b"!", b"0255", b"-100", b"TB?\n", b"x")) for _ in range(40)
        )
        while text:
            cut = chosen.randrange(1, 66)
            board.send(text[:cut])
            board.run(chosen.choice((0, 20, 70, 400)))
            text = text[cut:]
    board.run(200_000)
    board.send(b"!\n")
    board.run(300_000)
    found, parsed, held, _late = counts(board)
    assert found == parsed > 100
    assert not held


@pytest.mark.full
def test_a_stop_whose_bytes_are_lost_ends_the_moves_and_the_drives_are_released(board, prompt):
    board.send(b"2DH8\n")
    board.run(50_000)
    drive(board)
    board.until(b"deaf")
    assert cut_after(board, b"!") <= CUT_US
    board.run(600_000)  # 50 ms after the last packet, and a sleep later, the loop has missed the stop
    assert board.ask(b"\n1XE?\n").startswith(b"3,")
    drive(board, b"02540254")
    assert cut_after(board, b"!") <= CUT_US
    board.run(200_000)
    found, parsed, held, _late = counts(board)
    assert (found, held) == (parsed, 0)
