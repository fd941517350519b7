"""The page of a mount in a notebook, with a real kernel: its STOP waits for no cell, and it keeps nothing alive."""

import json
import re
import threading
import urllib.error
from concurrent.futures import ThreadPoolExecutor

import pytest
from kernel import Kernel, get, post
from served import wait_for

from mirrormount import errors
from mirrormount.device.mount import Mount
from mirrormount.notebook import show

pytestmark = pytest.mark.slow
INTERRUPTED = "STOP was sent; the running cell is interrupted"

OPEN = """
from mirrormount import Mount
from mirrormount.notebook import show
mount = Mount.open("virtual://")
duties = lambda: sorted(mount.link.port.simulation.bench.duties().items())
on = lambda: any(duty for _, duty in duties())
view = show(mount)
print(view.url)
view
"""


class Page:
    """The page's own requests."""

    def __init__(self, url: str) -> None:
        self.url = url

    @property
    def state(self):
        return json.loads(get(f"{self.url}state"))

    def order(self, **order):
        return post(f"{self.url}order", {"tick": self.state["tick"], **order})

    def stop(self):
        return post(f"{self.url}stop")


@pytest.fixture
def kernel():
    with Kernel() as kernel:
        yield kernel


@pytest.fixture
def page(kernel):
    printed, shown = kernel.run(OPEN)
    page = Page(printed.strip())
    assert page.url in shown["text/html"]
    return page


def test_stop_ends_a_cell_that_moves_at_once_and_the_next_cell_goes_on(kernel, page):
    cell = kernel.begin("print('begun', flush=True)\nfor _ in range(99): mount.x.step(9)", until="begun")
    wait_for(lambda: page.state["axes"][0][3], "the motion")
    assert page.stop() == (200, INTERRUPTED)
    assert kernel.see(cell)[-1] == "KeyboardInterrupt: "
    assert kernel.run("print(on(), mount.status().moving); mount.x.step(1); print(mount.x.last_move().steps)") == [
        "False False\n1\n"
    ]


@pytest.mark.parametrize("waits", ["while True: pass", "import time; time.sleep(3600)", "input_ = open(fifo).read()"])
def test_stop_ends_a_cell_between_two_moves_too(kernel, page, tmp_path, waits):
    kernel.run(f"import os; fifo = {str(tmp_path / 'fifo')!r}; os.mkfifo(fifo)")
    cell = kernel.begin(f"print('begun', flush=True)\n{waits}", until="begun")
    assert page.stop() == (200, INTERRUPTED)
    assert kernel.see(cell)[-1] == "KeyboardInterrupt: "


def test_stop_ends_what_an_earlier_cell_has_left_running(kernel, page):
    assert kernel.run("mount.y.jog(0.5); print(on())") == ["True\n"]
    page.stop()
    assert kernel.run("print(on(), mount.status().moving)") == ["False False\n"]


def test_a_step_is_made_only_while_no_cell_runs(kernel, page):
    assert page.order(axis="x", n=1) == (200, "")
    assert page.state["axes"][0][:2] == ["x", "+1.000"]
    cell = kernel.begin("print('begun', flush=True)\nmount.sleep(60)", until="begun")
    assert not page.state["free"]
    status, said = page.order(axis="x", n=1)
    assert status == 409 and "a cell is running" in said
    page.stop()
    kernel.see(cell)
    assert kernel.run("print(mount.x.position)") == ["1.0\n"]


def test_a_cell_within_a_cell_gives_no_turn_away(kernel, page):
    cell = kernel.begin("get_ipython().run_cell('1')\nprint('begun', flush=True)\nwhile True: pass", until="begun")
    assert not page.state["free"]
    page.stop()
    kernel.see(cell)
    wait_for(lambda: page.state["free"], "the end of the cell")


# ---- a page that is busy


@pytest.fixture
def aside():
    """Does something of the test beside the test."""
    with ThreadPoolExecutor() as pool:
        yield pool.submit


SLOW = """
import os
os.mkfifo(fifo)
class Camera:
    last = None
    def png(self): return None
    def spot(self): open(fifo).read()  # until the test has opened it and closed it
camera = Camera()
print(show(mount, camera).url)
class Begins:
    def visit(self, code):
        print("begins", flush=True)
        return code
get_ipython().ast_transformers.insert(0, Begins())
"""


@pytest.fixture
def slow(kernel, page, tmp_path):
    """The page of a camera, and the file that must be opened and closed for a look at it."""
    fifo = tmp_path / "fifo"
    return Page(kernel.run(f"fifo = {str(fifo)!r}{SLOW}")[0].strip()), fifo


