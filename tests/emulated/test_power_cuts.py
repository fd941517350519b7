"""Deploys whose power goes, on the flash of the emulated RP2040: its LittleFS has to stand what a cut leaves.

A cut comes with one erase or program of the flash, which is then done or left half done. The default run cuts in each
file of an upload, in the commit, in each removal, every third rename and the manifest's; --exhaustive at each
operation, both ways.
"""

import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mirrormount.deploy.mpremote import commit_call, script_for
from power import NO_REPLAY, Board, Deploy, PowerCut, another_version, compiled, staged, staged_once, without_replay

from mirrormount.common.errors import EmulatorMissing
from mirrormount.deploy.firmware import firmware
from mirrormount.virtual import emulator

PAGE = 256  # bytes, the most that one operation programs


@pytest.fixture(scope="module")
def hand_copied() -> Path:
    """A flash that holds the firmware as plain files, without a manifest."""
    try:
        return emulator.flash_with_firmware(None, firmware(None))
    except EmulatorMissing as e:
        pytest.skip(str(e))


@pytest.fixture(scope="module")
def older(hand_copied, tmp_path_factory) -> Deploy:
    """From one compiled version that was deployed to another."""
    return staged_once(another_version(tmp_path_factory.mktemp("older")), compiled(), hand_copied)


@pytest.fixture(scope="module")
def by_hand(hand_copied, tmp_path_factory) -> Deploy:
    """From plain files that somebody has copied to compiled ones."""
    return staged(tmp_path_factory.mktemp("by_hand"), hand_copied, compiled())


@pytest.fixture(scope="module")
def unaware(hand_copied, tmp_path_factory) -> Deploy:
    """The same, with a main.py that knows of no journal."""
    folder = tmp_path_factory.mktemp("unaware")
    old = Path(shutil.copyfile(hand_copied, folder / "old.bin"))
    board = Board(old, keep=True)
    try:
        board.prompt().put("main.py", without_replay(firmware(None)["main.py"]))
    finally:
        board.simulation.close()
    return staged(folder, old, compiled())


@pytest.fixture
def switch_on() -> Iterator[Callable[[Path], Board]]:
    """A board with a copy of a flash."""
    boards: list[Board] = []

    def on(flash: Path) -> Board:
        boards.append(Board(flash))
        return boards[-1]

    yield on
    for board in boards:
        board.simulation.close()


@pytest.fixture
def tell(capsys) -> Callable[[int], None]:
    def printed(cuts: int) -> None:
        with capsys.disabled():
            print(f" [{cuts} power cuts]", end="", flush=True)

    return printed


def cut_in_commit(board: Board, deploy: Deploy, operation: int, half: bool) -> str:
    """From all that was uploaded: commit, with a cut, and boot. Returns what runs."""
    board.start_over()
    prompt = board.prompt(script_for())
    board.cut_after(operation, half=half)
    with pytest.raises(PowerCut):
        prompt.run(commit_call(deploy.todo))
    return board.firmware()


def cut_in_boot(board: Board, operation: int, half: bool) -> str:
    """From a journal in place: boot, with a cut, and boot again. Returns what runs."""
    board.start_over()
    board.cut_after(operation, half=half)
    with pytest.raises(PowerCut):
        board.boot()
    return board.firmware()


def repair(board: Board, deploy: Deploy) -> None:
    """All files are of one firmware, none of the other; the next deploy makes it the new one, and leaves no rest."""
    there, todo = board.deploy(deploy.wanted)
    assert there in (deploy.old_files, deploy.new_files)
    board.power_cycle()
    assert board.firmware() == deploy.new_hash
    if todo.journal:
        _, todo = board.deploy(deploy.wanted)
    assert not todo.journal


