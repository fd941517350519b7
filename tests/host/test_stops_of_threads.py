"""A stop meets the start of a motion: in another thread, and in a block that it ends."""

import threading
from collections.abc import Callable

import pytest
from served import PATIENCE_S

from mirrormount import errors
from mirrormount.cli import board, main, motion
from mirrormount.device.mount import Mount
from mirrormount.transport.ports import Port


@pytest.fixture
def mount():
    with Mount.open("virtual://?speed=max") as mount:
        yield mount


class CountingPort:
    """A port that notes when one thread makes its n-th call of read() or write(), and calls `then` before it."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self.lockstep = port.lockstep
        self.note("", 0)

    def note(self, thread: str, calls: int, then: Callable[[], None] = lambda: None) -> None:
        self._left, self._thread, self._then, self.reached = calls, thread, then, threading.Event()

    def _count(self) -> None:
        if threading.current_thread().name == self._thread:
            self._left -= 1
            if self._left == 0:
                self.reached.set()
                self._then()

    def read(self, timeout_s: float) -> bytes:
        self._count()
        return self._port.read(timeout_s)

    def write(self, data: bytes) -> None:
        self._count()
        self._port.write(data)

    def close(self) -> None:
        self._port.close()


@pytest.mark.parametrize("calls", range(1, 13))
def test_a_stop_of_another_thread_is_not_overtaken_by_the_start_of_a_motion(calls):
    with Mount.open("virtual://") as mount:
        mount.link.port = port = CountingPort(mount.link.port)
        for _ in range(4):
            ended: list[BaseException | None] = []

            def step(ended=ended) -> None:
                try:
                    mount.x.step(5)
                    ended.append(None)
                except errors.MountError as e:
                    ended.append(e)

            port.note("step", calls)
            thread = threading.Thread(target=step, name="step")
            thread.start()
            assert port.reached.wait(PATIENCE_S)
            mount.stop()
            thread.join(PATIENCE_S)
            assert isinstance(ended[0], errors.MoveEnded), ended
            assert not mount.status().moving


@pytest.mark.parametrize(("line", "keep_alive"), [("2PR5", True), ("XK500;2PR5", True), ("2MV+", False)])
def test_a_line_does_not_start_a_motion_after_a_stop_that_came_while_old_errors_were_read(mount, line, keep_alive):
    simulation = mount.link.port.simulation
    mount.link.port = port = CountingPort(mount.link.port)

    def stop():
        other = threading.Thread(target=mount.halt)
        other.start()
        other.join(PATIENCE_S)

    port.note(threading.current_thread().name, 2, then=stop)
    with pytest.raises(errors.MoveEnded):
        mount.send(line, keep_alive=keep_alive)
    mount.sleep(1)
    assert simulation.edges == []


@pytest.mark.parametrize("start", ["step", "jog", "drive", "start_homing", "send", "send_with_keep_alive"])
def test_nothing_starts_in_a_block_after_a_stop_in_it(mount, start):
    starts = {
        "step": lambda: mount.x.step(3),
        "jog": lambda: mount.x.jog(1),
        "drive": lambda: mount.drive(100, 100),
        "start_homing": mount.x.start_homing,
        "send": lambda: mount.send("2PR3", keep_alive=False),
        "send_with_keep_alive": lambda: mount.send("XK500;2PR3"),
    }
    with mount.unless_stopped():
        mount.halt()
        with pytest.raises(errors.MoveEnded):
            starts[start]()
    mount.sleep(1)
    assert mount.link.port.simulation.edges == []


def test_a_stop_by_another_program_between_opening_and_block_counts_where_that_is_asked_for(mount):
    mount.session.stop_for_another_program()
    with mount.unless_stopped():
        mount.x.step(1)
    with pytest.raises(errors.MoveEnded, match="stopped before it began"), mount.unless_stopped(since_open=True):
        mount.x.step(1)


def test_the_end_of_an_inner_block_does_not_end_the_outer_one(mount):
    with mount.unless_stopped():
        with mount.unless_stopped():
            mount.x.step(1)
        mount.halt()
        with pytest.raises(errors.MoveEnded):
            mount.x.step(3)
    mount.x.step(1)


def test_a_block_of_one_thread_is_no_block_of_another(mount):
    in_a_block, stopped = threading.Event(), threading.Event()

    def block():
        with mount.unless_stopped():
            in_a_block.set()
            stopped.wait(60)

    other = threading.Thread(target=block)
    other.start()
    in_a_block.wait(60)
    with mount.unless_stopped():
        mount.halt()
        stopped.set()
        other.join()
        with pytest.raises(errors.MoveEnded):
            mount.x.step(3)
    mount.x.step(1)  # asked for after the stop


@pytest.mark.parametrize(
    ("work", "words"),
    [
        (motion, "step x 3"),
        (motion, "move x 3"),
        (motion, "home x"),
        (motion, "jog x 0.5 --seconds 1"),
        (motion, "drive 100 100 --seconds 1"),
        (board, "send 2PR3"),
    ],
)
def test_a_stop_by_another_program_before_a_command_has_begun_is_for_its_motion(monkeypatch, capsys, work, words):
    edges, open_mount = [], work.open_mount

    def stopped_first(args):
        mount = open_mount(args)
        edges.append(mount.link.port.simulation.edges)
        mount.session.stop_for_another_program()
        return mount

    monkeypatch.setattr(work, "open_mount", stopped_first)
    assert main.main([*words.split(), "--port", "virtual://?speed=max"]) == 1
    assert "stopped before it began" in capsys.readouterr().err
    assert edges == [[]]
