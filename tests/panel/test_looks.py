"""What can be read, reached and touched: contrasts, sizes and the focus, as a real browser lays them out."""

import signal

import pytest
from looks import DESK, PHONE, THEMES, assert_readable, assert_touchable, dress, settled
from running import press, run_until_driving
from served import wait_for

from mirrormount_panel.cards import curves

# pairs of cards of which one lies over the other, and what is wider than the window
OVERLAPS = """() => {
  const cards = [...document.querySelectorAll('.cards > .column .card')].map(card => card.getBoundingClientRect());
  const cut = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1 &&
    Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1;
  const over = cards.filter((a, i) => cards.some((b, j) => i < j && cut(a, b)));
  return over.length + (document.documentElement.scrollWidth > window.innerWidth ? 1 : 0);
}"""


@pytest.fixture
def panel_options() -> list[str]:
    return ["--patience", "2"]  # nothing here is about a page that is out of touch


@pytest.mark.full
@pytest.mark.parametrize("colors", THEMES)
def test_everything_can_be_read(open_page, panel, board, colors):
    page = open_page(panel.url, viewport=DESK)
    dress(page, colors)
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    page.get_by_text("What goes over the wire").click()
    page.get_by_label("Speed of Y").fill("256")
    press(page.get_by_role("button", name="OK", exact=True).first)
    page.locator(".toast").wait_for()
    assert_readable(page, "OK", "Save on the board", "Go to", "nothing was done")
    page.get_by_label("x: drive that takes up the backlash, us; 0: off").fill("1000")
    page.get_by_role("button", name="Apply").click()
    page.get_by_text("applied", exact=True).wait_for()
    page.get_by_role("button", name="Factory").click()
    page.get_by_text("Replace all settings by the factory's?").wait_for()
    assert_readable(page, "Replace them", "Cancel")
    page.get_by_role("button", name="Replace them").click()
    page.get_by_role("button", name="Undo the last change").wait_for()
    assert_readable(page, "Undo the last change")


@pytest.mark.full
@pytest.mark.parametrize("colors", THEMES)
def test_everything_can_be_read_when_the_board_has_gone_and_when_the_panel_has(open_page, panel, board, colors):
    page = open_page(panel.url, viewport=DESK)
    dress(page, colors)
    page.get_by_text("position unknown").first.wait_for()
    board.end()
    page.get_by_text("No board:").wait_for()
    page.get_by_text("not known since").first.wait_for()
    assert_readable(page, "No board:", "not known now", "not known since")
    panel.kill()
    page.get_by_text("No connection to the panel.").wait_for()
    assert_readable(page, "No connection to the panel.")


@pytest.mark.full
@pytest.mark.parametrize("viewport", [PHONE, DESK])
def test_everything_that_can_be_touched_is_at_least_44_px(open_page, panel, viewport):
    page = open_page(panel.url, viewport=viewport)
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    page.get_by_text("What goes over the wire").click()
    page.get_by_label("Speed of Y").fill("256")
    press(page.get_by_role("button", name="OK", exact=True).first)
    page.locator(".toast").wait_for()
    settled(page)
    assert_touchable(page)


@pytest.mark.full
def test_a_window_that_is_made_narrower_has_no_card_over_another_and_nothing_beside_it(open_page, page, panel):
    for width in (1400, 1240, 1100, 1000, 844, 390):
        page.set_viewport_size({"width": width, "height": 900})
        settled(page)
        wait_for(lambda: not page.evaluate(OVERLAPS), f"cards beside each other at {width} px")


@pytest.mark.full
@pytest.mark.parametrize("viewport", [PHONE, {"width": 1600, "height": 600}])
@pytest.mark.parametrize("key", ["Tab", "Shift+Tab"])
def test_what_has_the_focus_is_neither_under_stop_nor_under_the_header(open_page, panel, viewport, key):
    page = open_page(panel.url, viewport=viewport)
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    page.get_by_label("x: length of a step's pulse, us").wait_for()
    settled(page)
    for _ in range(page.locator("button:visible, input:visible").count() + 5):
        page.keyboard.press(key)
        # comes to rest there: what arrives from the board meanwhile may move the page once more
        page.wait_for_function(
            """() => {
                const e = document.activeElement;
                if (e === document.body || e.closest("footer, header")) return true;
                const box = e.getBoundingClientRect();
                const top = document.querySelector("header").getBoundingClientRect().bottom;
                const bottom = document.querySelector("footer").getBoundingClientRect().top;
                return box.top >= top - 1 && box.bottom <= bottom + 1;
            }"""
        )


