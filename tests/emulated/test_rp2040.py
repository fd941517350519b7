"""What only the real image can show: memory, resets, power cuts, Ctrl-C at any moment."""

import random

import pytest
from test_memory import SESSION

from mirrormount_sim.emulator import RawPrompt

TRIALS = 200
LEAST_FREE = 100_000  # bytes of heap on a Pico


def test_free_memory_of_the_running_firmware(make_board, capsys):
    board = make_board()
    board.send(b"\x03")
    board.until(b">>> ")
    board.send(b"import gc; gc.collect(); print('free', gc.mem_free())\r")
    said = board.until(b"\r\n>>> ").decode()
    free = int(said.split("free ")[-1].split()[0])
    with capsys.disabled():
        print(f" [free heap with the firmware loaded: {free} bytes]", end="")
    assert free >= LEAST_FREE


@pytest.mark.full
def test_ctrl_c_twice_at_random_moments_of_a_pulse_leaves_both_motors_off(make_board):
    board = make_board()
    moments = random.Random(11)
    for trial in range(TRIALS):
        board.send(b"!\n1XP20000;2XP20000;1VA40;2VA40;1PR50;2PR-50\n")
        board.run(40_000 + moments.randrange(50_000))
        board.received.clear()
        board.send(b"\x03")
        board.run(moments.choice((0, 0, 30, 100, 300, 1_000, 3_000)))
        board.send(b"\x03")
        board.until(b">>> ")
        board.run(5_000)
        assert board.off(), f"trial {trial}: {board.drives()}"
        board.simulation.lit = False
        board.received.clear()
        board.send(b"exec(open('main.py').read())\r")  # as after Ctrl-D, without compiling it all again
        board.boot()


def test_a_hard_reset_in_mid_move_turns_the_motors_off_and_starts_anew(make_board):
    board = make_board()
    first = board.ask(b"XS?\n").split(b",")[0]
    board.send(b"02550255")
    board.run(20_000)
    assert not board.off()
    board.simulation.reset(power=False)
    board.run(1_000)
    assert board.off()
    board.simulation.lit = False
    board.boot()
    assert board.ask(b"XS?\n", 2_000_000).split(b",")[0] != first


@pytest.mark.full
def test_a_power_cycle_starts_the_firmware_by_itself(make_board):
    board = make_board()
    board.send(b"1MV+\n")
    board.run(20_000)
    board.simulation.reset(power=True)
    board.run(1_000)
    assert board.off()
    board.simulation.lit = False
    board.boot()
    assert board.ask(b"*IDN?\n", 2_000_000).startswith(b"mirrormount,")


LOCKED_LOOP = """
import micropython, time
from mountfw.build import build
from mountfw.ports import micropython as port
from mountfw.boards import pico
a = build(port, pico)
queries = a._commands.queries
while queries.hash is None:
    queries.read_files()  # file work, which SESSION's XF? would start
def go(ms):
    passes = 0
    end = time.ticks_add(time.ticks_ms(), ms)
    while time.ticks_diff(end, time.ticks_ms()) > 0:
        micropython.heap_lock()
        try:
            a.run_once()
        finally:
            micropython.heap_unlock()
        passes += 1
    print('passes', passes)
    port.motors_off(pico)
go(9000)
"""


def test_the_loop_allocates_nothing_on_the_real_image(make_board):
    # with the heap locked an allocation raises at its line; here a big integer is one, too
    board = make_board()
    prompt = RawPrompt(board)
    board.send(LOCKED_LOOP.encode() + b"\x04")
    board.until(b"OK")
    for data in SESSION:
        board.send(data)
        board.run(400_000)
    said = board.until(b"\x04>")
    assert b"Error" not in said, said[-400:]
    passes = int(said.split(b"passes ")[1].split()[0])
    assert passes > 300
    assert board.off()
    assert prompt.run("print(1)") == "1\r\n"


@pytest.mark.full
def test_the_clock_of_the_image_wraps_as_the_firmware_thinks(make_board):
    prompt = RawPrompt(make_board())
    said = prompt.run("import time; print(time.ticks_diff(0, (1 << 30) - 1), time.ticks_add((1 << 30) - 1, 2))")
    assert said == "1 1\r\n"


AS_NATIVE = """
import micropython, random
from mountfw.boards import pico
from mountfw.ports import micropython_console as console
from mountfw.wire import frame
from mountfw.ports import rp2_lane
from mountfw.wire import receiver
random.seed(%d)
for _ in range(400):
    ring = bytearray([random.choice(b'000+-112255589:/\\x21\\xb0') for _ in range(16)])
    at = random.randrange(64)
    if console.pack(ring, at, 15) != frame.pack(ring, at, 15):
        print('pack', ring, at)
fast, slow = [receiver.Receiver(None, None, None, 256) for _ in range(2)]
class Plain: pass
controller, axis, drive = Plain(), Plain(), Plain()
drive.bridge = None
axis.drive = drive
controller.axes = axis, axis
pico.LANE = False
lane = rp2_lane.lane(controller, fast, None, None, None, pico)
sent = bytes(%r)
micropython.kbd_intr(-1)
for start in range(0, len(sent), 200):
    fast.unparsed = slow.unparsed = 0
    print('more')
    stops = []
    while fast.unparsed < min(200, len(sent) - start):
        if console.any(1000):
            stops.append(lane.read(7, -1) if start else console.drain(fast, 7))
    if [s for s in stops if s] != [s for s in [slow.receive(c) for c in sent[start : start + 200]] if s]:
        print('stops', start, stops)
    if (fast.ring, fast.write, fast.zeros, fast.stops_ahead) != (slow.ring, slow.write, slow.zeros, slow.stops_ahead):
        print('ring', start)
micropython.kbd_intr(3)
"""


@pytest.mark.full
def test_the_native_code_does_what_the_readable_code_says(make_board):
    board = make_board()
    RawPrompt(board)
    chosen = random.Random(3)
    sent = bytes(chosen.choice(b"00000000000!\x03\xff\x80a1\n") for _ in range(1000))
    board.send((AS_NATIVE % (3, sent)).encode() + b"\x04")
    board.until(b"OK")
    for start in range(0, len(sent), 200):
        assert board.until(b"more\r\n") == b"more\r\n"
        board.send(sent[start : start + 200])
    assert board.until(b"\x04>") == b"\x04\x04>"
