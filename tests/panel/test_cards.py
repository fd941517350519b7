"""What the panel shows and changes beside driving: settings, errors, lamps, wire, screen, looks."""

import re

import pytest
from playwright.sync_api import expect
from running import Panel, press
from served import wait_for

from mirrormount.device.mount import Mount
from mirrormount.device.settings import ENCODER, SETTINGS


@pytest.fixture
def panel_options() -> list[str]:
    return ["--patience", "2"]  # nothing here is about a page that is out of touch


DRAWN = """() => {
  const canvas = document.querySelector("canvas[data-screen]");
  return canvas?.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some((value) => value);
}"""


def open_settings(page) -> None:
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    page.get_by_label("x: length of a step's pulse, us").wait_for()
    wait_for_value(page, "x: length of a step's pulse, us", "200000")


def wait_for_value(page, label: str, value: str) -> None:
    page.wait_for_function(
        '([label, value]) => document.querySelector(`[aria-label="${label}"]`)?.value === value', arg=[label, value]
    )


class HeldMessages:
    """Between page and panel: keeps back all that the panel says from the first message with some words on."""

    def __init__(self, words: str) -> None:
        self._words = words
        self.held: list[str | bytes] = []
        self._free = False

    def before(self, page) -> None:
        page.route_web_socket(re.compile("socket.io"), self._route)

    def _route(self, to_page) -> None:
        self._to_page = to_page
        to_page.connect_to_server().on_message(self._pass_on)

    def _pass_on(self, message: str | bytes) -> None:
        if not self._free and (self.held or self._words in str(message)):
            self.held.append(message)
        else:
            self._to_page.send(message)

    def release(self) -> None:
        self._free = True
        for message in self.held:
            self._to_page.send(message)


@pytest.mark.full
def test_fields_take_nothing_before_the_boards_settings_are_shown_whole(open_page, panel):
    wire = HeldMessages("updateValue")
    page = open_page(panel.url, before=wire.before)
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    wait_for_value(page, "x: length of a step's pulse, us", "200000")
    field = page.get_by_label("x: length of a step's pulse, us")
    expect(field).to_be_disabled()
    wire.release()
    field.fill("50000")
    page.get_by_role("button", name="Apply").click()
    expect(page.locator(".q-notifications")).to_contain_text("applied")
    expect(field).to_have_value("50000")


def on_times_us(board, enable: str) -> list[int]:
    edges = [e for e in board.edges() if e["pin"] == enable]
    return [off["t_us"] - on["t_us"] for on, off in zip(edges[::2], edges[1::2], strict=True)]


@pytest.mark.full
def test_a_pulse_that_is_set_is_the_pulse_that_is_made(page, board):
    open_settings(page)
    page.get_by_label("x: length of a step's pulse, us").fill("50000")
    page.get_by_role("button", name="Apply").click()
    page.get_by_text("applied", exact=True).wait_for()
    press(page.get_by_role("button", name="RIGHT", exact=True))
    page.get_by_text("+1.000").wait_for()
    assert on_times_us(board, "m2_en") == [pytest.approx(50_000, abs=50)]


@pytest.mark.full
@pytest.mark.parametrize(
    ("label", "typed", "told"),
    [
        ("x: length of a step's pulse, us", "199", "x.pulse_us is within 200"),
        ("y: duty of a run, 1 … 255", "full", "a number, not 'full'"),
        ("y: steps per second", "1.234", "at most 2 decimals"),
    ],
)
def test_a_setting_that_cannot_be_is_told_and_none_is_changed(page, panel, board, label, typed, told):
    open_settings(page)
    page.get_by_label("x: drive that takes up the backlash, us; 0: off").fill("1000")
    page.get_by_label(label).fill(typed)
    page.get_by_role("button", name="Apply").click()
    page.get_by_text(told).wait_for()
    panel.end()
    with Mount.open(str(board.link)) as mount:
        assert mount.settings()["x"]["take_up_us"] == 0


@pytest.mark.full
def test_the_card_has_a_field_for_every_setting_of_both_axes(page):
    open_settings(page)
    for axis in ("x", "y"):
        for name, setting in SETTINGS.items():
            field = page.get_by_label(f"{axis}: {setting.what}", exact=True)
            assert (field.input_value() != "") == field.is_visible() == (name not in ENCODER)  # there is none


