"""The panel in a process of its own, and a network between it and the browser that can be cut."""

import atexit
import contextlib
import functools
import json
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path
from urllib.parse import urlsplit

from playwright.sync_api import Locator
from served import PATIENCE_S, ServedBoard, wait_for

from mirrormount.device.mount import Mount
from mirrormount.device.status import Status

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
RUN_LIMIT_US = 10_000_000  # XM, as made


class NotStarted(Exception):
    """The panel has ended instead; what it wrote to stderr."""


_NURSERY = str(Path(__file__).with_name("panel_nursery.py"))
PANEL = ("-m", "mirrormount", "panel")
PANEL_AND_LOOP = (str(Path(__file__).with_name("panel_and_loop.py")),)
PANEL_ON_BENCH = (str(Path(__file__).with_name("panel_on_bench.py")),)


class Forked:
    """A process of the nursery, with what the tests need of subprocess.Popen."""

    def __init__(self, words: list[str], environment: dict[str, str]) -> None:
        to_us = [os.pipe(), os.pipe()]
        for_it, to_it = os.pipe()
        theirs = [for_it, *(end for _, end in to_us)]
        nursery = _nursery()
        socket.send_fds(nursery, [json.dumps((words, environment)).encode()], theirs)
        self.pid = int(nursery.recv(64))
        for end in theirs:
            os.close(end)
        self.stdin = os.fdopen(to_it, "w")
        self.stdout, self.stderr = (os.fdopen(end) for end, _ in to_us)

    def send_signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """What it still writes, up to its end; nothing after that."""
        if self.stdout.closed:
            return "", ""
        said = dict.fromkeys((self.stdout, self.stderr), "")
        readers = [threading.Thread(target=lambda f: said.update({f: f.read()}), args=(file,)) for file in said]
        for reader in readers:
            reader.start()
        for reader in readers:
            reader.join(timeout)
            if reader.is_alive():
                raise subprocess.TimeoutExpired("mirrormount panel", timeout)
        for file in (self.stdin, *said):
            file.close()
        return said[self.stdout], said[self.stderr]


@functools.cache
def _nursery() -> socket.socket:
    """The way to the nursery, which ends when this process does."""
    ours, its = socket.socketpair()
    with its:
        process = subprocess.Popen([sys.executable, _NURSERY, str(its.fileno())], pass_fds=[its.fileno()])
    atexit.register(lambda: (ours.close(), process.wait()))
    return ours


class Panel:
    """A panel at an address, forked from the nursery; or program: PANEL, PANEL_AND_LOOP or PANEL_ON_BENCH, started."""

    def __init__(self, address: str, folder: Path, *options: str, program: tuple[str, ...] = ()) -> None:
        names = ("MIRRORMOUNT_PORT", "MIRRORMOUNT_TOKEN")
        environment = {k: v for k, v in os.environ.items() if k not in names} | {"XDG_STATE_HOME": str(folder)}
        words = [address, "--http", "0", "--no-browser", *options]
        if program:
            self.process = subprocess.Popen(
                [sys.executable, *program, *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env=environment,
            )
        else:
            self.process = Forked(["panel", *words], environment)
        self.said: list[str] = []
        while not (self.said and self.said[-1].startswith("ready ")):
            line = self.process.stdout.readline()
            if not line:
                raise NotStarted(self.process.communicate()[1])
            self.said.append(line.strip())
        self.url = self.said[-1].removeprefix("ready ")

    @property
    def port(self) -> int:
        return urlsplit(self.url).port

    def bench(self, act: str) -> object:
        """Let the bench act; returns what it tells."""
        return json.loads(self.loop(act))

    def loop(self, act: str) -> str:
        """Let the camera loop act; returns the line that it prints next."""
        self.process.stdin.write(act + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()

    def end(self) -> str:
        """End it as a service manager would. Returns what it has written to stderr."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.communicate(timeout=PATIENCE_S)[1]

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


def press(button: Locator) -> None:
    """Press what drives as a person does: again, if the page had just moved it (static/moved.js), as at a message."""
    body = button.page.locator("body")
    refused = True
    while refused:
        body.evaluate("(body) => body.classList.remove('moved')")
        button.click()
        refused = body.evaluate("(body) => body.classList.contains('moved')")


def status_after(panel: Panel, board: ServedBoard) -> Status:
    """What the board knows after the panel has been ended."""
    panel.end()
    with Mount.open(str(board.link)) as mount:
        return mount.status()


def pulses(board: ServedBoard, pin: str) -> int:
    """How many pulses a leg has had that are over."""
    legs = [e["level"] for e in board.edges() if e["pin"] == pin]
    enables = [e["duty"] for e in board.edges() if e["pin"] == pin[:2] + "_en"]
    assert set(legs) <= {0, 1}
    return sum(1 for duty in enables if duty == 0) if legs else 0


def run_until_driving(board: ServedBoard) -> None:
    wait_for(board.driving, "a motor to run")


def wait_for_motion(board: ServedBoard) -> None:
    """Wait until a motor has run, if only for a step that is over by now."""
    wait_for(lambda: any(e["pin"].endswith("_en") and e["duty"] for e in board.edges()), "a motor to have run")


def wait_for_rest(board: ServedBoard) -> None:
    """Wait until no motor is driven. Fails if it was the run limit that ended a run: then nothing has stopped it."""
    wait_for(lambda: not board.driving(), "the motors to rest")
    assert board.longest_drive_us() < RUN_LIMIT_US - 1_000_000


class Network:
    """A connection between browser and panel that can be stuck: what is sent meanwhile waits, and arrives later."""

    def __init__(self, to_port: int) -> None:
        self._to = to_port
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._server.getsockname()[1]}/"
        self._flows = threading.Event()
        self._flows.set()
        self._closing = False
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def cut(self) -> None:
        """From now on nothing gets through."""
        self._flows.clear()

    def mend(self) -> None:
        """All that was kept back arrives."""
        self._flows.set()

    def close(self) -> None:
        self._closing = True
        self._flows.set()
        socket.create_connection(self._server.getsockname()).close()  # so that accept() returns
        for thread in self._threads:
            thread.join()
        self._server.close()

    def _accept(self) -> None:
        while not self._closing:
            browser, _ = self._server.accept()
            self._threads.append(threading.Thread(target=self._carry, args=(browser,)))
            self._threads[-1].start()

    def _carry(self, browser: socket.socket) -> None:
        with browser, contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self._to)) as panel:
            others = {browser: panel, panel: browser}
            while not self._closing:
                for end in select.select(list(others), [], [], 0.1)[0]:
                    data = end.recv(1 << 16)
                    self._flows.wait()
                    if not data:
                        return
                    others[end].sendall(data)
