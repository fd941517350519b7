"""The page of a loop in a browser: what is read, touched and heard while it holds, waits, needs help and is stopped."""

import re

import pytest
from looks import DESK, PHONE, THEMES, assert_nothing_cut_off, assert_readable, assert_touchable, dress
from playwright.sync_api import expect
from served import wait_for
from test_hold_page import SPOT, far_camera, gate
from test_night import RED, brightest
from test_spot_moves import served

from mirrormount_beam.control import events
from mirrormount_panel.auth import SignIn
from mirrormount_panel.hold_page import HoldBoard, make_hold_server

pytestmark = pytest.mark.wall_clock  # a page that hears nothing for 3 s is in alarm by design

TONES = """() => {
  window.tones = [];
  const start = OscillatorNode.prototype.start;
  OscillatorNode.prototype.start = function (...when) {
    window.tones.push([this.frequency.value, this.context.state]);
    return start.apply(this, when);
  };
}"""
READ_FROM_3_M_PX = 48  # its capitals are 9 mm high on a common screen (96 px an inch): 10 minutes of arc


@pytest.fixture
def loop():
    """The page of a loop that a test tells events of: (address, board, what was asked)."""
    asked, board = [], HoldBoard({"far": (50.0, 50.0)}, clock=lambda: 0.0)
    for time_s in range(5):
        board.listen(events.Observed(float(time_s), (SPOT,), (3.0, -4.0), ((30.0, 40.0),)))
    board.listen(events.StateChanged(5.0, events.HOLDING, "the error is within the dead band"))

    def stop() -> None:
        asked.append("stop")
        board.listen(events.StateChanged(9.0, events.STOPPED, "STOP was pressed"))

    server = make_hold_server([far_camera()[0]], board, SignIn(None), go=lambda: asked.append("go"), stop=stop)
    with served(server.config.app) as at:
        yield f"http://{at}/", board, asked


def assert_looks(page, *texts: str) -> None:
    for viewport in (PHONE, DESK):
        page.set_viewport_size(viewport)
        assert_touchable(page)
        assert_nothing_cut_off(page)
        state = page.locator(".hold-state")
        assert float(state.evaluate("(e) => parseFloat(getComputedStyle(e).fontSize)")) >= READ_FROM_3_M_PX
        assert state.bounding_box()["y"] < viewport["height"] / 3  # in sight without scrolling
        for colors in THEMES:
            dress(page, colors)
            assert_readable(page, *texts)


def test_each_state_can_be_read_from_afar_and_stop_is_asked_for(open_page, loop):
    url, board, asked = loop
    page = open_page(url, until="body.ready", reduced_motion="reduce")
    state = page.locator(".hold-state")
    expect(state).to_have_text("Holding")
    assert_looks(page, "The error is within the dead band", "error x 12.0")
    board.listen(gate(clears_itself=True))
    board.listen(events.StateChanged(6.0, events.WAITING, "a gate is closed"))
    expect(state).to_have_text("Waiting: no spot")
    assert_looks(page, "Far: dark. It clears itself. Switch the laser on")
    board.listen(gate(2, clears_itself=False))
    expect(state).to_have_text("Alarm: no spot")
    expect(page.locator("body")).to_have_class(re.compile(r"\balarm\b"))
    assert_looks(page, "Far: dark. Switch the laser on")
    page.locator("[data-stop]").click()
    expect(state).to_have_text("Stopped")
    assert_looks(page, "STOP was pressed")
    assert asked == ["stop"]


def test_space_is_stop_also_on_hold_which_was_clicked_before(open_page, loop):
    url, board, asked = loop
    page = open_page(url, until="body.ready")
    board.listen(gate(clears_itself=False))
    board.listen(events.StateChanged(6.0, events.WAITING, "a gate is closed"))
    expect(page.locator(".hold-state")).to_have_text("Alarm: no spot")
    page.locator("[data-go]").click()
    page.keyboard.press(" ")
    expect(page.locator(".hold-state")).to_have_text("Stopped")
    assert asked == ["go", "stop"]


@pytest.mark.parametrize("key", ["Escape", " "])
def test_a_key_that_is_down_for_long_stops_once(open_page, loop, key):
    url, _, asked = loop
    page = open_page(url, until="body.ready")
    page.evaluate("window.kept = []; addEventListener('keydown', (event) => kept.push(event.defaultPrevented))")
    for _ in range(5):
        page.keyboard.down(key)  # the second one and those after it are told as repetitions
    page.keyboard.up(key)
    assert page.evaluate("kept") == [True] * 5
    expect(page.locator(".hold-state")).to_have_text("Stopped")
    page.locator("[data-go]").click()
    wait_for(lambda: "go" in asked, "what comes after it")
    assert asked == ["stop", "go"]


def test_a_run_that_ended_well_is_no_alarm_when_its_program_has_gone_too(open_page, loop):
    url, board, _ = loop
    page = open_page(url, until="body.ready")
    board.listen(events.StateChanged(9.0, events.ENDED, "60 s are over"))
    expect(page.locator(".hold-state")).to_have_text("Ended")
    expect(page.locator("[data-go]")).to_be_enabled()
    page.route("**/hold/state*", lambda route: route.abort())
    expect(page.locator("[data-go]")).to_be_disabled()
    expect(page.locator(".hold-state")).to_have_text("Ended")
    assert not page.locator("body.alarm").count()


def test_at_night_a_picture_that_is_old_has_no_green_and_no_blue_either(open_page, loop):
    page = open_page(loop[0], until="body.ready", reduced_motion="reduce")
    expect(page.locator(".camera")).to_have_class(re.compile(r"\bold\b"))
    page.wait_for_function("document.querySelector('canvas.picture').width !== 300")  # drawn: it has its own size
    page.wait_for_function("document.querySelector('svg.filters')")
    dress(page, "night")
    assert brightest(page.screenshot()) == RED


def test_a_cause_is_told_once_and_with_the_symbols_of_units(open_page, loop):
    url, board, _ = loop
    page = open_page(url, until="body.ready")
    board.listen(events.InterlockTripped(5.0, 3, "spot jumped", "far: 900 um off", "look at what was moved", False))
    board.listen(events.StateChanged(6.0, events.WAITING, "far: 900 um off"))
    expect(page.locator(".hold-gates")).to_have_text("Far: 900 µm off. Look at what was moved")
    expect(page.locator(".hold-why")).to_have_text("")


def test_an_alarm_is_heard_once_its_user_has_touched_the_page(open_page, loop):
    url, board, _ = loop
    page = open_page(url, until="body.ready")
    page.evaluate(TONES)
    expect(page.locator(".hold-state")).to_have_text("Holding")
    page.get_by_role("button", name="Sound: press to switch on").click()
    expect(page.locator("[data-quiet]")).to_have_text("Sound is on")
    assert page.evaluate("window.tones") == []
    board.listen(gate(clears_itself=False))
    page.wait_for_function("window.tones.length >= 6")  # three tones, and again
    assert page.evaluate("window.tones.slice(0, 3)") == [[880, "running"], [660, "running"], [880, "running"]]
    page.locator("[data-quiet]").click()
    expect(page.locator("[data-quiet]")).to_have_text("Sound is off")
