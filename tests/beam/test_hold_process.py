"""`mirrormount hold` as a process that is killed, frozen and started again, beside a table that outlives it.

The boards are on pseudo-terminals; the cameras are pipes of JPEG pictures, which OpenCV reads as it reads a webcam.
"""

import os
import signal
import subprocess
import sys
import threading
from contextlib import ExitStack, closing, suppress
from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from loop_rig import Rig
from served import wait_for

from mirrormount.device import calibration
from mirrormount.device.mount import Mount
from mirrormount.values import KEEP_ALIVE_MS
from mirrormount_beam import scale
from mirrormount_beam.camera import Size
from mirrormount_beam.control.response import save
from mirrormount_beam.scale import Scale
from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.clocks import serve
from mirrormount_sim.optics import DEFAULT
from mirrormount_sim.ports import PtyPort
from mirrormount_sim.profiles import SMOOTH
from mirrormount_sim.table import RealtimeClock, Table, TableCamera, new_webcam

pytestmark = pytest.mark.wall_clock  # on a busy computer a board in real time answers later than the loop waits
OFF_US = KEEP_ALIVE_MS * 1000 + 2000  # the board looks at its clock once a millisecond
FAR_UM = 3000.0  # some corrections
NAMES = ("near", "far")
SIZE, PX_UM = Size(640, 480), 50.0


class ServedBoard:
    """A virtual board on a pseudo-terminal, in a thread. heard_us: when it took its last byte, by its own time."""

    def __init__(self, folder, unit, on_drive):
        self.port = PtyPort(folder / f"mount{unit}")
        self.simulation = make_simulation(Options(seed=unit + 1, unit=unit, files=folder / f"files{unit}"))
        self.heard_us = 0
        self.driven = []  # [from, to] in us; to is None while a motor is on
        self._on_drive = on_drive
        self._edge, self._go = self.simulation.bench.edge, self.simulation.go
        self.simulation.bench.edge, self.simulation.go = self.edge, self.go
        self._ending = threading.Event()
        self._thread = threading.Thread(target=serve, args=(self.simulation, [self.port], self._ending.is_set))
        self._thread.start()

    def edge(self, us, pin, duty, hz=0):
        self._edge(us, pin, duty, hz)
        us -= self.simulation.now_us - self.simulation.us
        if pin.endswith("_en") and duty:
            self.driven.append([us, None, pin])
            self._on_drive()
        elif pin.endswith("_en"):
            next(on for on in self.driven[::-1] if on[2] == pin)[1] = us

    def go(self, us, grant_us, received=b""):
        if received:
            self.heard_us = us - (self.simulation.now_us - self.simulation.us)
        self._go(us, grant_us, received)

    def close(self):
        self._ending.set()
        self._thread.join()
        self.port.close()
        self.simulation.close()


