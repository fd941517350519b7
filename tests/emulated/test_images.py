"""The firmware on every official MicroPython image of a folder, in the emulated Pico (images.py says which folder).

The board has the Pico's pins, whatever board the image is of. The tests of an image go through one board, in order.
"""

import re
import subprocess
import sys

import pytest
from images import images
from lockstep_board import Board
from served import HANG_S, ServedBoard, run_cli, wait_for

from mirrormount.deploy.firmware import THIS, board_choice, firmware
from mirrormount.device.mount import Mount
from mirrormount.errors import MountError
from mirrormount_sim import emulator
from mirrormount_sim.board import Options

pytestmark = pytest.mark.full

IMAGES = images(circuitpython=False)
MPY = 6
STEP_US = 100_000


@pytest.fixture(scope="module", params=IMAGES, ids=lambda image: image.name)
def image(request):
    return request.param


@pytest.fixture(scope="module")
def running(image, tmp_path_factory):
    """A board whose flash holds the firmware as deploy compiles it."""
    flash = tmp_path_factory.mktemp("image") / "flash.bin"
    files = firmware(MPY) | {THIS: board_choice("pico")}
    flash.write_bytes(emulator.flash_with_firmware(image, files).read_bytes())
    board = Board(Options(machine="rp2040", bench="switches", image=image, flash=flash))
    yield board
    board.simulation.close()


@pytest.fixture
def board(running):
    """The board, both motors at rest and the errors read."""
    running.send(b"!\n")
    running.run(300_000)
    while running.ask(b"TE?\n", 2_000_000) not in (b"0\r\n", b""):
        pass
    return running


def test_it_starts_and_tells_who_it_is(board):
    assert re.match(rb"mirrormount,[^,]+,[0-9a-f]{16},[0-9.]+\r\n", board.ask(b"*IDN?\n"))


def test_it_hashes_its_files(board):
    assert re.fullmatch(rb"sha256-[0-9a-f]{64}\r\n", board.ask(b"XF?\n", 3_000_000))


@pytest.mark.parametrize(("command", "pins"), [
    (b"1PR1\n", ["m1_pos", "m1_en"]), (b"1PR-1\n", ["m1_neg", "m1_en"]),
    (b"2PR1\n", ["m2_pos", "m2_en"]), (b"2PR-1\n", ["m2_neg", "m2_en"])])  # fmt: skip
def test_a_step_is_one_pulse_of_its_length_on_its_pins(board, command, pins):
    board.send(b"1XP%d;2XP%d\n" % (STEP_US, STEP_US))
    board.run(50_000)
    since = board.simulation.us
    board.send(command)
    board.run(STEP_US + 400_000)
    edges = board.edges_after(since)
    assert [pin for _, pin, duty in edges if duty] == pins
    on, off = (us for us, pin, _ in edges if pin.endswith("_en"))
    assert abs(off - on - STEP_US) < 50


@pytest.mark.parametrize("stop", [b"!\n", b"00000000", b"\x03"], ids=["mark", "zeros", "ctrl-c"])
@pytest.mark.parametrize("motion", [b"02550255", b"1MV+\n", b"1PR30;2PR-30\n"], ids=["frame", "run", "steps"])
def test_a_stop_has_every_pin_low_within_two_milliseconds(board, stop, motion):
    board.send(motion)
    assert board.run(1_000_000, lambda: not board.off())
    board.run(30_000)
    assert not board.off()
    start = board.simulation.us
    board.send(stop)
    assert board.run(10_000, board.off)
    assert max(us for us, _, _ in board.edges_after(start)) - start < 2_000
    if stop == b"\x03":
        board.until(b">>> ")
        board.simulation.lit = False
        board.send(b"\x04")
        board.boot()
        board.received.clear()


