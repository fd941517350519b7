"""Deploys whose power goes, on the flash of the emulated RP2040: its LittleFS has to stand what a cut leaves.

A cut comes with one erase or program of the flash, which is then done or left half done. The default run cuts at a few
of them; --full at each operation of the exchange, both ways.
"""

import random
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from power import Board, Deploy, PowerCut, uploaded

from mirrormount.deploy.micropython import beside, board_script
from mirrormount.errors import EmulatorMissing

PAGE = 256  # bytes, the most that one operation programs
EXCHANGE, PUT_BACK = "exchange('')", "put_back('', True)"
HALF = pytest.mark.parametrize("half", [False, True], ids=["done", "half_done"])


@pytest.fixture(scope="module")
def deploy(tmp_path_factory) -> Deploy:
    try:
        return uploaded(tmp_path_factory.mktemp("other"))
    except EmulatorMissing as e:
        pytest.skip(str(e))


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


def cut(board: Board, before: str, action: str, operation: int, half: bool) -> str:
    """From all that was uploaded: do what is before, then the action, with a cut, and boot. Returns what runs."""
    board.start_over()
    prompt = board.prompt(board_script())
    prompt.run(before)
    board.cut_after(operation, half=half)
    with pytest.raises(PowerCut):
        prompt.run(action)
    return board.firmware()


def operations_of(board: Board, before: str, action: str) -> int:
    """How many operations of the flash the action takes."""
    prompt = board.prompt(board_script())
    prompt.run(before)
    return board.count(lambda: prompt.run(action))


def test_after_a_cut_while_the_new_firmware_is_written_the_old_one_starts(deploy, switch_on):
    places = random.Random(5)
    board = switch_on(deploy.uploaded)
    for path, content in list(deploy.todo.upload.items())[::16]:
        prompt = board.prompt()
        board.cut_after(places.randint(1, 1 + len(content) // PAGE), half=places.choice((False, True)))
        with pytest.raises(PowerCut):
            prompt.put(beside(path), content)
        assert board.firmware() in deploy.old, path


@pytest.mark.full
def test_a_cut_in_the_exchange_leaves_the_old_firmware_or_the_new_one(deploy, switch_on):
    board = switch_on(deploy.uploaded)
    last = operations_of(board, "pass", EXCHANGE)
    runs = [cut(board, "pass", EXCHANGE, i, half=i == last // 2) for i in (1, last // 2, last)]
    assert runs[0] in deploy.old and runs[1] in deploy.old | {deploy.new} and runs[2] == deploy.new


@pytest.mark.full
def test_a_boot_between_the_two_renames_may_be_cut_too(deploy, switch_on):
    board = switch_on(deploy.uploaded)
    between = "os.rename('main.py.new', 'main.py'); os.rename('mountfw', 'mountfw.old')"
    rename = "os.rename('mountfw.new', 'mountfw')"
    for i in range(1, operations_of(board, between, rename) + 1):
        board.start_over()
        board.prompt("import os").run(between)
        board.power_cycle()
        board.cut_after(i, half=i % 2 == 0)
        with pytest.raises(PowerCut):
            board.boot()
        assert board.firmware() == deploy.new


@pytest.mark.full
def test_a_cut_while_the_old_firmware_comes_back_leaves_it_or_the_new_one(deploy, switch_on):
    board = switch_on(deploy.uploaded)
    last = operations_of(board, EXCHANGE, PUT_BACK)
    assert cut(board, EXCHANGE, PUT_BACK, 2, half=True) in deploy.old | {deploy.new}
    assert cut(board, EXCHANGE, PUT_BACK, last, half=False) in deploy.old


@pytest.mark.full
@HALF
@pytest.mark.parametrize("before", ["pass", EXCHANGE])
def test_every_operation_of_an_exchange(deploy, switch_on, before, half):
    action = PUT_BACK if before == EXCHANGE else EXCHANGE
    board = switch_on(deploy.uploaded)
    for i in range(1, operations_of(board, before, action) + 1):
        assert cut(board, before, action, i, half) in deploy.old | {deploy.new}, i
        board.prompt(board_script()).run("survey()")  # as the next deploy does: it tidies up
        board.power_cycle()
        assert board.firmware() in deploy.old | {deploy.new}, i
