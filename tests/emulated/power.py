"""A board on the emulated RP2040 whose power can be cut at any operation of its flash, and a deploy on it."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from mirrormount.deploy import firmware as files_of
from mirrormount.deploy.firmware import firmware, firmware_hash, hashes
from mirrormount.deploy.micropython import Plan, Survey, beside, plan
from mirrormount.deploy.on_board import MANIFEST
from mirrormount_sim import emulator
from mirrormount_sim.clocks import Lockstep
from mirrormount_sim.emulator import RawPrompt
from mirrormount_sim.machines import firmware_folder
from mirrormount_sim.simulation import Simulation

STARTED_US = 300_000  # main.py runs by then, and a Ctrl-C is heard
MPY = 6  # the format of compiled files that MicroPython 1.23 and later takes


class PowerCut(Exception):
    """The board has lost its power for a moment, and boots."""


class Board(Lockstep):
    """A board with this flash; keep: what it writes goes to the file."""

    def __init__(self, flash: Path, *, keep: bool = False) -> None:
        super().__init__(Simulation(emulator.command(None, flash, keep=keep)))
        self._cut_at: int | None = None

    @property
    def operations(self) -> int:
        """Erases and programs of the flash so far."""
        return self.simulation.flash_operations

    def count(self, action: Callable[[], object]) -> int:
        """How many operations an action takes."""
        before = self.operations
        action()
        return self.operations - before

    def cut_after(self, operations: int, *, half: bool) -> None:
        """Cut the power with so many more operations; whatever runs then ends with PowerCut."""
        self.simulation.cut_power(operations, half=half)
        self._cut_at = self.operations + operations

    def run(self, us: int, until: Callable[[], bool] = lambda: False) -> bool:
        done = super().run(us, lambda: self._is_cut() or until())
        if self._is_cut():
            self._forget()
            raise PowerCut
        return done

    def _is_cut(self) -> bool:
        return self._cut_at is not None and self.operations >= self._cut_at

    def _forget(self) -> None:
        self._cut_at = None
        self._outbox.clear()
        self.received.clear()
        self.simulation.lit = False

    def start_over(self) -> None:
        """Power off and on, with the flash that it had in the beginning or that it was told to remember."""
        self.simulation.start_over()
        self.run(1)
        self._forget()

    def power_cycle(self) -> None:
        """Power off and on."""
        self.simulation.reset(power=True)
        self.run(1)
        self._forget()

    def firmware(self) -> str:
        """What runs once the board has booted: its own hash of it."""
        self.boot()
        self.received.clear()
        self.send(b"XF?\n")
        assert self.run(5_000_000, lambda: b"\n" in self.received), bytes(self.received)
        return self.received.split(b"\r\n")[0].decode()

    def prompt(self, program: str = "pass") -> RawPrompt:
        """The raw prompt, after a program."""
        self.run(STARTED_US)
        self.send(b"\x03")
        prompt = RawPrompt(self)
        prompt.reset()  # as deploy does: the firmware would still take its part of the memory
        prompt.run(program)
        return prompt


@dataclass
class Deploy:
    """A deploy over another firmware: a flash on which the new one waits beside the old one, and what each answers."""

    uploaded: Path
    todo: Plan
    old: set[str]  # what XF? answers of the old one: started by its main.py, or by that of the new one
    new: str


def uploaded(folder: Path) -> Deploy:
    """A board on which everything is done but the exchange. The flash is the cache's: copy it."""
    old = another_version(folder)
    there = Survey(files=hashes(old), sizes={path: len(text) for path, text in old.items()}, listed=hashes(old))
    todo = plan(compiled(), there, lambda _aside: False)
    assert not todo.unchanged, "a file that does not differ shows no mix"
    listed = {MANIFEST: json.dumps({"files": there.listed}).encode()}
    waiting = {beside(path): content for path, content in todo.upload.items()}
    flash = emulator.flash_with_firmware(None, old | listed | waiting)
    with_new_main = there.files | {"main.py": todo.after["main.py"]}
    return Deploy(flash, todo, {firmware_hash(there.files), firmware_hash(with_new_main)}, firmware_hash(todo.after))


def compiled() -> dict[str, bytes]:
    """The firmware as .mpy; what stays source even so differs from the plain file."""
    files = firmware(MPY)
    return files | {path: text + b"# compiled\n" for path, text in files.items() if path.endswith(".py")}


def another_version(folder: Path) -> dict[str, bytes]:
    """A firmware that works and in which every file differs; with a module that was given up and one in source."""
    package = shutil.copytree(firmware_folder() / "mountfw", folder / "mountfw")
    for source in package.rglob("*.py"):
        source.write_bytes(source.read_bytes() + b"\n_VERSION = 'another'\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files_of, "package", lambda: package)
        files = firmware(MPY)
    gone = {"mountfw/gone.mpy": files["mountfw/wire/ticks.mpy"]}
    source = {"mountfw/repl.py": (package / "repl.py").read_bytes()}
    del files["mountfw/repl.mpy"]
    return files | gone | source
