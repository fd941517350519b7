"""Driving by a gamepad, made up by a script in the browser: what drives, what stops, and what must not drive."""

import pytest
from playwright.sync_api import expect
from running import press, run_until_driving, wait_for_rest
from served import wait_for
from test_driving import duties, legs_used, on_times_us, wait_for_pulses, wait_for_run

UP, DOWN, LEFT, RIGHT = 12, 13, 14, 15
SHOULDER = 5
STEP_WORDS = {"m1_pos": (0, -1), "m1_neg": (0, 1), "m2_pos": (1, 0), "m2_neg": (-1, 0)}  # a stick's y points down

# A gamepad of the standard layout, as navigator.getGamepads() tells of one. plug(): connect it as it is.
MADE = """
  window.pad = { index: 0, id: "made", connected: true, mapping: "standard", axes: [0, 0, 0, 0],
    buttons: Array.from({ length: 17 }, () => ({ pressed: false })) };
  window.pads = [];
  Object.defineProperty(navigator, "getGamepads", { value: () => window.pads });
  window.plug = () => {
    window.pads = [window.pad];
    window.dispatchEvent(new Event("gamepadconnected"));
  };
  window.frames_seen = (count) => new Promise((done) => {
    const next = () => (count-- > 0 ? requestAnimationFrame(next) : done());
    next();
  });
  // down until it presses, and no longer: where frames are slow, so many of them would be a run
  window.tap = async (buttons) => {
    for (const at of buttons) window.pad.buttons[at].pressed = true;
    for (let left = 10; left && !window.mountHeld(); left--) await window.frames_seen(1);
    for (const at of buttons) window.pad.buttons[at].pressed = false;
    await window.frames_seen(10);
  };
"""
DRIVES = "d-pad or left stick drives"
WAITS = "when all its sticks and buttons were let go"


class Pad:
    """The made gamepad of a page."""

    def __init__(self, page) -> None:
        self._page = page

    def plug(self) -> None:
        self._page.evaluate("plug()")

    def stick(self, x: float, y: float) -> None:
        self._page.evaluate("([x, y]) => pad.axes.splice(0, 2, x, y)", [x, y])

    def button(self, at: int, *, down: bool) -> None:
        self._page.evaluate("([at, down]) => (pad.buttons[at].pressed = down)", [at, down])

    def tap(self, *buttons: int) -> None:
        self._page.evaluate("tap", buttons)

    def seen(self) -> None:
        """Wait until it was looked at for long enough for a direction to count."""
        self._page.evaluate("frames_seen(10)")

    def says(self, text: str) -> None:
        expect(self._page.locator("[data-gamepad]").first).to_contain_text(text)


@pytest.fixture
def panel_options() -> list[str]:
    return ["--patience", "2"]  # nothing here is about a page that is out of touch


@pytest.fixture
def page(open_page, panel):
    return open_page(panel.url, before=lambda page: page.add_init_script(MADE))


@pytest.fixture
def pad(page) -> Pad:
    """A gamepad that was seen at rest."""
    pad = Pad(page)
    pad.plug()
    pad.says(DRIVES)
    return pad


def run_right(pad, board) -> None:
    pad.stick(1, 0)
    wait_for_run(board)


def assert_only_a_key_drives(page, board, enable: str = "m1_en") -> None:
    """A step up by a key is made, and nothing beside it."""
    before = len(board.edges())
    page.keyboard.press("ArrowUp")
    wait_for(lambda: any(e["pin"] == enable and e["duty"] for e in board.edges()[before:]), "the step of the key")
    wait_for_rest(board)
    driven = {
        e["pin"] for e in board.edges()[before:] if e.get("duty") or e.get("level")
    }  # the end of another may follow
    assert driven <= {"m1_pos", "m1_en"}


def test_the_page_tells_of_a_gamepad_and_what_its_buttons_do(page):
    line = page.locator("[data-gamepad]")
    expect(line).to_be_hidden()
    pad = Pad(page)
    pad.plug()
    pad.says("any face button (A, B, X, Y): STOP")
    page.evaluate("pads = []")
    expect(line).to_be_hidden()


@pytest.mark.parametrize(
    ("buttons", "legs"),
    [
        ((RIGHT,), {"m2_pos"}),
        pytest.param((LEFT,), {"m2_neg"}, marks=pytest.mark.full),
        pytest.param((UP,), {"m1_pos"}, marks=pytest.mark.full),
        pytest.param((DOWN,), {"m1_neg"}, marks=pytest.mark.full),
        ((UP, LEFT), {"m1_pos", "m2_neg"}),
        pytest.param((DOWN, RIGHT), {"m1_neg", "m2_pos"}, marks=pytest.mark.full),
    ],
)
def test_a_tap_of_the_d_pad_is_one_step_that_way(pad, board, buttons, legs):
    pad.tap(*buttons)
    wait_for_pulses(board, len(legs))
    wait_for_rest(board)
    assert legs_used(board) == legs
    assert sum(len(on_times_us(board, enable)) for enable in ("m1_en", "m2_en")) == len(legs)


@pytest.mark.full
@pytest.mark.parametrize(
    ("x", "y", "legs"),
    [
        (1, 0, {"m2_pos"}),
        (0.9, 0.3, {"m2_pos"}),
        (0.7, -0.7, {"m1_pos", "m2_pos"}),
        (0, -1, {"m1_pos"}),
        (-0.7, -0.7, {"m1_pos", "m2_neg"}),
        (-1, 0, {"m2_neg"}),
        (-0.6, 0.6, {"m1_neg", "m2_neg"}),
        (0.1, 0.8, {"m1_neg"}),
        (0.7, 0.7, {"m1_neg", "m2_pos"}),
    ],
)
def test_a_pushed_stick_runs_that_way_at_the_sliders_speed_until_it_is_back(page, pad, board, x, y, legs):
    page.get_by_role("slider", name="Speed").fill("50")
    pad.stick(x, y)
    enables = {leg[:2] + "_en": 50 * 257 for leg in legs}
    wait_for(lambda: {k: v for k, v in board.enables().items() if v} == enables, "the run")
    pad.stick(0.1, 0.1)
    wait_for_rest(board)
    assert legs_used(board) == legs


