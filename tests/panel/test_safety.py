"""What is driven lives as long as the page that drives it, and a stop always gets through."""

import json
import os
import signal
from pathlib import Path

import pytest
from running import (
    PANEL,
    Network,
    NotStarted,
    Panel,
    press,
    run_until_driving,
    status_after,
    wait_for_motion,
    wait_for_rest,
)
from served import PATIENCE_S, ServedBoard, run_process, wait_for
from websockets.sync.client import connect

from mirrormount.transport import stop_socket

ABORTED, KEEP_ALIVE = 3, 7


@pytest.fixture
def network(panel):
    network = Network(panel.port)
    yield network
    network.close()


def hold(page, board) -> None:
    """Hold RIGHT until it runs."""
    page.get_by_role("button", name="RIGHT", exact=True).hover()
    page.mouse.down()
    wait_for(lambda: [bool(e["duty"]) for e in board.edges() if e["pin"] == "m2_en"][:3] == [1, 0, 1], "the run")


def start_20_steps(page) -> None:
    page.get_by_label("Number of steps").fill("20")
    press(page.get_by_text("right ▶"))


def test_a_tab_that_is_closed_while_held_stops(page, panel, board):
    hold(page, board)
    page.close()
    wait_for_rest(board)
    assert status_after(panel, board).x.reason == ABORTED


def test_a_page_that_freezes_while_held_stops(page, panel, board):
    hold(page, board)
    page.evaluate("setTimeout(() => { const end = Date.now() + 5000; while (Date.now() < end); })")
    wait_for_rest(board)
    assert status_after(panel, board).x.reason == ABORTED


def test_a_network_that_is_cut_while_held_stops(open_page, network, panel, board):
    page = open_page(network.url)
    hold(page, board)
    network.cut()
    wait_for_rest(board)
    assert status_after(panel, board).x.reason == ABORTED


def test_a_move_of_20_steps_ends_with_the_page_that_asked_for_it(page, panel, board):
    start_20_steps(page)
    run_until_driving(board)
    page.close()
    wait_for_rest(board)
    assert status_after(panel, board).x.reason == ABORTED


def test_an_order_that_a_stuck_network_has_kept_back_is_not_obeyed(open_page, network, board):
    page = open_page(network.url)
    network.cut()
    start_20_steps(page)
    page.keyboard.press("ArrowUp")
    page.wait_for_function("const from = Date.now(); () => Date.now() - from > 1000")
    network.mend()
    page.get_by_text("that came late").first.wait_for()
    assert board.edges() == []


def test_a_stop_that_a_stuck_network_has_kept_back_is_obeyed(open_page, network, panel, board):
    other = open_page(panel.url)  # this one controls
    page = open_page(network.url)
    network.cut()
    page.keyboard.press("Escape")
    start_20_steps(other)
    run_until_driving(board)
    network.mend()
    wait_for_rest(board)
    assert status_after(panel, board).x.reason == ABORTED


def test_a_window_that_loses_the_focus_while_held_stops(page, board):
    hold(page, board)
    page.evaluate("window.dispatchEvent(new Event('blur'))")
    wait_for_rest(board)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_panel_that_dies_or_freezes_is_stopped_by_the_boards_keep_alive(page, panel, board, how):
    hold(page, board)
    panel.process.send_signal(how)
    wait_for_rest(board)
    panel.process.send_signal(signal.SIGCONT)
    assert status_after(panel, board).x.reason == KEEP_ALIVE


@pytest.mark.full
def test_ending_the_panel_stops_what_moves_and_says_nothing_ill(page, panel, board):
    hold(page, board)
    assert panel.end() == ""
    assert not board.driving()


def test_only_one_page_drives_and_the_other_watches(open_page, page, panel, board):
    watcher = open_page(panel.url)
    watcher.get_by_text("you watch").wait_for()
    press(watcher.get_by_role("button", name="UP", exact=True))
    watcher.get_by_text("another page controls").wait_for()
    assert board.edges() == []


def test_the_page_that_watches_can_stop(open_page, page, panel, board):
    watcher = open_page(panel.url)
    start_20_steps(page)
    run_until_driving(board)
    watcher.get_by_role("button", name="STOP").click()
    page.get_by_text("last move: aborted").wait_for()
    assert not board.driving()


def test_whoever_takes_control_stops_what_the_other_drove_and_drives(open_page, page, panel, board):
    other = open_page(panel.url)
    start_20_steps(page)
    run_until_driving(board)
    press(other.get_by_role("button", name="Take control"))
    page.get_by_text("you watch").wait_for()
    other.get_by_text("last move: aborted").wait_for()
    wait_for_rest(board)
    press(other.get_by_role("button", name="UP", exact=True))
    wait_for(lambda: any(e["pin"] == "m1_pos" for e in board.edges()), "the step of the other page")
    press(page.get_by_role("button", name="DOWN", exact=True))
    page.get_by_text("another page controls").wait_for()
    assert not any(e["pin"] == "m1_neg" for e in board.edges())


@pytest.mark.full
def test_a_page_that_comes_after_the_one_that_controlled_has_gone_controls(open_page, page, panel, board):
    page.close()
    other = open_page(panel.url)
    press(other.get_by_role("button", name="UP", exact=True))
    wait_for_motion(board)


