"""A camera loop beside the panel: it asks for control, a person hands it over, keeps it, and takes it back."""

import pytest
from running import PANEL_AND_LOOP, Panel, press, run_until_driving, wait_for_rest


@pytest.fixture
def panel(board, tmp_path):
    panel = Panel(str(board.link), tmp_path, program=PANEL_AND_LOOP)
    yield panel
    panel.kill()


def hand_over(page, panel) -> None:
    assert panel.loop("ask") == "done"
    page.get_by_text("camera loop asks for control.").wait_for()
    press(page.get_by_role("button", name="Hand over"))
    assert panel.loop("outcome") == "done"
    page.get_by_text("camera loop controls").wait_for()


def test_a_page_hands_control_over_and_takes_it_back_by_a_press_without_being_closed(page, panel, board):
    page.get_by_text("camera loop asks").wait_for(state="hidden")
    hand_over(page, panel)
    page.get_by_text("camera loop asks").wait_for(state="hidden")
    assert panel.loop("jog") == "done"
    run_until_driving(board)
    press(page.get_by_role("button", name="UP", exact=True))
    assert "aborted" in panel.loop("outcome")
    page.locator(".position").nth(1).get_by_text("+1.000").wait_for()  # the press was a step of its own
    wait_for_rest(board)
    assert panel.loop("take") == "nothing was done: page 1 (127.0.0.1) has control"
    assert panel.loop("jog") == "nothing was done: page 1 (127.0.0.1) has control"


def test_a_panel_whose_server_hangs_keeps_nothing_alive_that_a_program_beside_it_moves(panel, board):
    assert panel.loop("take") == panel.loop("jog") == "done"
    run_until_driving(board)
    assert panel.loop("hang") == "done"
    wait_for_rest(board)
    assert "aborted" in panel.loop("outcome")
    assert panel.loop("take") == "done"
    assert panel.loop("jog") == "done"
    assert panel.loop("outcome") == "nothing was done: the panel's web server hangs (for more than 2 s)"


@pytest.mark.full
def test_stop_takes_control_back_too_and_the_loop_must_ask_again(page, panel, board):
    hand_over(page, panel)
    assert panel.loop("jog") == "done"
    run_until_driving(board)
    page.keyboard.press("Escape")
    assert "aborted" in panel.loop("outcome")
    wait_for_rest(board)
    page.get_by_text("camera loop controls").wait_for(state="hidden")
    assert "has control" in panel.loop("take")
    hand_over(page, panel)


@pytest.mark.full
def test_a_page_that_keeps_control_says_so_to_the_loop(page, panel, board):
    assert panel.loop("ask") == "done"
    press(page.get_by_role("button", name="Keep control"))
    assert panel.loop("outcome") == "nothing was done: page 1 (127.0.0.1) keeps control"
    page.get_by_text("camera loop asks").wait_for(state="hidden")
    assert board.edges() == []


@pytest.mark.full
def test_a_page_that_watches_is_not_asked(open_page, page, panel):
    watcher = open_page(panel.url)
    assert panel.loop("ask") == "done"
    page.get_by_text("camera loop asks").wait_for()
    assert not watcher.get_by_text("camera loop asks").is_visible()