STEP = "mount.y.step(5)"
AWAITING_STEP = f"import asyncio; {STEP}; await asyncio.sleep(0)"
NOT_RUN = "InputRejected: this cell was not run: STOP came before its first line; run it again"


@pytest.mark.parametrize(
    ("cell", "stop", "said"),
    [
        (STEP, "page", ("KeyboardInterrupt: ", NOT_RUN)),
        (STEP, "toolbar", ("KeyboardInterrupt: ",)),
        (AWAITING_STEP, "page", (NOT_RUN,)),
    ],
)
def test_a_cell_that_waits_for_the_page_is_not_run_after_a_stop(kernel, slow, aside, cell, stop, said):
    page, fifo = slow
    look = aside(page.order)
    with fifo.open("w"):  # the look is under way
        number = kernel.begin(cell, until="begins")
        kernel.interrupt() if stop == "toolbar" else page.stop()
    look.result()
    *before, end = kernel.see(number)
    assert end in said and not "".join(before).strip()
    assert kernel.run("print(on(), mount.y.position)") == ["begins\nFalse 0.0\n"]
    assert kernel.run("mount.y.step(1); print(mount.y.position)") == ["begins\n1.0\n"]


def test_the_page_does_nothing_while_a_cell_runs_that_waited_for_it_in_vain(kernel, slow, aside):
    page, fifo = slow
    kernel.run("import mirrormount.notebook; mirrormount.notebook._OTHERS_S = 0")
    look = aside(page.order)
    with fifo.open("w"):
        number = kernel.begin("print('runs', flush=True)\nmount.sleep(60)", until="runs")
    assert look.result() == (200, "")
    assert not page.state["free"]
    status, said = page.order(axis="x", n=1)
    assert status == 409 and "a cell is running" in said
    page.stop()
    kernel.see(number)


def test_a_stop_interrupts_the_cell_though_the_port_of_the_mount_hangs(kernel, slow, aside):
    page, fifo = slow
    kernel.run("halt = mount.halt\nmount.halt = lambda: (camera.spot(), halt())")
    number = kernel.begin("print('runs', flush=True)\nwhile True: pass", until="runs")
    stop = aside(page.stop)
    with fifo.open("w"):
        assert kernel.see(number)[-1] == "KeyboardInterrupt: "
    assert stop.result() == (200, INTERRUPTED)


TABLE = """
from mirrormount_beam.estimates import Result
from mirrormount_beam.experiments import steps
from mirrormount_beam.experiments.rig import MountRig
from mirrormount_beam.observe import SpotObserver
from mirrormount_beam.scan import raster, scan, spot_signal
from mirrormount_sim.table import open_table
table = open_table("virtual-table://?mounts=1&cameras=1&speed=1")
seen = table.mount()
camera = table.cameras[0]
pins = lambda: any(table.simulations[0].bench.duties().values())
"""


@pytest.mark.parametrize(
    "cell",
    [
        "list(scan(seen, raster(9, 9), spot_signal(camera)))",
        "steps.run(MountRig(seen, SpotObserver(camera)), Result('steps'), lambda *_: None)",
    ],
)
def test_an_interrupted_scan_or_measurement_leaves_the_motors_off(kernel, cell):
    kernel.run(TABLE)
    url = kernel.run("from mirrormount.notebook import show\nprint(show(seen).url)")[0].strip()
    number = kernel.begin(f"print('begun', flush=True)\n{cell}", until="begun")
    wait_for(lambda: any(axis[3] for axis in Page(url).state["axes"]), "the motion")
    kernel.interrupt()
    assert kernel.see(number)[-1] == "KeyboardInterrupt: "
    assert kernel.run("print(pins(), seen.status().moving); seen.y.step(1); print(seen.y.last_move().steps)") == [
        "False False\n1\n"
    ]


@pytest.mark.parametrize(
    "cell", ["mount.x.step(500)", "mount.x.jog(0.5); mount.sleep(60)", "mount.drive(100, 100); mount.sleep(60)"]
)
def test_an_interrupted_cell_leaves_the_motors_off_and_the_mount_open(kernel, page, cell):
    number = kernel.begin(f"print('begun', flush=True)\n{cell}", until="begun")
    wait_for(lambda: any(axis[3] for axis in page.state["axes"]), "the motion")
    kernel.interrupt()
    assert kernel.see(number)[-1] == "KeyboardInterrupt: "
    assert kernel.run("print(on(), mount.status().moving); mount.y.step(1); print(mount.y.last_move().steps)") == [
        "False False\n1\n"
    ]


