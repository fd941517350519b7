"""A folder as a MicroPython board's file system, whose power goes at a chosen operation on a file.

In one process: the operations that mpremote and on_board.py make, on a folder, through an `os` and an
`open` that end everything after the N-th. Then the board boots: what main.py would import counts.
"""

import ast
import builtins
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

from mirrormount.deploy import on_board
from mirrormount.deploy.firmware import folders
from mirrormount.deploy.micropython_plan import Plan, plan
from mirrormount.deploy.mpremote import replay_source

MAIN = f'"""main"""\nimport os\n{replay_source()}\n'
OLD_MAIN = "# a main.py that knows of no journal\n"
THEIRS = "# a program of somebody else\n"


class PowerCut(BaseException):
    """No code of ours catches it."""


class Power:
    """The board's os and open, in a folder; the power goes before operation number `last` is done."""

    def __init__(self, root: Path, last: int | None = None) -> None:
        self._root, self._left = root, last
        self.count = 0
        self.os = SimpleNamespace(**{name: self._cutting(getattr(os, name)) for name in ("rename", "remove", "mkdir")})
        self.os.rmdir = self._cutting(os.rmdir)
        self.os.stat = lambda path: os.stat(root / path)
        self.os.listdir = lambda path="": os.listdir(root / path)
        self.os.statvfs = lambda path: os.statvfs(root)

    def operation(self) -> None:
        self.count += 1
        if self.count == self._left:
            raise PowerCut

    def _cutting(self, real: Callable) -> Callable:
        def call(*paths: str) -> None:
            real_paths = [self._root / path for path in paths]
            self.operation()
            if real is os.rename:
                os.replace(*real_paths)  # as on LittleFS
            else:
                real(*real_paths)

        return call

    def open(self, path: str, mode: str = "r"):
        if "w" in mode:
            self.operation()
        file = builtins.open(self._root / path, mode)  # noqa: SIM115
        if "w" not in mode:
            return file
        real = file.write

        def write(data) -> int:
            real(data[: len(data) // 2])
            file.flush()
            self.operation()
            return real(data[len(data) // 2 :])

        file.write = write
        return file


class Board:
    """A folder as a board's file system."""

    def __init__(self, root: Path) -> None:
        self.root = root
        root.mkdir(exist_ok=True)

    def put(self, files: dict[str, bytes]) -> None:
        for path, content in files.items():
            (self.root / path).parent.mkdir(parents=True, exist_ok=True)
            (self.root / path).write_bytes(content)

    def folders(self) -> set[str]:
        return {p.relative_to(self.root).as_posix() for p in self.root.rglob("*") if p.is_dir()}

    def contents(self) -> dict[str, bytes]:
        return {p.relative_to(self.root).as_posix(): p.read_bytes() for p in self.root.rglob("*") if p.is_file()}

    def side(self, power: Power) -> dict:
        """board_side and replay() as they are on the board."""
        names: dict = {"os": power.os, "open": power.open}
        exec(compile(Path(on_board.__file__).read_text(), "board_side", "exec"), names)
        names |= {"os": power.os, "open": power.open}
        exec(replay_source(), names)
        return names

    def plan(self, wanted: dict[str, bytes], last: int | None = None) -> tuple[Plan, dict, Power]:
        power = Power(self.root, last)
        side = self.side(power)
        there = side["survey"](side["replay"])
        if there["undo"]:  # as deploy does for a board whose firmware does not answer
            side["revert"](side["replay"])
            there = side["survey"](side["replay"])
        return plan(wanted, there["files"], there["manifest"], lambda _copy: True, there["aside"]), side, power

    def deploy(self, wanted: dict[str, bytes], last: int | None = None, answers: bool = True) -> int:
        """All that a deploy does on the board. Returns how many operations that were; PowerCut after `last`.

        answers: whether the new firmware does; else the old one is put back.
        """
        todo, side, power = self.plan(wanted, last)
        if todo.journal:
            side["make_folders"](folders(todo.after))
            for path, content in todo.upload.items():
                with power.open(path + ".new", "wb") as f:
                    f.write(content)
            side["commit"](todo.verify, todo.backup, todo.journal, side["replay"], todo.keep)
        if answers:
            side["forget"]()
        else:
            assert side["revert"](side["replay"])
        return power.count

    def undeploy(self, last: int | None = None) -> int:
        power = Power(self.root, last)
        side = self.side(power)
        side["undeploy"](side["replay"])
        return power.count

    def boot(self, last: int | None = None) -> int:
        """Power-up: main.py runs, and finishes what is in the journal if it is one that can."""
        power = Power(self.root, last)
        main = self.contents().get("main.py", b"").decode()
        for node in ast.parse(main).body:
            if isinstance(node, ast.FunctionDef):
                names: dict = {"os": power.os, "open": power.open}
                exec(ast.unparse(node), names)
                names["replay"]()
        return power.count

    def runs(self) -> dict[str, bytes]:
        """What main.py is, and what an import of each module would find: a .py goes before its .mpy."""
        files = self.contents()
        found = {p: c for p, c in files.items() if p == "main.py"}
        if found.get("main.py") in (THEIRS.encode(), None):
            return found  # nothing of ours is imported
        for suffix in (".mpy", ".py"):
            for path, content in files.items():
                if path.endswith(suffix) and path.startswith("mountfw/"):
                    found[path.removesuffix(suffix)] = content
        return found
