"""A board on the emulated RP2040 whose power can be cut at any operation of its flash, and deploys on it.

A deploy here is what `mirrormount deploy` does on a board, by the same scripts and plan, in lockstep at the raw prompt.
"""

import ast
import hashlib
import pickle
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from mirrormount.deploy import fileset, on_board
from mirrormount.deploy.fileset import firmware, firmware_hash, folders
from mirrormount.deploy.micropython_plan import Plan, plan
from mirrormount.deploy.mpremote import commit_call, read_told, script_for
from mirrormount.virtual import emulator
from mirrormount.virtual.clocks import Lockstep
from mirrormount.virtual.emulator import RawPrompt, cache, held
from mirrormount.virtual.machines import firmware_folder
from mirrormount.virtual.simulation import START_US, Simulation

STARTED_US = 300_000  # main.py runs by then, and a Ctrl-C is heard
MPY = 6  # the format of compiled files that MicroPython 1.23 and later takes


class PowerCut(Exception):
    """The board has lost its power for a moment, and boots."""


class Board(Lockstep):
    """A board with this flash; keep: what it writes goes to the file."""

    def __init__(self, flash: Path, *, keep: bool = False) -> None:
        super().__init__(Simulation(emulator.command(None, flash, START_US, keep=keep)))
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

    def deploy(
        self, wanted: dict[str, bytes], before_commit: Callable[[], object] = lambda: None, replay: str = "replay"
    ) -> tuple[dict[str, str], Plan]:
        """Look, upload, commit. Returns the firmware's files that were there, and what was to be done."""
        prompt = self.prompt(script_for())
        there = read_told(prompt.run("say(survey(replay))").splitlines())
        todo = plan(wanted, there["files"], there["manifest"], lambda _copy: True)
        if todo.journal:
            prompt.run(f"make_folders({folders(todo.after)!r})")
            for path, content in todo.upload.items():
                prompt.put(path + ".new", content)
            before_commit()
            prompt.run(commit_call(todo, replay))
        return of_firmware(there["files"]), todo


NO_REPLAY = "lambda: None"  # leaves a journal to the next boot


def of_firmware(files: dict[str, str]) -> dict[str, str]:
    """Without what waits to be put in place, and copies."""
    return {path: sha for path, sha in files.items() if not path.endswith((".new", ".bak"))}


@dataclass
class Deploy:
    """One deploy as flash files, at its stages, and what a board runs before and after."""

    wanted: dict[str, bytes]
    old: Path  # nothing done yet
    uploaded: Path  # every NAME.new is there
    committed: Path  # the journal is in place
    todo: Plan
    old_hash: str
    new_hash: str
    old_files: dict[str, str]
    new_files: dict[str, str]
    steps: list[tuple[str, int]]  # the journal's lines and its own removal: what it does, operations on the flash


def staged(folder: Path, old: Path, wanted: dict[str, bytes]) -> Deploy:
    """Do the deploy once, and keep the flash of each stage in the folder."""
    flash, uploaded, committed = (folder / f"{name}.bin" for name in ("flash", "uploaded", "committed"))
    shutil.copyfile(old, flash)
    board = Board(flash, keep=True)
    try:
        old_hash = board.firmware()
        there, todo = board.deploy(wanted, lambda: shutil.copyfile(flash, uploaded), NO_REPLAY)
        shutil.copyfile(flash, committed)
        prompt = RawPrompt(board)
        calls = [_call(line) for line in [*todo.journal, on_board.JOURNAL]]
        steps = [(call, board.count(lambda call=call: prompt.run(call))) for call in calls]
    finally:
        board.simulation.close()
    new = of_firmware(todo.after)
    assert new.items().isdisjoint(there.items()), "a file that does not differ shows no mix"
    return Deploy(wanted, old, uploaded, committed, todo, old_hash, firmware_hash(todo.after), there, new, steps)


def staged_once(old: dict[str, bytes], wanted: dict[str, bytes], hand_copied: Path) -> Deploy:
    """As staged(), from the firmware `old`, which was deployed over files copied by hand; made once, then kept.

    It is made again when anything has changed that takes part: both firmwares, the image and the emulator, the scripts
    of deploy, this file.
    """
    _, main, bootrom, image, *_ = emulator.command(None, None, START_US)
    digest = hashlib.sha256(pickle.dumps([sorted(old.items()), sorted(wanted.items()), Path(main).parent.name]))
    scripts = sorted(Path(on_board.__file__).parent.glob("*.py"))
    for file in (hand_copied, Path(bootrom), Path(image), Path(__file__), *scripts):
        digest.update(file.read_bytes())
    folder = cache() / "deploys" / digest.hexdigest()[:16]
    kept = folder / "deploy.pickle"
    with held("deploys"):
        if not kept.exists():
            folder.mkdir(parents=True, exist_ok=True)
            flash = Path(shutil.copyfile(hand_copied, folder / "old.bin"))
            board = Board(flash, keep=True)
            try:
                board.deploy(old)
            finally:
                board.simulation.close()
            part = kept.with_suffix(".part")
            part.write_bytes(pickle.dumps(staged(folder, flash, wanted)))
            part.replace(kept)
        return pickle.loads(kept.read_bytes())


def _call(line: str) -> str:
    """What replay() calls for a line of the journal."""
    old, _, new = line.partition(">")
    return f"os.rename({old!r}, {new!r})" if new else f"os.remove({old!r})"


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
        patch.setattr(fileset.importlib.resources, "files", lambda _name: package)
        files = firmware(MPY)
    gone = {"mountfw/gone.mpy": files["mountfw/wire/ticks.mpy"]}
    source = {"mountfw/repl.py": (package / "repl.py").read_bytes()}
    del files["mountfw/repl.mpy"]
    return files | gone | source


def without_replay(main: bytes) -> bytes:
    """A main.py that knows of no journal."""
    tree = ast.parse(main)
    tree.body = [node for node in tree.body if "replay" not in ast.unparse(node)]
    return ast.unparse(tree).encode()
