"""A deploy whose power goes after each single file operation, and in the middle of each write: see cut_board."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from cut_board import MAIN, OLD_MAIN, THEIRS, Board, PowerCut

from mirrormount.deploy import on_board
from mirrormount.deploy.firmware import folders, sources


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
