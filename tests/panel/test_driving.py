"""Each way of driving, from the browser to the pins of the virtual board."""

import itertools
import re

import pytest
from looks import settled
from playwright.sync_api import expect
from running import press, pulses, run_until_driving, wait_for_rest
from served import wait_for

from mirrormount.supervise.worker import MOST
from mirrormount_panel.cards import SLOW

LEGS = {"UP": "m1_pos", "DOWN": "m1_neg", "RIGHT": "m2_pos", "LEFT": "m2_neg"}
ARROWS = {"UP": "ArrowUp", "DOWN": "ArrowDown", "RIGHT": "ArrowRight", "LEFT": "ArrowLeft"}
PULSE_US = 200_000
FRESH = {"viewport": {"width": 1600, "height": 1000}}  # a browser of its own, that remembers nothing


@pytest.fixture
def panel_options() -> list[str]:
    return ["--patience", "2"]  # nothing here is about a page that is out of touch


def legs_used(board) -> set[str]:
    return {e["pin"] for e in board.edges() if not e["pin"].endswith("_en")}


def wait_for_pulses(board, count: int) -> None:
    """Wait for that many pulses to be over."""

    def over() -> bool:
        return sum(e["pin"].endswith("_en") and e["duty"] == 0 for e in board.edges()) >= count

    wait_for(over, f"{count} pulses")


def on_times_us(board, enable: str) -> list[int]:
    edges = [e for e in board.edges() if e["pin"] == enable]
    return [off["t_us"] - on["t_us"] for on, off in itertools.pairwise(edges) if off["duty"] == 0]


FIRST, *OTHERS = LEGS


@pytest.mark.parametrize("word", [FIRST, *(pytest.param(word, marks=pytest.mark.full) for word in OTHERS)])
def test_a_short_press_is_one_step_that_way(page, board, word):
    press(page.get_by_role("button", name=word, exact=True))
    wait_for_pulses(board, 1)
    assert legs_used(board) == {LEGS[word]}
    assert on_times_us(board, LEGS[word][:2] + "_en") == [pytest.approx(PULSE_US, abs=50)]


@pytest.mark.full
@pytest.mark.parametrize("word", ARROWS)
def test_a_short_stroke_of_an_arrow_key_is_one_step_that_way(page, board, word):
    page.keyboard.press(ARROWS[word])
    wait_for_pulses(board, 1)
    assert legs_used(board) == {LEGS[word]}
    assert on_times_us(board, LEGS[word][:2] + "_en") == [pytest.approx(PULSE_US, abs=50)]


def set_step(page, typed: str) -> None:
    page.get_by_label("Steps of a short press").fill(typed)
    page.get_by_label("Steps of a short press").blur()


def test_a_short_press_makes_as_many_steps_as_the_field_says_and_with_shift_one(page, board):
    set_step(page, "3")
    page.keyboard.press("ArrowRight")
    wait_for_pulses(board, 3)
    page.get_by_text("+3.000").wait_for()
    page.keyboard.press("Shift+ArrowRight")
    page.get_by_text("+4.000").wait_for()
    assert on_times_us(board, "m2_en") == [pytest.approx(PULSE_US, abs=50)] * 4


@pytest.mark.full
@pytest.mark.parametrize("typed", ["0", "-1", "101", "1.5", "", "ten"])
def test_a_step_that_cannot_be_is_told_and_drives_nothing(page, board, typed):
    set_step(page, typed)
    page.keyboard.press("ArrowRight")
    page.get_by_text("nothing was done: the step of a press").wait_for()
    assert board.edges() == []


def hold(page, word: str) -> None:
    page.get_by_role("button", name=word, exact=True).hover()
    page.mouse.down()


def wait_for_run(board, enable: str = "m2_en") -> None:
    """Wait until the step at the beginning is over and the run has begun."""
    wait_for(lambda: [bool(e["duty"]) for e in board.edges() if e["pin"] == enable][:3] == [1, 0, 1], "the run")


def test_a_held_button_runs_until_it_is_let_go(page, board):
    hold(page, "RIGHT")
    wait_for_run(board)
    page.mouse.up()
    wait_for_rest(board)
    assert len(on_times_us(board, "m2_en")) == 2
    assert legs_used(board) == {"m2_pos"}