@pytest.mark.full
@pytest.mark.parametrize("viewport", [PHONE, DESK])
def test_no_message_covers_take_control(open_page, page, panel, viewport):
    watcher = open_page(panel.url, viewport=viewport)
    press(watcher.get_by_role("button", name="UP", exact=True))
    watcher.locator(".toast", has_text="another page controls").wait_for()
    settled(watcher)
    watcher.get_by_role("button", name="Take control").click()  # fails if something is in front of it
    watcher.get_by_text("you control").wait_for()


@pytest.mark.full
def test_an_unknown_position_is_no_alarm(page):
    page.get_by_text("position unknown").first.wait_for()
    assert page.locator("section .lamp.bad").count() == 0


def test_stop_is_told_in_words_and_the_target_goes(page, board):
    page.get_by_label("Target of x").fill("20")
    page.get_by_label("Target of x").press("Enter")
    page.get_by_text("on the way to +20").wait_for()
    run_until_driving(board)
    page.keyboard.press("Escape")
    page.locator(".news").get_by_text("stopped: STOP was pressed").wait_for()
    page.get_by_text("last move: aborted (STOP was pressed)").wait_for()
    page.get_by_text("on the way to").wait_for(state="detached")


@pytest.mark.full
def test_a_stop_while_nothing_moves_is_told_too(page):
    page.keyboard.press("Escape")
    page.locator(".news").get_by_text("stopped: STOP was pressed").wait_for()
    assert page.get_by_text("Nothing since the panel was started").count() == 0


@pytest.mark.parametrize("how", ["gone", "frozen"])
def test_what_is_not_known_any_more_is_said_to_be_so(page, board, how):
    page.keyboard.press("ArrowRight")
    page.get_by_text("+1.000").wait_for()
    board.process.send_signal(signal.SIGTERM if how == "gone" else signal.SIGSTOP)
    page.get_by_text("not known since").first.wait_for()
    assert page.locator("section.stale .position").first.inner_text() in ("+1.000", "+0.000")
    assert page.locator("section.stale .lamp:is(.on, .warn, .bad)").count() == 0


def test_the_plot_has_a_gap_where_the_position_was_not_known():
    points = [(t / 20, (1.0, 2.0)) for t in range(1, 21)]
    points += [(1.05, None)]
    points += [(5 + t / 20, (9.0, 8.0)) for t in range(1, 21)]
    x, y = curves(points, 6.0)
    assert [steps for _, steps in x].count(None) >= 1
    for curve, after in ((x, 9.0), (y, 8.0)):
        before = curve[[steps for _, steps in curve].index(after) - 1]
        assert before[1] is None


def test_the_plot_has_a_gap_where_nobody_looked_and_none_elsewhere():
    points = [(t / 20, (1.0, 2.0)) for t in range(1, 1000)]
    assert None not in [steps for _, steps in curves(points, 50.0)[0]]
    points = [p for p in points if not 20 < p[0] < 30]
    assert [steps for _, steps in curves(points, 50.0)[0]].count(None) == 1


@pytest.mark.full
def test_settings_are_read_from_the_board_once_however_often_pages_ask(open_page, page, panel, board):
    """A page that watches and opens its settings again and again takes no time from the one that drives."""
    watcher = open_page(panel.url)
    page.get_by_text("What goes over the wire").click()
    for _ in range(20):
        watcher.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    page.keyboard.press("ArrowRight")
    page.get_by_text("+1.000").wait_for()
    wait_for(lambda: "1PR1" in page.locator(".wire").inner_text() or "2PR1" in page.locator(".wire").inner_text(), "it")
    assert page.locator(".wire").inner_text().count("XI?;2QM?") <= 1