def test_an_end_stop_ends_a_run_from_an_interrupt(board):
    board.send(b"1XL3;1DH0;1MV+\n")
    assert board.run(1_000_000, lambda: not board.off())
    board.run(30_000)
    start = board.simulation.us
    board.simulation.bench.broken.add("m1_sw_pos")
    assert board.run(5_000, board.off)
    assert max(us for us, pin, _ in board.edges_after(start) if pin == "m1_en") - start < 1_000
    board.simulation.bench.broken.clear()
    assert board.ask(b"TE?\n") == b"104\r\n"
    board.send(b"1XL0\n")


def test_a_host_that_falls_silent_stops_what_moves(board):
    board.send(b"1XK300;1MV+\n")
    assert board.run(1_000_000, lambda: not board.off())
    assert board.run(600_000, board.off)
    board.send(b"1XK0\n")


def moving(board) -> None:
    """Run both motors, and have a long line of queries executed at the same time."""
    board.send(b"1MV+;2MV-\n")
    assert board.run(1_000_000, lambda: not board.off())
    board.run(30_000)
    board.send(b"XS?\n" * 30)
    board.run(20_000)
    assert not board.off()


@pytest.mark.parametrize("stop", [b"!\n", b"00000000", b"ST\n"], ids=["mark", "zeros", "st"])
def test_a_stop_behind_thirty_queries_has_every_pin_low(board, stop):
    moving(board)
    start = board.simulation.us
    board.send(stop)
    assert board.run(300_000, board.off)
    since = max(us for us, _, _ in board.edges_after(start)) - start
    assert since < (300_000 if stop == b"ST\n" else 3_000)
    board.run(500_000)
    assert board.off()
    board.received.clear()


def test_five_hundred_frames_a_second_are_all_obeyed(board):
    since = board.simulation.us
    for frame in range(100):
        board.send(b"-255-255" if frame % 2 else b"02550255")
        board.run(2_000)
    board.run(100_000)
    board.send(b"!\n")
    board.run(20_000)
    assert board.off()
    rises = [pin for _, pin, duty in board.edges_after(since) if duty and pin in ("m1_pos", "m1_neg")]
    assert rises == ["m1_pos", "m1_neg"] * 50


def test_its_own_replies_sent_back_drive_nothing(board):
    since = board.simulation.us
    for question in (b"*IDN?;1XP?\n", b"2XS?\n", b"XS?\n"):
        reply = board.ask(question, 2_000_000)
        board.send(reply)
        board.run(100_000)
    assert not [edge for edge in board.edges_after(since) if edge[2]]


def test_a_position_at_rest_is_there_after_a_power_cut(board):
    board.send(b"1XP100000;SM;1DH0;1PR3\n")
    board.run(13_000_000)
    board.simulation.lit = False
    board.simulation.reset(power=True)
    board.run(1_000)
    board.boot()
    assert board.ask(b"1TP?\n", 2_000_000) == b"3\r\n"


def test_homing_finds_the_end_stop(board):
    board.send(b"1XL3;1OR\n")
    assert board.run(2_000_000, lambda: not board.off())
    board.run(60_000)
    board.simulation.bench.broken.add("m1_sw_neg")
    assert board.run(5_000_000, lambda: board.ask(b"1MD?\n") == b"1\r\n")
    assert board.off()
    board.simulation.bench.broken.clear()
    assert board.ask(b"1OR?\n").count(b",") == 1
    board.send(b"!\n1XL0\n")


def test_a_frame_at_half_duty_drives_both_motors_by_pwm(board):
    board.send(b"01280128")
    assert board.run(1_000_000, lambda: not board.off())
    board.run(30_000)
    since = board.simulation.us
    board.run(30_000)
    assert {pin for pin, duty in board.drives().items() if duty} >= {"m1_pos", "m2_pos"}
    assert {(pin, duty > 0) for _, pin, duty in board.edges_after(since)} == {
        (pin, on) for pin in ("m1_en", "m2_en") for on in (True, False)}  # fmt: skip


def test_the_loop_leaves_the_heap_as_it_is(board):
    free = int(board.ask(b"XH?\n").split(b",")[0])
    board.send(b"1PR1\n")
    board.run(600_000)
    assert int(board.ask(b"XH?\n").split(b",")[0]) == free


