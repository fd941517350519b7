"""Fixtures: boards that are served while a test runs."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from served import ServedBoard


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., ServedBoard]]:
    with ExitStack() as boards:
        folders = (tmp_path / str(number) for number in itertools.count())
        yield lambda *options: boards.enter_context(ServedBoard(next(folders), *options))


@pytest.fixture
def board(serve) -> ServedBoard:
    return serve()
