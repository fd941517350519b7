"""Mounts and spots as devices of Bluesky, without EPICS: pins, documents, and the examples."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from iocs import Client
from served import run_process

EXAMPLES = Path(__file__).parents[2] / "docs/examples"
BEGIN = """
import sys, threading
import bluesky.plans as bp, bluesky.plan_stubs as bps
from bluesky import RunEngine
from bluesky.utils import FailedStatus
from ophyd_async.core import init_devices
from mirrormount.supervise import Supervisor
from mirrormount_bluesky import MountAxis
RE, rows = RunEngine({}), []
supervisor = Supervisor(os.environ["MOUNT"]).open()
program = supervisor.join("bluesky")
program.take_control()
with init_devices():
    x, y = MountAxis(supervisor, program, "x"), MountAxis(supervisor, program, "y")
def keep(name, document):
    if name == "event":
        rows.append((document["data"]["x"], document["data"].get("y")))
def failed(plan):
    try:
        RE(plan)
    except FailedStatus as e:
        return str(e.__cause__)
    raise AssertionError("it did not fail")
"""


@pytest.fixture
def native(board):
    """Runs code in a process that has the board's axes as devices."""
    return lambda code: Client(BEGIN + code, {"MOUNT": str(board.link)})


def test_plans_record_where_it_was_when_a_move_was_done(native, board):
    *_, rows = native("""
RE(bp.scan([], x, -2, 2, 5), keep)
RE(bp.grid_scan([], y, -1, 1, 2, x, -1.2, 1.2, 2), keep)  # to the nearest whole step
print(rows)
supervisor.close()
""").end()
    scan = [(float(place), None) for place in range(-2, 3)]
    assert rows == str([*scan, (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)])
    assert not board.driving()


def test_after_a_stop_by_somebody_else_a_plan_fails_and_nothing_moves_before_control_is_taken(native, board, drives):
    client = native("""
threading.Thread(target=lambda: event("begun")).start()
print(failed(bps.mv(x, 50)))
event("stopped")
assert "control" in failed(bps.mv(x, 0)), "without control"
RE(bps.stop(x))  # raises nothing
event("refused")
program.take_control()
RE(bps.mv(x, -2))
supervisor.close()
""")
    client.until("begun")
    drives()
    assert run_process("stop", "--port", str(board.link)).returncode == 0
    client.go_on()
    client.until("stopped")
    edges = len(board.edges())
    client.go_on()
    client.until("refused")
    assert len(board.edges()) == edges
    client.go_on()
    client.end()
    assert len(board.edges()) > edges


def test_a_pause_and_a_run_engine_that_hangs_stop_the_mount(native, board):
    native("""
def pause():
    yield from bps.abs_set(x, 50)
    while not supervisor.status.moving:
        yield from bps.sleep(0.01)
    yield from bps.pause()
try:
    RE(pause())
except Exception:
    pass
wait_for(lambda: not supervisor.status.moving, "the motors to rest")
try:
    RE.abort()
except Exception:
    pass
def hang():
    yield from bps.abs_set(x, -50, group="move")
    while not supervisor.status.moving:
        yield from bps.sleep(0.01)
    RE.loop.call_soon_threadsafe(over.wait)
    yield from bps.wait("move")
over = threading.Event()
def release():
    wait_for(lambda: "silent" in supervisor.worker.stop_cause and not supervisor.status.moving, "the stop")
    over.set()
threading.Thread(target=release).start()
assert "aborted" in failed(hang())
supervisor.close()
""").end()
    assert not board.driving()


def test_what_is_no_position_moves_nothing(native, board):
    native("""
for position in (float("nan"), float("inf"), 1e9):
    failed(bps.mv(x, position))
RE(bps.mv(x, 0))
supervisor.close()
""").end()
    assert board.edges() == []


def test_the_notebook_of_the_examples_aligns_a_virtual_mirror(tmp_path):
    code = """
import nbformat, sys
from nbclient import NotebookClient
book = nbformat.read(sys.argv[1], 4)
NotebookClient(book, timeout=600, kernel_name="python3").execute()
print([output.get("text") for cell in book.cells for output in cell.get("outputs", ())])
"""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, str(EXAMPLES / "align.ipynb")],
        cwd=EXAMPLES,
        env=os.environ | {"IPYTHONDIR": str(tmp_path), "JUPYTER_RUNTIME_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr
    assert "spot-x" in done.stdout


@pytest.mark.full
def test_a_spiral_finds_a_beam_and_a_walk_looks_at_each_place():
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PLANS], cwd=EXAMPLES, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[(-2.0, 2.0), (0.0, 0.0), (2.0, -2.0)]"


PLANS = """
from bluesky import RunEngine
from ophyd_async.core import init_devices
from plans import spiral, spiral_search, walk

from mirrormount.supervise import Supervisor
from mirrormount_bluesky import CameraSpot, MountAxis
from mirrormount_sim.table import open_table

assert len(set(spiral(4, 2))) == len(list(spiral(4, 2))) == 25
RE, rows = RunEngine({}, call_returns_result=True), []
table = open_table("virtual-table://?mounts=1&cameras=1&speed=1")
supervisor = Supervisor(lambda: table.ports[0]).open()
program = supervisor.join("bluesky")
program.take_control()
with init_devices():
    x, y = MountAxis(supervisor, program, "x"), MountAxis(supervisor, program, "y")
    spot = CameraSpot(table.cameras[0])
look = spot._look  # and it finds no spot but where this test wants one
spot._look = lambda: look() if supervisor.status.by_name["y"].position >= 2 else (0, *[float("nan")] * 7)
assert RE(spiral_search(spot, x, y, reach=2)).plan_result is True
assert supervisor.status.by_name["y"].position == 2
spot._look = lambda: (0, *[float("nan")] * 7)
assert RE(spiral_search(spot, x, y, reach=1, pitch=1)).plan_result is False
assert supervisor.status.by_name["y"].position == 2  # back at the start
program.move_to("x", 0).wait(); program.move_to("y", 0).wait()  # past the devices: plans begin where it is
def keep(name, document):
    if name == "event":
        rows.append((document["data"]["x"], document["data"]["y"]))
RE(walk(spot, x, y, reach=2, num=3), keep)
supervisor.close()
table.close()
print(rows)
"""