def test_a_stick_that_trembles_between_two_directions_keeps_the_first(pad, board, page):
    run_right(pad, board)
    for _ in range(5):
        pad.stick(0.9, -0.44)  # 26°, beyond the half of 45°
        pad.seen()
        pad.stick(0.9, -0.3)
        pad.seen()
    pad.stick(0, 0)
    wait_for_rest(board)
    assert legs_used(board) == {"m2_pos"}
    assert len(on_times_us(board, "m2_en")) == 2


def test_a_stick_that_is_turned_lets_go_of_its_direction_and_presses_no_other_before_it_was_at_rest(pad, board):
    run_right(pad, board)
    for x, y in ((0.7, -0.7), (0, -1)):
        pad.stick(x, y)
        pad.seen()
    wait_for_rest(board)
    pad.says(WAITS)
    pad.stick(0, 0)
    pad.says(DRIVES)
    pad.tap(LEFT)
    wait_for(lambda: "m2_neg" in legs_used(board), "the step of the next push")
    wait_for_rest(board)
    assert legs_used(board) == {"m2_pos", "m2_neg"}


@pytest.mark.full
def test_with_the_right_shoulder_it_is_one_step_and_a_quarter_of_the_speed(page, pad, board):
    page.get_by_role("slider", name="Speed").fill("100")
    page.get_by_label("Steps of a short press").fill("5")
    pad.button(SHOULDER, down=True)
    run_right(pad, board)
    pad.stick(0, 0)
    wait_for_rest(board)
    assert duties(board) == [65535, 0, 25 * 257, 0]


@pytest.mark.parametrize("face", [0, *(pytest.param(at, marks=pytest.mark.full) for at in (1, 2, 3))])
def test_a_face_button_stops_and_the_stick_drives_again_only_from_its_rest(page, pad, board, face):
    run_right(pad, board)
    pad.button(face, down=True)
    wait_for_rest(board)
    page.locator(".news").get_by_text("stopped: STOP was pressed").wait_for()
    pad.says(WAITS)
    pad.button(face, down=False)
    pad.seen()
    assert_only_a_key_drives(page, board)
    pad.stick(0, 0)
    pad.says(DRIVES)
    runs = len(on_times_us(board, "m2_en"))
    pad.stick(1, 0)
    wait_for(lambda: len(on_times_us(board, "m2_en")) > runs, "the step of the next push")
    pad.stick(0, 0)
    wait_for_rest(board)


def test_a_face_button_stops_what_a_click_has_begun(page, pad, board):
    page.get_by_label("Number of steps").fill("20")
    press(page.get_by_text("right ▶"))
    run_until_driving(board)
    pad.tap(1)
    page.get_by_text("last move: aborted (STOP was pressed)").wait_for()


ENDS = {
    "the stick is back": "pad.axes.splice(0, 2, 0, 0)",
    "the gamepad is gone": "pads = []; dispatchEvent(new Event('gamepaddisconnected'))",
    "the gamepad is gone without a word": "pads = [null]",
    "the gamepad says that it is disconnected": "pad.connected = false",
    "the window loses the focus": "dispatchEvent(new Event('blur'))",
    "the page is hidden": (
        "Object.defineProperty(document, 'hidden', { value: true });"
        "document.dispatchEvent(new Event('visibilitychange'))"
    ),
    "frames stall": "window.requestAnimationFrame = () => 0",
    "Escape": "document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'Escape', bubbles: true }))",
}


@pytest.mark.parametrize("how", [how if how != "Escape" else pytest.param(how, marks=pytest.mark.full) for how in ENDS])
def test_a_run_ends_when(page, pad, board, how):
    run_right(pad, board)
    page.evaluate(f"() => {{ {ENDS[how]} }}")
    wait_for_rest(board)
    assert_only_a_key_drives(page, board)


@pytest.mark.parametrize(
    "moved", ["pad.axes[0] = 1", "pad.axes[0] = 0.3", "pad.axes[3] = -1", "pad.buttons[15].pressed = true"]
)
def test_one_that_is_connected_while_not_at_rest_drives_nothing_until_it_was_at_rest(page, board, moved):
    pad = Pad(page)
    page.evaluate(f"() => {{ {moved} }}")
    pad.plug()
    pad.says(WAITS)
    pad.tap(UP)
    assert_only_a_key_drives(page, board)
    page.evaluate("() => { pad.axes.fill(0); pad.buttons[15].pressed = false; }")
    pad.says(DRIVES)
    pad.tap(RIGHT)
    wait_for_pulses(board, 2)
    assert legs_used(board) == {"m1_pos", "m2_pos"}


@pytest.mark.full
def test_one_of_an_unknown_layout_drives_nothing_and_each_of_its_buttons_stops(page, board):
    pad = Pad(page)
    page.evaluate("pad.mapping = ''")
    pad.plug()
    pad.says("it drives nothing")
    pad.stick(1, 0)
    pad.seen()
    pad.stick(0, 0)
    assert_only_a_key_drives(page, board)
    pad.tap(9)
    page.locator(".news").get_by_text("stopped: STOP was pressed").wait_for()