@pytest.mark.full
def test_a_held_key_runs_until_it_is_let_go(page, board):
    page.keyboard.down("ArrowUp")
    wait_for_run(board, "m1_en")
    page.keyboard.up("ArrowUp")
    wait_for_rest(board)
    assert len(on_times_us(board, "m1_en")) == 2


@pytest.mark.full
def test_a_button_in_focus_is_held_with_enter(page, board):
    page.get_by_role("button", name="LEFT", exact=True).focus()
    page.keyboard.down("Enter")
    wait_for_run(board)
    page.keyboard.up("Enter")
    wait_for_rest(board)
    assert legs_used(board) == {"m2_neg"}


def duties(board) -> list[int]:
    return [e["duty"] for e in board.edges() if e["pin"] == "m2_en"]


@pytest.mark.full
def test_a_held_run_with_shift_has_a_quarter_of_the_speed(page, board):
    page.get_by_role("slider", name="Speed").fill("100")
    page.get_by_role("slider", name="Speed").blur()
    page.keyboard.down("Shift")
    page.keyboard.down("ArrowRight")
    wait_for_run(board)
    page.keyboard.up("ArrowRight")
    page.keyboard.up("Shift")
    wait_for_rest(board)
    assert duties(board) == [65535, 0, 25 * 257, 0]


@pytest.mark.full
def test_the_slider_starts_slow_and_sets_the_speed_of_the_run_and_not_of_the_step(open_page, panel, board):
    page = open_page(panel.url, **FRESH)
    assert page.get_by_role("slider", name="Speed").input_value() == str(SLOW)
    page.get_by_role("slider", name="Speed").focus()
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    hold(page, "RIGHT")
    wait_for_run(board)
    page.mouse.up()
    wait_for_rest(board)
    assert duties(board) == [65535, 0, (SLOW + 5) * 257, 0]


@pytest.mark.full
def test_the_slider_is_remembered_when_the_page_is_loaded_again(open_page, panel, board):
    page = open_page(panel.url, **FRESH)
    page.get_by_role("slider", name="Speed").fill("33")
    page.reload()
    page.wait_for_selector("body.steady")
    assert page.locator('[data-shows="speed"]').inner_text() == "33"
    hold(page, "RIGHT")
    wait_for_run(board)
    page.mouse.up()
    wait_for_rest(board)
    assert duties(board) == [65535, 0, 33 * 257, 0]


@pytest.mark.full
def test_four_taps_in_a_row_are_four_steps(page, board):
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    wait_for_pulses(board, 4)
    page.get_by_text("+4.000").wait_for()
    assert on_times_us(board, "m2_en") == [pytest.approx(PULSE_US, abs=50)] * 4
    assert page.locator(".q-notification").count() == 0


@pytest.mark.full
def test_taps_that_wait_are_shown_and_stop_drops_them(page, board):
    set_step(page, "10")
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    page.get_by_text("3 queued").wait_for()
    page.keyboard.press("Escape")
    wait_for_rest(board)
    page.get_by_text("queued", exact=False).filter(has_text=re.compile("^[0-9]+ queued$")).wait_for(state="detached")
    page.get_by_text("last move: aborted (STOP was pressed)").wait_for()
    page.keyboard.press("Shift+ArrowUp")
    page.locator("section", has_text="Y ·").get_by_text("+1.000").wait_for()
    assert len(on_times_us(board, "m2_en")) < 10


@pytest.mark.full
def test_more_taps_than_can_wait_are_told(page, board):
    set_step(page, "10")
    for _ in range(MOST + 2):
        page.keyboard.press("ArrowRight")
    page.get_by_text("this press was not counted: 10 presses wait already").first.wait_for()
    page.keyboard.press("Escape")
    wait_for_rest(board)


def test_a_diagonal_button_steps_both_axes_at_once_and_holds_run_both(page, board):
    press(page.get_by_role("button", name="UP AND LEFT"))
    wait_for_pulses(board, 2)
    assert legs_used(board) == {"m1_pos", "m2_neg"}
    for enable in ("m1_en", "m2_en"):
        assert on_times_us(board, enable) == [pytest.approx(PULSE_US, abs=50)]
    on = [e["t_us"] for e in board.edges() if e["pin"].endswith("_en") and e["duty"]]
    assert abs(on[1] - on[0]) < PULSE_US  # both were on at the same time
    hold(page, "DOWN AND RIGHT")
    wait_for(lambda: board.enables() == {"m1_en": SLOW * 257, "m2_en": SLOW * 257}, "both axes to run")
    page.mouse.up()
    wait_for_rest(board)