def change_direction(page) -> str:
    """Apply and save another direction of x. Returns the label of the setting."""
    open_settings(page)
    label = f"x: {SETTINGS['inverted'].what}"
    page.get_by_label(label).fill("1")
    page.get_by_role("button", name="Apply").click()
    page.get_by_text("applied", exact=True).wait_for()
    return label


@pytest.mark.full
def test_factory_asks_first_and_cancel_changes_nothing(page, panel, board):
    label = change_direction(page)
    page.get_by_role("button", name="Factory").click()
    page.get_by_text("Replace all settings by the factory's?").wait_for()
    assert stop_is_on_top(page)
    page.get_by_role("button", name="Cancel").click()
    page.get_by_text("Replace all settings by the factory's?").wait_for(state="hidden")
    assert page.get_by_label(label).input_value() == "1"
    panel.end()
    with Mount.open(str(board.link)) as mount:
        assert mount.settings()["x"]["inverted"] == 1


@pytest.mark.full
def test_factory_can_be_undone_after_the_panel_was_started_anew_and_undone_again(
    open_page, page, panel, board, tmp_path
):
    label = change_direction(page)
    page.get_by_role("button", name="Factory").click()
    page.get_by_role("button", name="Replace them").click()
    wait_for_value(page, label, "0")
    panel.end()
    panel = Panel(str(board.link), tmp_path, "--patience", "2")
    page = open_page(panel.url)
    open_settings(page)
    page.get_by_text("Before the last change: x.inverted = 1").wait_for()
    page.get_by_role("button", name="Undo the last change").click()
    page.get_by_text("put back: x.inverted = 1").wait_for()
    wait_for_value(page, label, "1")
    page.get_by_text("Before the last change: x.inverted = 0").wait_for()
    panel.end()
    with Mount.open(str(board.link)) as mount:
        assert mount.settings()["x"]["inverted"] == 1


def test_saved_settings_come_back_and_others_do_not(page):
    open_settings(page)
    label = "y: drive that takes up the backlash, us; 0: off"
    page.get_by_label(label).fill("3000")
    page.get_by_role("button", name="Save on the board").click()
    page.get_by_text("saved on the board").wait_for()
    page.get_by_label(label).fill("4000")
    page.get_by_role("button", name="Apply").click()
    page.get_by_text("applied", exact=True).last.wait_for()
    wait_for_value(page, label, "4000")
    page.get_by_role("button", name="Restore saved").click()
    wait_for_value(page, label, "3000")
    page.get_by_role("button", name="Factory").click()
    page.get_by_role("button", name="Replace them").click()
    wait_for_value(page, label, "0")


@pytest.mark.full
def test_a_move_beyond_a_soft_limit_is_refused_with_its_reason(page, board):
    open_settings(page)
    page.get_by_label("x: positive soft limit, steps").fill("3")
    page.get_by_label("x: 1 ignores end-stops + 8 checks soft limits").fill("8")
    page.get_by_role("button", name="Apply").click()
    page.get_by_text("applied", exact=True).wait_for()
    page.get_by_label("Target of x").fill("4")
    page.get_by_label("Target of x").press("Enter")
    page.get_by_text("the board says 206: ").first.wait_for()
    assert board.edges() == []


def test_an_error_in_a_motion_is_listed_with_cause_and_remedy(page, board):
    open_settings(page)
    page.get_by_label("y: longest run, ms").fill("100")
    page.get_by_role("button", name="Apply").click()
    page.get_by_text("applied", exact=True).wait_for()
    page.get_by_label("Speed of Y").fill("255")
    press(page.get_by_role("button", name="OK", exact=True).first)
    page.get_by_text("the board says 140: ").first.wait_for()
    page.get_by_text("Cause: One run or one frame drove for as long as XM allows.").wait_for()
    page.get_by_text("Remedy: Send the next one in time, or raise XM.").wait_for()
    page.get_by_text("last move: run limit reached").wait_for()


@pytest.mark.full
def test_certainty_is_unknown_first_then_counted_and_estimated_after_a_run(page):
    page.get_by_text("position unknown").nth(1).wait_for()
    press(page.get_by_role("button", name="Zero").first)
    page.get_by_text("counted").wait_for()
    page.keyboard.down("ArrowRight")
    page.get_by_text("estimated").wait_for()
    page.keyboard.up("ArrowRight")


