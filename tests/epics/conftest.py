"""Fixtures: a virtual board in a process of its own, and `mirrormount ioc` on it."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from iocs import Ioc
from served import ServedBoard, wait_for


@pytest.fixture
def board(tmp_path: Path) -> Iterator[ServedBoard]:
    with ServedBoard(tmp_path / "board") as board:
        yield board


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "settings"))


@pytest.fixture
def ioc(board: ServedBoard) -> Iterator[Ioc]:
    with Ioc(str(board.link)) as ioc:
        yield ioc


@pytest.fixture
def rests(board: ServedBoard) -> Callable[[], object]:
    """Waits until the motors rest."""
    return lambda: wait_for(lambda: not board.driving(), "the motors to rest")


@pytest.fixture
def drives(board: ServedBoard) -> Callable[[], object]:
    """Waits until a motor runs."""
    return lambda: wait_for(board.driving, "a motor to run")