def test_after_a_cut_in_any_file_of_an_upload_the_old_firmware_starts_and_the_next_deploy_goes_on(
    older, switch_on, tell
):
    places = random.Random(5)
    board = switch_on(older.old)
    for number, (path, content) in enumerate(older.todo.upload.items()):
        prompt = board.prompt()
        cut = {"operations": places.randint(1, 1 + len(content) // PAGE), "half": places.choice((False, True))}
        board.cut_after(**cut)
        with pytest.raises(PowerCut):
            prompt.put(path + ".new", content)
        board.boot()
        assert board.simulation.lit, (path, cut)
        if number % 10 == 0:  # the hash takes twice as long as the boot, and nothing would mend an old file meanwhile
            assert board.firmware() == older.old_hash, (path, cut)
        board.prompt().put(path + ".new", content)
    board.power_cycle()
    assert board.firmware() == older.old_hash, "after one of the cuts above"
    _, todo = board.deploy(older.wanted)
    assert not todo.upload
    repair(board, older)
    tell(len(older.todo.upload))


def test_before_the_journal_is_in_place_the_old_firmware_runs_and_from_then_on_the_new_one(older, switch_on, tell):
    board = switch_on(older.uploaded)
    prompt = board.prompt(script_for())
    last = board.count(lambda: prompt.run(commit_call(older.todo, NO_REPLAY)))
    runs = [cut_in_commit(board, older, i, half=False) for i in (1, last // 2, last - 1, last, last + 1)]
    assert runs == [older.old_hash] * 3 + [older.new_hash] * 2
    tell(len(runs))


def test_a_boot_that_puts_the_new_firmware_in_place_may_be_cut_in_a_rename_or_a_removal(older, switch_on, tell):
    places = random.Random(7)
    board = switch_on(older.committed)
    assert board.count(board.boot) >= sum(operations for _, operations in older.steps)
    before = cuts = 0
    for i, (call, operations) in enumerate(older.steps):
        if i % 3 == 0 or call.startswith("os.remove") or "manifest" in call:
            assert cut_in_boot(board, before + places.randint(1, operations), half=i % 2 == 0) == older.new_hash, call
            cuts += 1
        before += operations
    repair(board, older)
    tell(cuts)


HALF = pytest.mark.parametrize("half", [False, True], ids=["done", "half_done"])


@pytest.mark.exhaustive
@HALF
def test_every_operation_of_an_upload(older, switch_on, tell, half):
    board = switch_on(older.old)
    cuts = 0
    for path, content in older.todo.upload.items():

        def put(path=path, content=content) -> None:
            board.prompt().put(path + ".new", content)

        board.simulation.remember_flash()
        operations = board.count(put)
        for i in range(1, operations + 1):
            board.start_over()
            board.prompt()
            board.cut_after(i, half=half)
            with pytest.raises(PowerCut):
                put()
            assert board.firmware() == older.old_hash, (path, i)
            if i % 5 == 0 or i == operations:  # the longest part: it uploads the rest
                repair(board, older)
        board.start_over()
        put()
        cuts += operations
    tell(cuts)


@pytest.mark.exhaustive
@HALF
@pytest.mark.parametrize("deploy", ["older", "by_hand", "unaware"])
def test_every_operation_of_a_commit(request, switch_on, tell, deploy, half):
    deploy = request.getfixturevalue(deploy)
    board = switch_on(deploy.uploaded)
    prompt = board.prompt(script_for())
    operations = board.count(lambda: prompt.run(commit_call(deploy.todo)))
    runs = []
    for i in range(1, operations + 1):
        runs.append(cut_in_commit(board, deploy, i, half))
        repair(board, deploy)
    new = runs.index(deploy.new_hash)
    assert new > 0 and set(runs[:new]) == {deploy.old_hash} and set(runs[new:]) == {deploy.new_hash}
    tell(operations)


@pytest.mark.exhaustive
@HALF
@pytest.mark.parametrize("deploy", ["older", "by_hand"])
def test_every_operation_of_a_boot_that_puts_the_new_firmware_in_place(request, switch_on, tell, deploy, half):
    deploy = request.getfixturevalue(deploy)
    board = switch_on(deploy.committed)
    operations = board.count(board.boot)
    for i in range(1, operations + 1):
        assert cut_in_boot(board, i, half) == deploy.new_hash, i
        repair(board, deploy)
    tell(operations)
