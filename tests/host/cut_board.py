"""A folder as a MicroPython board's file system, whose power goes at a chosen operation on a file.

In one process: the operations that mpremote and on_board.py make, on a folder, through an `os` and an
`open` that end everything after the N-th. Then the board boots: what main.py starts counts.
"""

import builtins
import json
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

from mirrormount.deploy import micropython, on_board
from mirrormount.deploy.firmware import folders, sources

MAIN = sources("micropython")["main.py"]
MAIN_OF_0_2 = b"# main.py and start in one\n"
THEIRS = b"# a program of somebody else\n"


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

    def contents(self) -> dict[str, bytes]:
        return {p.relative_to(self.root).as_posix(): p.read_bytes() for p in self.root.rglob("*") if p.is_file()}

    def side(self, power: Power, told: list) -> dict:
        """on_board.py as it is on the board; told: what it says."""
        names: dict = {}
        exec(compile(Path(on_board.__file__).read_text(), "on_board", "exec"), names)
        names |= {"os": power.os, "open": power.open, "say": lambda *fact: told.append(fact)}
        return names

    def deploy(self, wanted: dict[str, bytes], last: int | None = None, answers: bool = True) -> int:
        """All that a deploy does on the board. Returns how many operations that were; PowerCut after `last`.

        answers: whether the new firmware does; else the old one is put back.
        """
        power, told = Power(self.root, last), []
        side = self.side(power, told)
        side["survey"]()
        there = micropython.read_survey(json.loads(json.dumps(told)))
        todo = micropython.plan(wanted, there, lambda _aside: True)
        if not todo.nothing:
            side["prepare"](folders(todo.after), todo.unchanged)
            for path, content in todo.upload.items():
                with power.open(micropython.beside(path), "wb") as f:
                    f.write(content)
            side["exchange"](todo.backup)
            if not answers:
                side["put_back"](todo.backup, "main.py" in there.files)
        return power.count

    def undeploy(self, last: int | None = None) -> int:
        power = Power(self.root, last)
        self.side(power, [])["undeploy"]()
        return power.count

    def boot(self, last: int | None = None) -> int:
        """Power-up: main.py runs, if it is ours, up to the start."""
        power = Power(self.root, last)

        def imported(name: str, *_):
            if name.startswith("mountfw") and not (self.root / "mountfw").is_dir():
                raise ImportError(name)
            return power.os if name == "os" else None

        if self.contents().get("main.py", b"").startswith(MAIN):
            exec(MAIN, {"__builtins__": {"__import__": imported, "ImportError": ImportError}})
        return power.count

    def runs(self) -> dict[str, bytes]:
        """What is started, and what an import of each module would find: a .py goes before its .mpy."""
        files = self.contents()
        found = {}
        for suffix in (".mpy", ".py"):
            for path, content in files.items():
                if path.endswith(suffix) and path.startswith("mountfw/"):
                    found[path.removesuffix(suffix)] = content
        main = files.get("main.py", b"")
        if not main.startswith(MAIN):
            found["mountfw/start"] = main
        return found if found["mountfw/start"] not in (THEIRS, b"") else {"mountfw/start": found["mountfw/start"]}
