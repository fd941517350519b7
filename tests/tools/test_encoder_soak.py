"""Facts about tools/bench/encoder_soak.py, on the firmware in this Python; tests/emulated has the emulated board."""

import re
from dataclasses import replace

import encoder_soak
import pytest
from lab import Board

from mirrormount_sim.board import Options, make_simulation


@pytest.fixture
def soak():
    board = Board(make_simulation(Options("cpython", encoder="motor", seed=2)))
    board.clear()
    yield encoder_soak.Soak(board, seed=2)
    board.simulation.close()


def test_a_move_that_did_not_come_to_its_counts_is_told_with_its_step_and_the_soak_goes_on(soak):
    fast = replace(encoder_soak.CLOSED, supply=(encoder_soak.FAST, encoder_soak.FAST))
    soak.ask(b"1DB0;2DB0;1CL0;2CL0")  # judged while the motors still coast
    soak.round(fast)
    steps = soak.tally.steps.total()
    told = [fault for fault in soak.tally.faults if "reason 11" in fault]
    assert re.search(r"us, step \d+: axis (\d): .* steps, \d+ counts off, reason 11, error (?:\1)50", told[0])
    soak.round(encoder_soak.CLOSED)
    assert soak.tally.steps.total() > steps
    assert soak.tally.lost == 0


def test_any_other_error_ends_the_soak(soak):
    soak.board.ask(b"1PR")
    with pytest.raises(encoder_soak.Lost, match="38"):
        soak.round(encoder_soak.CLOSED)
