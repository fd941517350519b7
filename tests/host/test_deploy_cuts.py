"""A deploy whose power goes after each single file operation, and in the middle of each write: see cut_board."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from cut_board import MAIN, MAIN_OF_0_2, THEIRS, Board, PowerCut

from mirrormount.deploy.on_board import MANIFEST


def firmware(number: int, suffix: str, names: tuple[str, ...], main: bytes = MAIN) -> dict[str, bytes]:
    """A version of the firmware in which every file differs from those of the others."""
    files = {f"mountfw/{name}{suffix}": f"{name} of {number}".encode() for name in names}
    return files | {"main.py": main + f"# {number}\n".encode()}


OLD = firmware(1, ".mpy", ("app", "axis", "motion/gone", "start"))
NEW = firmware(2, ".mpy", ("app", "axis", "motion/added", "start"))


def older(board: Board) -> None:
    board.deploy(OLD)


def older_source(board: Board) -> None:
    board.deploy(firmware(1, ".py", ("app", "axis", "gone", "start")))


def of_0_2(board: Board) -> None:
    files = firmware(1, ".mpy", ("app", "axis", "motion/gone"), MAIN_OF_0_2)
    hashes = {path: hashlib.sha256(content).hexdigest() for path, content in files.items()}
    board.put(files | {MANIFEST: json.dumps({"files": hashes}).encode()})


def by_hand(board: Board) -> None:
    board.put(firmware(1, ".py", ("app", "axis"), MAIN_OF_0_2))


def somebody_elses(board: Board) -> None:
    board.put({"main.py": THEIRS, "main.py.bak": b"older"})


def blank(board: Board) -> None:
    pass


USERS = {"notes.txt": b"mine", "mountfw.settings": b"1 pulse_us", "mountfw/boards/mine.py": b"NAME = b'mine'"}


@pytest.fixture(params=[older, older_source, of_0_2, by_hand, somebody_elses, blank], ids=lambda p: p.__name__)
def board(request, tmp_path: Path) -> Board:
    board = Board(tmp_path / "board")
    request.param(board)
    board.put(USERS)
    return board


@pytest.fixture
def each_cut(tmp_path: Path):
    """Yields the same board after each cut of an action, beside one on which it was done."""

    def cuts(board: Board, action: Callable[[Board, int | None], int]):
        whole = Board(Path(shutil.copytree(board.root, tmp_path / "whole")))
        count = action(whole, None)
        for last in range(1, count + 1):
            cut = Board(Path(shutil.copytree(board.root, tmp_path / f"cut{last}")))
            with pytest.raises(PowerCut):
                action(cut, last)
            yield cut, whole

    return cuts


def present(board: Board) -> dict[str, bytes]:
    """Its files, but for those of the firmware before, and the manifest.

    A cut may make the manifest forget that main.py.bak was the main.py of somebody else; the copy stays.
    """
    files = board.contents()
    return {path: content for path, content in files.items() if path != MANIFEST and not path.startswith("mountfw.old")}


def test_after_a_cut_anywhere_the_board_boots_the_old_firmware_or_the_new_one(board, each_cut):
    old = board.runs()
    seen = set()
    for cut, whole in each_cut(board, lambda b, last: b.deploy(NEW, last)):
        cut.boot()
        assert cut.runs() in (old, whole.runs())
        seen.add(cut.runs() == old)
    assert True in seen and (seen == {True, False} or "main.py" not in board.contents() or THEIRS in old.values())


@pytest.mark.parametrize("boots", [False, True])
def test_after_a_cut_anywhere_the_next_deploy_repairs_it(board, each_cut, boots):
    for cut, whole in each_cut(board, lambda b, last: b.deploy(NEW, last)):
        if boots:
            cut.boot()
        cut.deploy(NEW)
        assert present(cut) == present(whole)
        assert cut.runs() == whole.runs()
        assert USERS.items() <= cut.contents().items()


def test_a_boot_between_the_two_renames_may_be_cut_too(tmp_path):
    board = Board(tmp_path / "board")
    older(board)
    board.deploy(NEW)
    (board.root / "mountfw").rename(board.root / "mountfw.new")
    with pytest.raises(PowerCut):
        board.boot(1)
    assert board.boot() == 1
    assert present(board) == NEW


def test_a_firmware_that_does_not_answer_leaves_the_board_with_the_one_that_it_had(board):
    before, old = board.contents(), board.runs()
    board.deploy(NEW, answers=False)
    assert board.runs() == old
    ours = {"main.py", "mountfw/start.py"}  # of 0.2.0: its start, which now is in the folder
    assert {p: c for p, c in board.contents().items() if p not in ours} == {
        p: c for p, c in before.items() if p not in ours
    }
    if old["mountfw/start"] in (THEIRS, b""):
        assert board.contents() == before


def test_a_cut_while_the_old_firmware_comes_back_leaves_the_old_one_or_the_new_one(board, each_cut):
    old = board.runs()
    committed = Board(Path(shutil.copytree(board.root, board.root.parent / "committed")))
    committed.deploy(NEW)
    for cut, _ in each_cut(board, lambda b, last: b.deploy(NEW, last, answers=False)):
        cut.boot()
        assert cut.runs() in (old, committed.runs())
        cut.deploy(NEW)
        assert cut.runs() == committed.runs()
        assert USERS.items() <= cut.contents().items()


def test_undeploy_gives_a_program_that_was_put_aside_its_name_back_over_any_cut(tmp_path, each_cut):
    board = Board(tmp_path / "board")
    somebody_elses(board)
    before = board.contents()
    board.deploy(OLD)
    board.deploy(NEW)
    assert board.contents()["main.py.bak2"] == THEIRS
    for cut, _ in each_cut(board, lambda b, last: b.undeploy(last)):
        cut.undeploy()
        assert cut.contents() == before


def test_after_a_cut_of_undeploy_nothing_of_ours_runs_or_all_of_it(tmp_path, each_cut):
    board = Board(tmp_path / "board")
    board.deploy(OLD)
    board.put({"notes.txt": b"mine"})
    old = board.runs()
    for cut, _ in each_cut(board, lambda b, last: b.undeploy(last)):
        cut.boot()
        assert cut.runs() in (old, {"mountfw/start": b""})
        cut.undeploy()
        assert cut.contents() == {"notes.txt": b"mine"}