class PipedCamera:
    """A camera of the table whose pictures go into a named pipe, for whoever opens it."""

    def __init__(self, path, number, spots_mm, clock):
        self.path = path
        os.mkfifo(path)
        sensor, timing = new_webcam(SMOOTH, np.random.default_rng(number))
        look = partial(self._look, number, spots_mm)
        self._camera = TableCamera(path.name, sensor, timing, look, clock)
        self._ending = False
        self._thread = threading.Thread(target=self._write)
        self._thread.start()

    @staticmethod
    def _look(number, spots_mm, time_s):
        spot = spots_mm(time_s)[number]
        return [] if spot is None else [spot]

    def _write(self):
        while not self._ending:
            with suppress(BrokenPipeError), self.path.open("wb", buffering=0) as pipe:  # waits for a reader
                for frame in self._camera.frames():
                    if self._ending:
                        break
                    pipe.write(cv2.imencode(".jpg", frame.image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes())

    def close(self):
        self._ending = True
        reader = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        while self._thread.is_alive():  # it may wait for room in the pipe, which the loop left full
            with suppress(BlockingIOError):
                os.read(reader, 1 << 20)
            self._thread.join(0.01)
        os.close(reader)


class LivingTable:
    """Boards, beam and cameras in this process; the loop is another one. Use `with`."""

    def __init__(self, folder):
        self.folder = folder
        self.loop = None
        self.out = []
        self._left, self._signal = 0, None
        self.signalled_us = []

    def __enter__(self):
        with ExitStack() as stack:
            self.boards = []
            for unit in (0, 1):
                self.boards.append(stack.enter_context(closing(ServedBoard(self.folder, unit, self.drives))))
            clock = stack.enter_context(closing(RealtimeClock()))
            mounts = [board.simulation.mirrors_now_rad for board in self.boards]
            self.truth = Table(mounts, 2, DEFAULT, 1)
            for number, name in enumerate(NAMES):
                path = self.folder / f"{name}.mjpeg"
                stack.enter_context(closing(PipedCamera(path, number, self.truth.spots_mm, clock)))
            self.describe()
            stack.callback(self.end)
            self._closing = stack.pop_all()
        return self

    def __exit__(self, *_):
        self._closing.close()

    def describe(self):
        """table.toml, the scales of the cameras, and a calibration of the same mechanics."""
        lines, response = [], Rig("smooth", 1).response
        actuators, cameras = [], []
        for name, board in zip(("first", "second"), self.boards, strict=True):
            lines.append(f'[mounts.{name}]\nport = "{board.port.address}"\n')
            with Mount.open(board.port.address) as mount:
                actuators += [[f"{name}.{axis}", mount.board_id, mount.axis(axis).ask_whole("XP?")[0]] for axis in "xy"]
        for name, at_m, part in zip(NAMES, DEFAULT.cameras_m, (0.45, 1.0), strict=True):
            path = self.folder / f"{name}.mjpeg"
            x, y = 319.5 - part * FAR_UM / PX_UM, 239.5 + part * FAR_UM / PX_UM / 2
            lines.append(f'[cameras.{name}]\ncamera = "{path}"\ndistance_mm = {1000 * at_m}\n')
            lines.append(f"target_x_px = {x}\ntarget_y_px = {y}\n")
            scale.write(SimpleNamespace(name=str(path), size=SIZE), Scale(*SIZE, PX_UM / 1000, 0.0))
            cameras.append([name, *SIZE, PX_UM, PX_UM])
        (self.folder / "table.toml").write_text("".join(lines))
        response.belongs = {"actuators": actuators, "cameras": cameras}
        save(response, calibration.path().with_name("table-calibration.json"))

    def start(self):
        """`mirrormount hold`, in a process of its own."""
        self.out = []
        quick = {"OPENCV_FFMPEG_CAPTURE_OPTIONS": "analyzeduration;100000", "PYTHONUNBUFFERED": "1"}
        self.loop = subprocess.Popen(
            [sys.executable, "-m", "mirrormount", "hold", "--patience", "2"],
            env=os.environ | quick,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, args=(self.loop, self.out))
        self._reader.start()

    @staticmethod
    def _read(loop, out):
        out.extend(iter(loop.stdout.readline, ""))  # line by line, until it ends
        loop.stdout.close()

    def end(self):
        """The loop's process, if there is one."""
        if self.loop:
            self.loop.kill()
            self.loop.wait()

    def wait_for_signal(self):
        """To the loop's process. A loop that stands still (pictures of a busy computer are late) is started anew."""
        while not self.signalled_us:
            wait_for(lambda: self.signalled_us or self.stands(), "the loop to drive", lambda: self.out)
            if not self.signalled_us:
                self.end()
                self.start()

    def stands(self):
        return any(": interlock " in line for line in self.out)

    def pictures_are_late(self):
        """On a busy computer: then corrections do not help, and the loop stands still until it is started anew."""
        return any("interlock 4" in line for line in self.out)

    def says(self, words):
        def said():
            return any(words in line for line in self.out)

        wait_for(lambda: said() or not self._reader.is_alive(), f"{words!r} of the loop")
        assert said(), f"the loop has ended: {self.out}"

    def signal_at(self, drives, what):
        """Send a signal to the loop's process when a motor has been switched on so many times."""
        self.signalled_us, self._signal, self._left = [], what, drives

    def drives(self):
        """A motor was switched on, in this moment."""
        self._left -= 1
        if self._left == 0:
            os.kill(self.loop.pid, self._signal)
            self.signalled_us = [board.simulation.us for board in self.boards]

    def counts(self):
        return [len(board.driven) for board in self.boards]

    def seconds_pass(self, seconds):
        """By each board's own clock."""
        ends_us = [board.simulation.us + seconds * 1_000_000 for board in self.boards]
        wait_for(lambda: all(b.simulation.us > us for b, us in zip(self.boards, ends_us, strict=True)), "time to pass")

    def check_off(self):
        """The keep-alive of each board has switched it off: it heard nothing any more."""
        for board, signalled_us in zip(self.boards, self.signalled_us, strict=True):
            assert board.heard_us < signalled_us + 200_000  # what was under way, on a busy computer
            assert all(to_us is not None and to_us <= board.heard_us + OFF_US for _, to_us, _ in board.driven)


@pytest.fixture
def table(tmp_path, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    monkeypatch.delenv("MIRRORMOUNT_TABLE", raising=False)
    with LivingTable(tmp_path) as table:
        yield table


@pytest.mark.parametrize("drives", [2, 9])
def test_a_process_that_is_killed_leaves_the_pins_off_and_another_one_looks_first(table, drives):
    table.signal_at(drives, signal.SIGKILL)
    table.start()
    table.wait_for_signal()
    assert table.loop.wait() == -signal.SIGKILL
    table.seconds_pass(2)
    table.check_off()
    before = table.counts()
    table.truth.laser.blocked = True
    table.start()
    table.says("interlock 1, no spot")
    assert any("calibration of" in line for line in table.out), "it goes on from the saved calibration"
    assert table.counts() == before
    table.truth.laser.blocked = False

    def corrected():
        return all(n > was for n, was in zip(table.counts(), before, strict=True))

    while not corrected():
        wait_for(lambda: corrected() or table.pictures_are_late(), "corrections of both mounts", lambda: table.out)
        if not corrected():
            table.end()
            table.start()


def test_a_process_that_is_frozen_has_the_pins_off_and_stands_still_when_it_wakes_up(table):
    table.signal_at(5, signal.SIGSTOP)
    table.start()
    table.wait_for_signal()
    table.seconds_pass(3)
    table.check_off()
    before = table.counts()
    table.loop.send_signal(signal.SIGCONT)
    table.says("interlock ")
    table.seconds_pass(2)
    assert table.counts() == before