@pytest.mark.parametrize("motion", ["mount.x.jog(0.5)", "mount.x.step(500, wait=False)"])
def test_an_interrupted_cell_stops_also_what_it_does_not_wait_for(kernel, motion):
    kernel.run(OPEN)
    number = kernel.begin(f"import time\n{motion}; print('begun', flush=True)\ntime.sleep(60)", until="begun")
    kernel.interrupt()
    assert kernel.see(number)[-1] == "KeyboardInterrupt: "
    assert kernel.run("print(mount.status().moving, on()); mount.y.step(1); print(mount.y.last_move().steps)") == [
        "False False\n1\n"
    ]


def test_the_page_keeps_no_motion_alive_that_its_cell_feeds_no_more(kernel, page):
    kernel.run("mount.x.jog(0.5, feed=False)")
    # the board's own keep-alive ends it, although the page goes on looking
    wait_for(lambda: page.state["free"] and kernel.run("print(on())") == ["False\n"], "the end of the motion")
    assert kernel.run("print([error.code for error in mount.errors()])") == ["[62]\n"]


def test_a_mount_that_nobody_has_any_more_is_not_kept_by_its_page(kernel, page):
    kernel.run("simulation = mount.link.port.simulation; mount.y.jog(0.5)")
    kernel.run("del mount, view, _, __, ___")
    wait_for(
        lambda: kernel.run("print(any(simulation.bench.duties().values()))") == ["False\n"], "the end of the motion"
    )

    def gone():
        try:
            get(page.url)
        except urllib.error.URLError:
            return True
        return False

    wait_for(gone, "the end of the page")


# ---- without a kernel


@pytest.fixture
def view():
    with Mount.open("virtual://?speed=max") as mount:
        yield show(mount)


def test_a_request_without_the_secret_or_from_elsewhere_gets_nothing(view):
    wrong = view.url.replace(view.secret, "x" * len(view.secret))
    for url in (wrong, f"http://{view.host}/"):
        assert post(f"{url}stop")[0] == 403
        with pytest.raises(urllib.error.HTTPError, match="403"):
            get(f"{url}state")
    assert post(f"{view.url}stop", Origin="https://example.org")[0] == 403
    assert post(f"{view.url}stop", Host="rebound.example.org")[0] == 403
    assert view.host.startswith("127.0.0.1:") and post(f"{view.url}stop", Origin=f"http://{view.host}")[0] == 200


def test_a_press_that_comes_late_or_is_none_moves_nothing(view):
    page = Page(view.url)
    mount = view._mount()
    old = page.state["tick"] - 5000
    for order in ({"axis": "x", "n": 1, "tick": old}, {"axis": "x", "n": 1, "tick": None}, [], {"axis": "x"}):
        status, said = post(f"{page.url}order", order)
        assert status == 409 and said
    assert page.order(axis="x", n=1)[1].startswith("nothing was done: the time of this virtual board")
    assert not any(duty for _, pin, duty in mount.link.port.simulation.edges if pin.endswith("_en"))


def test_without_a_notebook_it_can_stop_and_only_that():
    with Mount.open("virtual://") as mount:
        page = Page(show(mount).url)
        assert page.state["name"] == mount.identity and b'<button id="stop">' in get(page.url)
        assert page.order(axis="x", n=1)[1].startswith("nothing was done: a cell is running")
        mount.x.jog(0.5)
        assert page.stop() == (200, "STOP was sent")
        assert not mount.status().moving
    assert page.stop() == (409, "this mount was closed: open it again, and show it in another cell")
    with pytest.raises(errors.BadValue, match="takes an open Mount, not str"):
        show("virtual://")


def test_a_stop_is_for_every_mount_that_is_shown():
    with Mount.open("virtual://") as first, Mount.open("virtual://?seed=2") as second:
        page, _other = Page(show(first).url), show(second)
        for mount in (first, second):
            mount.x.jog(0.5)
        page.stop()
        assert not first.status().moving and not second.status().moving


def test_a_stop_of_other_mounts_does_not_wait_for_a_port_that_hangs(aside, monkeypatch):
    hangs = threading.Event()

    def halt():
        hangs.wait()
        raise errors.ConnectionLost("the port hung")

    with Mount.open("virtual://") as first, Mount.open("virtual://?seed=2") as second:
        page, _other = Page(show(first).url), show(second)
        second.x.jog(0.5)
        monkeypatch.setattr(first, "halt", halt)
        stop = aside(page.stop)
        try:
            wait_for(lambda: not second.status().moving, "the stop")
        finally:
            hangs.set()
        assert second.status().x.reason == 3  # by a stop, not by the limit of its time
        assert stop.result() == (409, "the port hung")


def test_the_page_loads_nothing_from_elsewhere(view):
    page = get(view.url).decode()
    assert not re.search(r"https?://|src=\"(?!\")|innerHTML", page)
