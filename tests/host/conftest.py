"""Fixtures: boards that are served while a test runs."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from served import ServedBoard


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., ServedBoard]]:
    if os.name != "posix":
        pytest.skip("a pty needs POSIX")
    boards: list[ServedBoard] = []

    def start(*options: str) -> ServedBoard:
        folder = tmp_path / str(len(boards))
        folder.mkdir()
        boards.append(ServedBoard(folder, *options))
        return boards[-1]

    yield start
    for board in boards:
        board.kill()
        board.process.stdout.close()


@pytest.fixture
def board(serve) -> ServedBoard:
    return serve()
