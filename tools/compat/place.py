"""A place where a driver finds a mount: a virtual board on TCP or on a pty, and what its pins did meanwhile.

The board has settings saved that its owner would have made: steps of 20 ms, 25 of them a second. Its
files stay from one start to the next.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pins

from mirrormount.device.mount import Mount
from mirrormount_sim.machines import THIS, board_text, new_files

WAYS = ("tcp", "pty")
MACHINES = ("cpython", "micropython")
STEP_MS, PERIOD_MS = 20, 40
SETTINGS = "1XP20000;2XP20000;1VA25;2VA25"

_PATIENCE_S = 20.0  # how long an event may take before it counts as missing; never a measurement


def wait_for(condition: Callable[[], object], what: str) -> None:
    """Wait for something that the board does. Raises AssertionError if it never does."""
    end = time.monotonic() + _PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            raise AssertionError(f"waited in vain for {what}")
        time.sleep(0.005)


class Place:
    """A virtual board of a machine, reached in a way: tcp is `mirrormount serve`, pty is `mirrormount virtual`.

    address is HOST:PORT or the pty's name. folder is an empty one for the board's files. settings: those that the
    board's owner has saved; encoder: what is on its motors, or None.
    Raises EmulatorMissing if there is no such machine here.
    """

    def __init__(
        self, folder: Path, way: str, machine: str, settings: str = SETTINGS, encoder: str | None = None
    ) -> None:
        self.way, self.machine = way, machine
        self._files, self._edges, self._log = (folder / name for name in ("files", "edges.jsonl", "log"))
        self._seen = 0
        self._files.mkdir()
        if machine != "cpython":
            new_files(self._files)
            if text := board_text("pico", 2, encoder):
                (self._files / THIS).write_text(text, encoding="utf-8")
        kind = f"machine={machine}" + (f"&encoder={encoder}" if encoder else "")
        with Mount.open(f"virtual://?speed=max&{kind}&files={self._files}") as mount:
            mount.send(settings)
            mount.save()
        self._words = [sys.executable, "-P", "-m", "mirrormount"]
        if way == "tcp":
            board = f"virtual://?{kind}&edges={self._edges}&files={self._files}"
            self._words += ["serve", board, "--tcp", "127.0.0.1:0"]
        else:
            self._words += ["virtual", "--link", str(folder / "mount"), "--machine", machine]
            self._words += ["--edges", str(self._edges), "--files", str(self._files)]
            self._words += ["--encoder", encoder] if encoder else []
        self._start()

    def restart(self) -> None:
        """Cut the board's power, and switch it on again. The address may be another one then."""
        self.close()
        self._start()

    def mark(self) -> None:
        """What the pins did so far is not looked at any more."""
        self._seen = len(self._all_edges())

    def drives(self, axis: int | None = None) -> list[pins.Drive]:
        """What the motors did since mark(), of one axis or of both."""
        return [d for d in pins.drives(self._all_edges()[self._seen :]) if axis in (None, d.axis)]

    def driven_ms(self, axis: int) -> list[int]:
        """The lengths of an axis's drives since mark(), each with its sign. Raises ValueError while one lasts."""
        return [drive.ms for drive in self.drives(axis)]

    def periods_ms(self, axis: int) -> set[int]:
        """The times from the beginning of a drive to that of the next, each once, to the nearest 10 ms.

        To 10 ms, because a drive that is about to end is ended on time, and the other axis's beginning waits for it.
        """
        starts = [drive.start_us for drive in self.drives(axis)]
        return {round((b - a) / 10_000) * 10 for a, b in pairwise(starts)}

    def driving(self, axis: int | None = None) -> bool:
        """True while the enable of an axis, or of any, is high."""
        return any(drive.length_us is None for drive in self.drives(axis))

    def close(self) -> None:
        """End it as a service is ended, and the board with it."""
        self._process.terminate()
        self._process.communicate()

    def _start(self) -> None:
        self._seen = 0
        with self._log.open("a") as log:
            self._process = subprocess.Popen(self._words, stdout=subprocess.PIPE, stderr=log, text=True)
        assert self._process.stdout
        ready = next((line for line in self._process.stdout if line.startswith("ready ")), None)
        if ready is None:
            self.close()
            raise AssertionError(f"the board did not start: {self._log.read_text()}")
        self.address = ready.split()[1].removeprefix("socket://")

    def _all_edges(self) -> list[dict]:
        text = self._edges.read_text() if self._edges.exists() else ""
        return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]