def test_an_unplugged_board_is_told_and_comes_back_without_moving(page, panel, board, tmp_path):
    start_20_steps(page)
    run_until_driving(board)
    folder = board.link.parent
    board.end()
    page.get_by_text("No board:").wait_for()
    press(page.get_by_role("button", name="UP", exact=True))
    page.get_by_text("nothing was done").first.wait_for()
    with ServedBoard(folder) as again:
        page.get_by_text("the board is back").wait_for()
        page.get_by_text("No board:").wait_for(state="hidden")
        assert again.edges() == []
        press(page.get_by_role("button", name="UP", exact=True))
        run_until_driving(again)


@pytest.mark.full
def test_an_error_of_the_board_is_shown_with_cause_and_remedy(page, panel, board):
    page.keyboard.press("ArrowRight")
    page.get_by_text("+1.000").wait_for()
    wait_for_rest(board)
    before = board.edges()
    page.get_by_label("Number of steps").fill("999999")  # to 1 000 000: beyond what can be counted
    press(page.get_by_text("right ▶"))
    page.get_by_text("the board says 201").first.wait_for()
    assert board.edges() == before


def test_a_panel_without_a_board_says_so_in_one_line(tmp_path):
    with pytest.raises(NotStarted) as e:
        Panel(str(tmp_path / "nothing"), tmp_path)
    assert str(e.value) == f"mirrormount: {tmp_path}/nothing: there is no such port (see: mirrormount ports)\n"


@pytest.mark.full
def test_a_page_that_watches_cannot_change_settings_or_the_zero(open_page, page, panel, board):
    watcher = open_page(panel.url)
    page.keyboard.press("ArrowRight")
    watcher.get_by_text("+1.000").wait_for()
    press(watcher.get_by_role("button", name="Zero").first)
    watcher.get_by_text("another page controls").wait_for()
    watcher.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    watcher.get_by_role("button", name="Restore saved").click()
    watcher.locator(".q-notification__badge", has_text="2").wait_for()  # told again
    assert watcher.get_by_text("+1.000").count() == 1


@pytest.mark.full
def test_a_page_that_comes_again_does_not_keep_alive_what_it_held_before(page, panel, board):
    """As when its network has changed, and nobody has told the panel that the first connection is dead."""
    hold(page, board)
    key = page.locator("[data-page]").get_attribute("data-page")
    with connect(f"ws://127.0.0.1:{panel.port}/drive", proxy=None) as again:
        again.send(json.dumps({"page": key}))
        beat_until(again, lambda: not board.driving())
    assert status_after(panel, board).x.reason == ABORTED


def beat_until(socket, condition) -> None:
    """Answer the panel's ticks as a page does."""

    def beat() -> bool:
        socket.send(json.dumps({"do": "beat", "tick": json.loads(socket.recv(1))["tick"]}))
        return condition()

    wait_for(beat, "the motors to rest")


@pytest.mark.full
def test_a_network_that_keeps_everything_back_is_told(open_page, network):
    page = open_page(network.url)
    page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    network.cut()
    page.get_by_text("No connection to the panel.").wait_for()
    assert 0 <= page.get_by_text("No connection to the panel.").bounding_box()["y"] < 100
    network.mend()
    page.get_by_text("No connection to the panel.").wait_for(state="hidden")


@pytest.mark.full
def test_a_terminal_that_is_closed_ends_the_panel_as_a_service_manager_does(page, panel, board):
    hold(page, board)
    panel.process.send_signal(signal.SIGHUP)
    assert panel.process.communicate(timeout=PATIENCE_S)[1] == ""
    assert not board.driving()


@pytest.mark.full
def test_a_panel_that_cannot_write_its_log_drives(open_page, board):
    panel = Panel(str(board.link), Path(os.devnull), program=PANEL)
    try:
        press(open_page(panel.url).get_by_role("button", name="UP", exact=True))
        wait_for_motion(board)
    finally:
        panel.kill()


@pytest.mark.full
def test_settings_that_a_stuck_network_has_kept_back_are_not_applied(open_page, network):
    page = open_page(network.url)
    page.get_by_text("What goes over the wire").click()
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    page.wait_for_function("""document.querySelector('[aria-label^="x: drive that takes"]').value === "0" """)
    page.get_by_label("x: drive that takes up").fill("3000")
    network.cut()
    page.get_by_role("button", name="Apply").click()
    page.wait_for_function("const from = Date.now(); () => Date.now() - from > 1000")
    network.mend()
    page.get_by_text("that came late").first.wait_for()
    assert "XB3000" not in page.locator(".wire").inner_text()


@pytest.mark.skipif(not stop_socket.supported(), reason="no Unix sockets")
def test_mirrormount_stop_works_while_the_panel_has_the_port_and_is_told_in_words(page, panel, board):
    hold(page, board)
    run = run_process("stop", "--port", str(board.link))
    assert run.returncode == 0, run.stderr
    wait_for_rest(board)
    page.locator(".news").get_by_text("another program of this computer asked for it (mirrormount stop)").wait_for()
    assert not board.driving()
