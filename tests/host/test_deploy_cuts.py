"""A deploy whose power goes after each single file operation, and in the middle of each write.

In one process: the operations that mpremote and on_board.py make, on a folder, through an `os` and an
`open` that end everything after the N-th. Then the board boots: what main.py would import counts.
"""

import ast
import builtins
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from mirrormount.deploy import on_board
from mirrormount.deploy.fileset import folders, sources
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
            side["make_folders"](folders(sources("micropython")))
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


def firmware(number: int, suffix: str, names: tuple[str, ...], main: str = MAIN) -> dict[str, bytes]:
    """A version of the firmware in which every file differs from those of the others."""
    files = {f"mountfw/{name}{suffix}": f"{name} of {number}".encode() for name in names}
    return files | {"main.py": f"{main}# {number}\n".encode()}


OLD = firmware(1, ".mpy", ("app", "axis", "gone"))
NEW = firmware(2, ".mpy", ("app", "axis", "added"))


def older(board: Board) -> None:
    board.deploy(OLD)


def older_source(board: Board) -> None:
    board.deploy(firmware(1, ".py", ("app", "axis", "gone")))


def by_hand(board: Board) -> None:
    board.put(firmware(1, ".py", ("app", "axis"), OLD_MAIN))


def somebody_elses(board: Board) -> None:
    board.put({"main.py": THEIRS.encode(), "main.py.bak": b"older"})


def blank(board: Board) -> None:
    pass


BEFORE = [older, older_source, by_hand, somebody_elses, blank]


@pytest.fixture(params=BEFORE, ids=lambda before: before.__name__)
def board(request, tmp_path: Path) -> Board:
    board = Board(tmp_path / "board")
    request.param(board)
    board.put({"notes.txt": b"mine", "mountfw/boards/mine.py": b"NAME = b'mine'"})
    return board


@pytest.fixture
def each_cut(board: Board, tmp_path: Path):
    """Yields the same board after each cut of an action, and says how many there were."""

    def cuts(action: Callable[[Board, int | None], object]):
        whole = Board(Path(shutil.copytree(board.root, tmp_path / "whole")))
        count = action(whole, None)
        assert count > 5
        for last in range(1, count + 1):
            cut = Board(Path(shutil.copytree(board.root, tmp_path / f"cut{last}")))
            with pytest.raises(PowerCut):
                action(cut, last)
            yield cut, whole

    return cuts


def test_after_a_cut_anywhere_the_board_boots_the_old_firmware_or_the_new_one(board, each_cut):
    old = board.runs()
    seen = set()
    for cut, whole in each_cut(lambda b, last: b.deploy(NEW, last)):
        cut.boot()
        assert cut.runs() in (old, whole.runs())
        seen.add(cut.runs() == old)
    assert seen == {True, False} or old.get("main.py") in (None, THEIRS.encode())


def test_after_a_cut_anywhere_the_next_deploy_repairs_it(each_cut):
    for cut, whole in each_cut(lambda b, last: b.deploy(NEW, last)):
        cut.deploy(NEW)
        assert cut.contents() == whole.contents()


def test_after_a_cut_and_a_boot_the_next_deploy_repairs_it(each_cut):
    for cut, whole in each_cut(lambda b, last: b.deploy(NEW, last)):
        cut.boot()
        cut.deploy(NEW)
        assert cut.contents() == whole.contents()


def test_a_boot_that_finishes_a_deploy_may_be_cut_too(tmp_path):
    board = Board(tmp_path / "board")
    older(board)
    todo, side, _ = board.plan(NEW)
    board.put({path + ".new": content for path, content in todo.upload.items()})
    side["commit"](todo.verify, todo.backup, todo.journal, lambda: None, todo.keep)
    count = Board(Path(shutil.copytree(board.root, tmp_path / "whole"))).boot()
    for last in range(1, count + 1):
        cut = Board(Path(shutil.copytree(board.root, tmp_path / f"cut{last}")))
        with pytest.raises(PowerCut):
            cut.boot(last)
        cut.boot()
        booted = {p: c for p, c in cut.contents().items() if not p.startswith(on_board.KEPT)}
        assert {p: c for p, c in booted.items() if not p.endswith(".json")} == NEW


def test_a_firmware_that_does_not_answer_leaves_the_board_as_it_was(board):
    before = board.contents()
    board.deploy(NEW, answers=False)
    assert board.contents() == before


