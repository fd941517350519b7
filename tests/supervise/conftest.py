"""Fixtures: a virtual board in a process of its own, a supervisor that owns it, and a program as its client."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from served import ServedBoard, wait_for
from supervised import AlwaysAlive

from mirrormount.supervise.lease import Client, Lease
from mirrormount.supervise.supervisor import Program, Supervisor


@pytest.fixture
def board(tmp_path: Path) -> Iterator[ServedBoard]:
    with ServedBoard(tmp_path / "board") as board:
        yield board


@pytest.fixture
def patience_s() -> float:
    return 50.0  # but where a test is about a client that hangs


@pytest.fixture
def supervisor(board: ServedBoard, patience_s: float) -> Iterator[Supervisor]:
    with Supervisor(str(board.link), patience_s=patience_s) as supervisor:
        wait_for(lambda: supervisor.worker.state.status, "the first poll of the board")
        yield supervisor


@pytest.fixture
def told() -> list[str]:
    """Why the program has lost control."""
    return []


@pytest.fixture
def loop(supervisor: Supervisor, told: list[str]) -> Iterator[Program]:
    """A program that has control."""
    with supervisor.join("camera loop", told.append) as loop:
        loop.take_control()
        yield loop


@pytest.fixture
def lease() -> Lease:
    return AlwaysAlive()


@pytest.fixture
def page(lease: Lease) -> Client:
    """A person at a page, connected."""
    page = Client("page 1 (here)", is_person=True)
    lease.join(page, object())
    return page
