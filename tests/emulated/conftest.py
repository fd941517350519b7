"""Fixtures: boards of every machine, in lockstep."""

from collections.abc import Callable, Iterator

import pytest
from images import FOLDER
from lockstep_board import Board

from mirrormount.errors import EmulatorMissing
from mirrormount_sim import emulator
from mirrormount_sim.board import Options

# these need images that only a user can give: without them there is nothing to run, and nothing is skipped
collect_ignore = [] if FOLDER else ["test_images.py", "test_circuitpython.py"]
OF_IMAGES = ("test_images.py", "test_circuitpython.py")


@pytest.fixture
def make_board() -> Iterator[Callable[..., Board]]:
    boards: list[Board] = []

    def make(machine: str = "rp2040", **options) -> Board:
        try:
            boards.append(Board(Options(machine=machine, **options)))
        except EmulatorMissing as e:
            pytest.skip(str(e))
        return boards[-1]

    yield make
    for board in boards:
        board.simulation.close()


@pytest.fixture
def emulator_works() -> None:
    """Skips where no RP2040 can be emulated."""
    try:
        emulator.command()
    except EmulatorMissing as e:
        pytest.skip(str(e))


@pytest.fixture(params=["cpython", "micropython", "rp2040"])
def board(request, make_board) -> Board:
    """The same board on each machine."""
    return make_board(request.param)


def pytest_terminal_summary(terminalreporter):
    """A table of images and checks, if any were run."""
    passed: dict[str, list[str]] = {}
    failed: dict[str, list[str]] = {}
    for outcome, table in (("passed", passed), ("failed", failed), ("error", failed)):
        for report in terminalreporter.stats.get(outcome, []):
            file, _, test = report.nodeid.rpartition("/")[2].partition("::")
            image = test.partition("[")[2].rstrip("]")
            if file in OF_IMAGES and image and (report.when == "call" or outcome != "passed"):
                name = image.rpartition(".uf2")[0]
                table.setdefault(name, []).append(test.partition("[")[0].removeprefix("test_"))
    if passed or failed:
        terminalreporter.section("images")
        for name in sorted({*passed, *failed}):
            good, bad = passed.get(name, []), failed.get(name, [])
            text = f"{len(good)} of {len(good) + len(bad)} checks"
            terminalreporter.write_line(f"{name}: {text}" + "".join(f"\n    failed: {check}" for check in bad))
