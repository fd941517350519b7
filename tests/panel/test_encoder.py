"""A mount with encoders on the panel: its settings, and a hand on the knob."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from served import ServedBoard

HANDS = ",".join(f"m2:hand@{seconds}" for seconds in range(10, 120, 4))  # somebody turns the knob again and again


@pytest.fixture
def board(tmp_path: Path) -> Iterator[ServedBoard]:
    with ServedBoard(tmp_path / "board", "--encoder", "motor", "--fault", HANDS) as board:
        yield board


def test_the_loop_is_closed_on_the_panel_and_the_position_follows_a_hand(page, board):
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    page.get_by_label("x: counts of one step").fill("280")
    page.get_by_label("x: 1: closed loop").fill("1")
    page.get_by_role("button", name="Apply").click()
    page.get_by_text("applied", exact=True).wait_for()
    page.get_by_role("button", name="Zero").first.click()
    page.get_by_text("measured", exact=True).wait_for()
    page.wait_for_function("() => parseFloat(document.querySelector('.position').textContent.replace('+', '')) > 1")
    assert not any(edge["pin"] == "m2_en" for edge in board.edges())  # no motor was driven