@pytest.mark.full
def test_the_wire_log_shows_both_directions_without_the_polls(page):
    page.get_by_text("What goes over the wire").click()
    page.keyboard.press("ArrowUp")
    log = page.locator(".wire")
    log.get_by_text(re.compile("→ .*1PR1")).wait_for()
    assert "XS?" not in log.inner_text()


def test_a_virtual_board_shows_its_spot_and_follows_it(open_page, tmp_path):
    panel = Panel("virtual://", tmp_path, "--patience", "2")
    try:
        page = open_page(panel.url)
        screen = page.locator("canvas[data-screen]")
        page.wait_for_function(DRAWN)
        before = screen.screenshot()

        def follows() -> bool:
            page.keyboard.press("ArrowRight")  # again: where a busy computer lets the page stand still, one is refused
            return screen.screenshot() != before

        wait_for(follows, "another picture")
    finally:
        panel.kill()


@pytest.mark.full
@pytest.mark.parametrize("width", [390, 1600])
@pytest.mark.parametrize("colors", ["light", "dark"])
def test_nothing_is_cut_off_at_the_side_and_stop_is_in_sight(open_page, panel, width, colors):
    page = open_page(panel.url, viewport={"width": width, "height": 844}, color_scheme=colors)
    open_settings(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for where in ("0", "document.body.scrollHeight"):
        page.evaluate(f"window.scrollTo(0, {where})")
        box = page.get_by_role("button", name="STOP").bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= width
        assert box["y"] >= 0 and box["y"] + box["height"] <= 844


@pytest.mark.full
def test_every_control_can_be_reached_with_the_tab_key(page):
    everything = page.locator("button:visible, input:visible").count()
    reached = set()
    for _ in range(3 * everything):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.outerHTML"))
    named = {"data-stop", 'data-press="x:1"', 'name="speed"', 'name="speed_x"', 'name="target_y"', 'name="steps"'}
    assert {name for name in named if not any(name in html for html in reached)} == set()


@pytest.mark.full
@pytest.mark.parametrize("width", [390, 1600])
def test_a_refusal_is_in_sight_and_nothing_covers_stop(open_page, panel, width):
    page = open_page(panel.url, viewport={"width": width, "height": 844})
    page.get_by_label("Speed of Y").fill("256")
    press(page.get_by_role("button", name="OK", exact=True).first)
    # It slides in: Vue marks it from before it is in the page until it is in its place.
    told = page.locator(".q-notification:not([class*='-enter-'])", has_text="nothing was done: the speed of Y")
    told.wait_for()
    box, stop = told.bounding_box(), page.locator("[data-stop]").bounding_box()
    assert box["y"] >= 0 and box["y"] + box["height"] <= stop["y"]
    assert box["x"] >= 0 and box["x"] + box["width"] <= width
    assert stop_is_on_top(page)


def stop_is_on_top(page) -> bool:
    return page.evaluate(
        """() => {
            const stop = document.querySelector("[data-stop]"), box = stop.getBoundingClientRect();
            return stop.contains(document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2));
        }"""
    )


@pytest.mark.full
def test_stop_is_on_top_of_the_dialog_with_the_link(open_page, board, tmp_path):
    panel = Panel(str(board.link), tmp_path, "--host", "0.0.0.0")
    try:
        page = open_page(panel.url, viewport={"width": 390, "height": 844})
        page.get_by_role("button", name="Open on a phone").click()
        page.get_by_text("Whoever has this link").wait_for()
        assert stop_is_on_top(page)
        page.locator("[data-stop]").click()
    finally:
        panel.kill()


@pytest.mark.full
def test_a_setting_that_another_page_has_changed_is_not_undone(open_page, page, panel):
    other = open_page(panel.url)
    open_settings(page)
    open_settings(other)
    page.get_by_label("x: drive that takes up the backlash, us; 0: off").fill("1000")
    page.get_by_role("button", name="Apply").click()
    page.get_by_text("applied", exact=True).wait_for()
    press(other.get_by_role("button", name="Take control"))
    other.get_by_text("you control").wait_for()
    other.get_by_label("y: drive that takes up the backlash, us; 0: off").fill("2000")
    other.get_by_role("button", name="Apply").click()
    wait_for_value(other, "y: drive that takes up the backlash, us; 0: off", "2000")
    wait_for_value(other, "x: drive that takes up the backlash, us; 0: off", "1000")