def test_the_prompt_has_the_mount(board):
    board.send(b"\x03")
    board.until(b">>> ")
    board.send(b"from mountfw.repl import m\r")
    board.until(b">>> ")
    since = board.simulation.us
    board.send(b"m.x.step(1); print('done')\r")
    board.until(b"\ndone")
    board.run(500_000)
    assert [pin for _, pin, duty in board.edges_after(since) if duty] == ["m2_pos", "m2_en"]
    board.simulation.lit = False
    board.received.clear()
    board.send(b"\x04")
    board.boot()


def test_a_reset_turns_off_and_saved_settings_are_there_after_it(board):
    board.send(b"1XP150000;SM\n")
    board.run(500_000)
    board.send(b"1MV+\n")
    board.run(60_000)
    assert not board.off()
    board.simulation.lit = False
    board.simulation.reset(power=False)
    board.run(1_000)
    assert board.off()
    board.boot()
    assert board.ask(b"1XP?\n", 2_000_000) == b"150000\r\n"


def test_a_power_cut_turns_off_and_it_starts_by_itself(board):
    board.send(b"1MV+\n")
    board.run(60_000)
    board.simulation.lit = False
    board.simulation.reset(power=True)
    board.run(1_000)
    assert board.off()
    board.boot()
    assert board.ask(b"*IDN?\n", 2_000_000).startswith(b"mirrormount,")


@pytest.fixture(scope="module")
def blank(image, tmp_path_factory):
    """A served board with nothing but the image. The tests below go through it in order."""
    folder = tmp_path_factory.mktemp("blank")
    board = ServedBoard(folder, "--machine", "rp2040", "--image", str(image), "--flash", str(folder / "flash.bin"))
    yield board
    board.kill()
    board.process.stdout.close()


def execute(board: ServedBoard, code: str) -> str:
    """What the board's Python prints; tried again while a restarting board's port is away."""
    words = [sys.executable, "-m", "mpremote", "connect", str(board.link), "exec", f"{code}\nprint('done')"]

    def printed() -> str:
        run = subprocess.run(words, capture_output=True, text=True, timeout=HANG_S)
        return run.stdout if run.stdout.endswith("done\n") else ""

    return wait_for(printed, "the board's prompt")


def test_a_full_flash_is_refused_and_nothing_stays(blank):
    piece = (
        "import os\nf = open('data', 'wb')\nfor i in range(os.statvfs('/')[3] - 12): f.write(bytes(4096))\nf.close()"
    )
    execute(blank, piece)
    run = run_cli("deploy", "--port", str(blank.link), "--board", "pico")
    assert run.returncode == 1
    assert "flash is full" in run.stderr
    listed = execute(blank, "import os; print(*os.listdir('/'))").split()
    assert not [name for name in listed if name.endswith(".new")]
    execute(blank, "import os; os.remove('data')")


def test_a_foreign_main_py_is_not_replaced_unasked(blank):
    execute(blank, "f = open('main.py', 'w'); f.write('print(7)'); f.close()")
    run = run_cli("deploy", "--port", str(blank.link), "--board", "pico")
    assert run.returncode == 1
    assert "--replace-main" in run.stderr
    assert execute(blank, "print(open('main.py').read())").split() == ["print(7)", "done"]


def test_deploy_and_undeploy_with_mpremote(blank):
    port = ("--port", str(blank.link))
    deployed = run_cli("deploy", *port, "--board", "pico", "--replace-main")
    assert deployed.returncode == 0, deployed.stderr
    with wait_for(lambda: _opened(blank), "the firmware to answer") as mount:
        mount.x.step(1)
    assert "m2_en" in [edge["pin"] for edge in blank.edges()]
    assert run_cli("undeploy", *port).returncode == 0


def test_undeploy_gives_a_foreign_main_py_back(blank):
    assert execute(blank, "print(open('main.py').read())").split() == ["print(7)", "done"]


def _opened(board):
    try:
        return Mount.open(str(board.link))
    except MountError:
        return None