def test_sliding_off_the_button_stops(page, board):
    hold(page, "RIGHT")
    wait_for_run(board)
    page.mouse.move(5, 5)
    wait_for_rest(board)
    page.mouse.up()
    assert len(on_times_us(board, "m2_en")) == 2


def test_a_finger_on_a_phone_drives_as_a_mouse_does(open_page, panel, board):
    page = open_page(panel.url, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    box = page.get_by_role("button", name="DOWN", exact=True).bounding_box()
    touch = [{"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}]
    devtools = page.context.new_cdp_session(page)
    devtools.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": touch})
    wait_for_run(board, "m1_en")
    devtools.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    wait_for_rest(board)
    assert legs_used(board) == {"m1_neg"}


@pytest.mark.full
def test_fine_steps_are_as_many_as_stated(page, board):
    page.get_by_label("Number of steps").fill("3")
    press(page.get_by_role("button", name="left", exact=False).get_by_text("◀ left"))
    wait_for_pulses(board, 3)
    page.get_by_text("−3.000").wait_for()
    assert on_times_us(board, "m2_en") == [pytest.approx(PULSE_US, abs=50)] * 3
    assert legs_used(board) == {"m2_neg"}


@pytest.mark.full
def test_typed_speeds_run_both_motors_until_stop(page, board):
    page.get_by_label("Speed of Y").fill("-100")
    page.get_by_label("Speed of X").fill("50")
    press(page.get_by_role("button", name="OK"))
    wait_for(lambda: board.enables() == {"m1_en": 100 * 257, "m2_en": 50 * 257}, "both motors at their speeds")
    assert legs_used(board) == {"m1_neg", "m2_pos"}
    page.get_by_role("button", name="STOP").click()
    wait_for_rest(board)


@pytest.mark.full
@pytest.mark.parametrize("typed", ["256", "-256", "1.5", "fast", "", "1e2", "٣"])
def test_a_speed_that_cannot_be_is_told_and_drives_nothing(page, board, typed):
    page.get_by_label("Speed of Y").fill(typed)
    page.get_by_label("Speed of X").fill("50")
    press(page.get_by_role("button", name="OK"))
    page.get_by_text("nothing was done: the speed of Y").wait_for()
    assert board.edges() == []


def test_go_to_makes_the_way_that_is_left(page, board):
    for target, shown in (("4", "+4.000"), ("1", "+1.000")):
        page.get_by_label("Target of y").fill(target)
        page.get_by_label("Target of y").press("Enter")
        page.get_by_text(shown).wait_for()
    wait_for_rest(board)
    assert len(on_times_us(board, "m1_en")) == 7


@pytest.mark.full
def test_zero_makes_the_present_position_zero(page, board):
    page.keyboard.press("ArrowRight")
    page.get_by_text("+1.000").wait_for()
    press(page.get_by_role("button", name="Zero").first)
    page.get_by_text("counted").wait_for()
    page.get_by_text("+1.000").wait_for(state="detached")


FOCUSED = {
    "what drove": "[data-send][data-fields^='n:']",
    "a field": 'input[name="steps"]',
    "the slider": 'input[name="speed"]',
    "a direction button": '[data-press="y:1"]',
}


@pytest.mark.parametrize(
    ("key", "focused"),
    [
        (None, None),
        pytest.param("Escape", None, marks=pytest.mark.full),
        ("Escape", "a field"),
        (" ", None),
        pytest.param(" ", "what drove", marks=pytest.mark.full),
        pytest.param(" ", "the slider", marks=pytest.mark.full),
        (" ", "a direction button"),
    ],
)
def test_stop_ends_a_move_of_20_steps(page, board, key, focused):
    page.get_by_label("Number of steps").fill("20")
    press(page.get_by_text("right ▶"))
    run_until_driving(board)
    if focused:
        page.locator(FOCUSED[focused]).first.focus()
    else:
        page.evaluate("document.activeElement.blur()")
    if key:
        page.keyboard.press(key)
    else:
        page.get_by_role("button", name="STOP").click()
    page.get_by_text("last move: aborted (STOP was pressed)").wait_for()
    assert not board.driving()
    assert pulses(board, "m2_pos") < 20
    assert legs_used(board) == {"m2_pos"}


def test_space_stops_when_it_goes_down_and_what_was_clicked_last_is_not_driven(page, board):
    press(page.get_by_role("button", name="RIGHT", exact=True))  # which has the focus now
    page.get_by_text("+1.000").wait_for()
    page.keyboard.down("ArrowUp")
    wait_for_run(board, "m1_en")
    page.keyboard.down(" ")
    wait_for_rest(board)
    page.keyboard.up(" ")
    page.keyboard.up("ArrowUp")
    page.locator(".news").get_by_text("stopped: STOP was pressed").wait_for()
    assert len(on_times_us(board, "m2_en")) == 1


@pytest.mark.full
def test_space_on_a_control_that_drives_nothing_is_for_that_control_and_stops_while_a_key_is_held(page, board):
    page.get_by_text("What goes over the wire").click()
    box = page.get_by_role("checkbox", name="with the questions after the state")
    settled(page)
    box.focus()
    expect(box).to_be_focused()
    page.keyboard.press(" ")
    expect(box).to_be_checked()
    page.keyboard.down("ArrowUp")
    wait_for_run(board, "m1_en")
    page.keyboard.press(" ")
    wait_for_rest(board)
    page.keyboard.up("ArrowUp")
    expect(box).to_be_checked()
    page.get_by_label("Number of steps").focus()
    page.keyboard.type(" 1 0")
    expect(page.locator(".news").get_by_text("stopped: STOP was pressed")).to_have_count(1)


@pytest.mark.parametrize(
    "gone",
    [
        "dispatchEvent(new Event('blur'))",
        pytest.param("dispatchEvent(new Event('pagehide'))", marks=pytest.mark.full),
        pytest.param(
            "Object.defineProperty(document, 'hidden', { value: true });"
            "document.dispatchEvent(new Event('visibilitychange'))",
            marks=pytest.mark.full,
        ),
    ],
)
def test_a_space_bar_that_comes_up_elsewhere_types_in_a_field_afterwards(page, gone):
    page.keyboard.down(" ")
    page.locator(".news").get_by_text("stopped: STOP was pressed").wait_for()
    page.evaluate(f"() => {{ {gone} }}")
    field = page.get_by_label("Number of steps")
    field.fill("")
    field.focus()
    page.keyboard.type("a b")
    expect(field).to_have_value("a b")


@pytest.mark.full
def test_an_arrow_key_in_a_field_moves_the_cursor_only(page, board):
    page.get_by_label("Number of steps").focus()
    page.keyboard.press("ArrowLeft")
    press(page.get_by_role("button", name="UP", exact=True))
    wait_for_pulses(board, 1)
    assert legs_used(board) == {"m1_pos"}


@pytest.mark.full
@pytest.mark.parametrize("typed", ["+3", "3"])
def test_the_button_says_which_way_fine_steps_go(page, board, typed):
    page.get_by_label("Number of steps").fill(typed)
    press(page.get_by_text("◀ left"))
    wait_for_pulses(board, 3)
    assert legs_used(board) == {"m2_neg"}


@pytest.mark.full
def test_a_negative_number_of_steps_is_refused(page, board):
    page.get_by_label("Number of steps").fill("-3")
    press(page.get_by_text("◀ left"))
    page.get_by_text("the button says which way").wait_for()
    assert board.edges() == []


@pytest.mark.full
def test_a_mouse_button_that_comes_up_while_another_is_down_stops(page, board):
    hold(page, "RIGHT")
    wait_for_run(board)
    page.mouse.down(button="right")
    page.mouse.up()
    wait_for_rest(board)
    page.mouse.up(button="right")


@pytest.mark.full
def test_stop_obeys_a_click_that_no_pointer_made(page, board):
    """As screen readers and voice control click."""
    page.get_by_label("Number of steps").fill("20")
    press(page.get_by_text("right ▶"))
    run_until_driving(board)
    page.evaluate("document.querySelector('[data-stop]').click()")
    page.get_by_text("last move: aborted").wait_for()


@pytest.mark.full
def test_cmd_lets_go_of_an_arrow_key(page, board):
    page.keyboard.down("ArrowRight")
    wait_for_run(board)
    page.keyboard.down("Meta")
    wait_for_rest(board)


@pytest.mark.full
@pytest.mark.parametrize("event", ["contextmenu", "dragstart"])
def test_what_takes_the_keys_from_the_page_lets_go_of_an_arrow_key(page, board, event):
    page.keyboard.down("ArrowRight")
    wait_for_run(board)
    page.locator("header").dispatch_event(event)
    wait_for_rest(board)