def test_a_cut_while_the_old_firmware_comes_back_leaves_the_old_one_or_the_new_one(board, each_cut):
    old, before = board.runs(), board.contents()
    committed = Board(board.root.parent / "committed")
    shutil.copytree(board.root, committed.root, dirs_exist_ok=True)
    committed.deploy(NEW)
    for cut, whole in each_cut(lambda b, last: b.deploy(NEW, last, answers=False)):
        assert whole.contents() == before
        cut.boot()
        assert cut.runs() in (old, committed.runs())
        cut.deploy(NEW)
        assert cut.contents() == committed.contents()


def test_a_boot_that_finishes_bringing_back_may_be_cut_too(board, tmp_path):
    old = board.runs()
    todo, side, _ = board.plan(NEW)
    side["make_folders"](folders(sources("micropython")))
    board.put({path + ".new": content for path, content in todo.upload.items()})
    side["commit"](todo.verify, todo.backup, todo.journal, side["replay"], todo.keep)
    (board.root / on_board.UNDO).rename(board.root / on_board.JOURNAL)
    count = Board(Path(shutil.copytree(board.root, tmp_path / "counted"))).boot()
    for last in range(1, count + 1):
        cut = Board(Path(shutil.copytree(board.root, tmp_path / f"boot{last}")))
        with pytest.raises(PowerCut):
            cut.boot(last)
        cut.boot()
        assert cut.runs() == old


def test_of_an_upload_that_fails_after_the_commit_nothing_is_left_either(board):
    before = board.contents()
    todo, side, _ = board.plan(NEW)
    side["make_folders"](folders(sources("micropython")))
    board.put({path + ".new": content for path, content in todo.upload.items()})
    side["commit"](todo.verify, todo.backup, todo.journal, lambda: None, todo.keep)
    side["clean"](list(todo.verify), side["replay"])
    assert board.contents() == before


def test_undeploy_gives_a_program_that_was_put_aside_its_name_back_over_any_cut(tmp_path):
    board = Board(tmp_path / "board")
    somebody_elses(board)
    before = board.contents()
    board.deploy(OLD)
    board.deploy(NEW)
    assert board.contents()["main.py.bak2"] == THEIRS.encode()
    count = Board(Path(shutil.copytree(board.root, tmp_path / "whole"))).undeploy()
    for last in range(1, count + 1):
        cut = Board(Path(shutil.copytree(board.root, tmp_path / f"cut{last}")))
        with pytest.raises(PowerCut):
            cut.undeploy(last)
        cut.undeploy()
        assert cut.contents() == before, last


def test_after_a_cut_of_undeploy_nothing_of_ours_runs_or_all_of_it(tmp_path):
    board = Board(tmp_path / "board")
    board.deploy(OLD)
    board.put({"notes.txt": b"mine"})
    old = board.runs()
    count = Board(Path(shutil.copytree(board.root, tmp_path / "whole"))).undeploy()
    for last in range(1, count + 1):
        cut = Board(Path(shutil.copytree(board.root, tmp_path / f"cut{last}")))
        with pytest.raises(PowerCut):
            cut.undeploy(last)
        cut.boot()
        assert cut.runs() in (old, {})
        cut.undeploy()
        assert cut.contents() == {"notes.txt": b"mine"}


def test_what_was_uploaded_before_the_cut_is_not_uploaded_again(tmp_path):
    board = Board(tmp_path / "board")
    older(board)
    board.put({"mountfw/axis.mpy.new": NEW["mountfw/axis.mpy"]})
    todo, _, _ = board.plan(NEW)
    assert "mountfw/axis.mpy" not in todo.upload and "mountfw/axis.mpy" in todo.verify


def test_a_file_that_arrives_damaged_commits_nothing(tmp_path):
    board = Board(tmp_path / "board")
    older(board)
    before = board.contents()
    todo, side, _ = board.plan(NEW)
    board.put({path + ".new": content + b"?" for path, content in todo.upload.items()})
    with pytest.raises(ValueError, match="damaged"):
        side["commit"](todo.verify, todo.backup, todo.journal, side["replay"], todo.keep)
    side["clean"](list(todo.verify), side["replay"])
    assert board.contents() == before


def test_the_users_files_survive_every_cut(each_cut):
    for cut, _ in each_cut(lambda b, last: b.deploy(NEW, last)):
        files = cut.contents()
        assert files["notes.txt"] == b"mine" and files["mountfw/boards/mine.py"] == b"NAME = b'mine'"
