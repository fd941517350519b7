"""The cards of named positions and of what has moved, and the undo of a Zero, in a real browser."""

import csv
import json
import sqlite3

import pytest
from looks import DESK, PHONE, THEMES, assert_nothing_cut_off, assert_readable, assert_touchable, dress
from playwright.sync_api import expect
from running import Panel, press

from mirrormount.device import motion_log, presets, records
from mirrormount.device.mount import Mount

MARKUP = "<img src=x onerror=alert(1)>"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "data"))


@pytest.fixture
def panel_options() -> list[str]:
    return ["--patience", "2"]  # nothing here is about a page that is out of touch


@pytest.fixture
def kept(board):
    """Some positions and motions of the board, and a Zero of x, from before the panel was started."""
    with Mount.open(str(board.link)) as mount:
        mount.presets.keep("start")
        mount.x.step(2)
        mount.y.step(-1)
        mount.presets.keep("good")
        mount.x.zero()


def button(page, name: str):
    return page.get_by_role("button", name=name, exact=True)


def keep(page, name: str) -> None:
    page.get_by_label("Name of a position").fill(name)
    page.get_by_label("Name of a position").press("Enter")
    page.get_by_text(f"{name} is kept").wait_for()


def test_a_position_is_kept_gone_back_to_and_forgotten(page, board):
    keep(page, "good")
    assert board.edges() == []
    page.get_by_label("Target of x").fill("3")
    page.get_by_label("Target of x").press("Enter")
    page.get_by_text("+3.000").wait_for()
    press(button(page, "Back to good"))
    page.locator(".news").get_by_text("back at good, by steps").wait_for()
    assert page.locator(".position").first.inner_text() == "+0.000"
    assert page.locator("svg.map .map-name").all_text_contents() == ["good"]
    button(page, "Remove good").click()
    button(page, "Cancel").click()
    button(page, "Forget it").wait_for(state="hidden")
    button(page, "Remove good").click()
    button(page, "Forget it").click()
    page.get_by_text("No position of this board is kept.").wait_for()
    assert page.locator("svg.map .map-name").count() == 0


def test_doubts_are_asked_first_and_the_zero_is_undone(kept, page, board):
    before = len(board.edges())
    press(button(page, "Back to good"))
    page.get_by_text("x: its 0 was set since (Zero)").wait_for()
    stop = page.locator("[data-stop]").bounding_box()
    assert page.evaluate(
        "([x, y]) => !!document.elementFromPoint(x, y).closest('[data-stop]')", [stop["x"] + 9, stop["y"] + 9]
    )
    button(page, "Cancel").click()
    expect(page.get_by_label("Undo Zero of y")).to_be_hidden()
    button(page, "Undo Zero of x").click()
    page.get_by_text("x: the position here is +2 steps as before Zero").wait_for()
    expect(page.get_by_label("Undo Zero of x")).to_be_hidden()
    assert len(board.edges()) == before
    press(button(page, "Back to start"))
    page.get_by_text("Go all the same").or_(
        page.locator(".news").get_by_text("back at start, by steps")
    ).first.wait_for()


def test_go_all_the_same_goes(kept, page, board):
    press(button(page, "Back to good"))
    press(button(page, "Go all the same"))
    page.locator(".news").get_by_text("back at good, by steps").wait_for()
    expect(page.locator(".position").first).to_have_text("+2.000")


def test_a_name_is_text_whatever_is_in_it(kept, page):
    with sqlite3.connect(records.path(presets.FILE)) as file:
        file.execute("update positions set name = ? where name = 'good'", (MARKUP,))
    file.close()
    page.locator(".place-name", has_text=MARKUP).wait_for()
    assert MARKUP in page.locator("svg.map .map-name").all_text_contents()
    assert page.locator("img[src=x]").count() == 0
    sent = page.locator("[data-send]").evaluate_all("(all) => all.map((one) => one.dataset.send)")
    assert MARKUP in [json.loads(text).get("name") for text in sent]


def test_what_has_moved_is_listed_newest_first_and_saved_as_mirrormount_log_does(kept, page):
    page.get_by_text("Which motions, by whom").click()
    rows = page.locator(".moved .notice")
    expect(rows.first).to_contain_text("x: +2.000 to +0.000 steps, set, not moved (counted)")
    expect(rows.last).to_contain_text("x: +0.000 to +2.000 steps, done")
    press(button(page, "RIGHT"))
    expect(rows.first).to_contain_text("x: +0.000 to +1.000 steps, done")
    expect(rows.first).to_contain_text("by page 1 (127.0.0.1), ")
    with page.expect_download() as download:
        button(page, "Save as a file").click()
    assert download.value.suggested_filename == "mirrormount-motions.csv"
    table = list(csv.reader(download.value.path().read_text().splitlines()))
    assert table[0] == list(motion_log.COLUMNS) and [row[4] for row in table[1:]] == ["x", "y", "x", "x"]


@pytest.mark.full
@pytest.mark.parametrize("viewport", [PHONE, DESK])
@pytest.mark.parametrize("colors", THEMES)
def test_the_cards_can_be_read_and_touched(kept, open_page, panel, viewport, colors):
    page = open_page(panel.url, viewport=viewport)
    dress(page, colors)
    page.get_by_text("Which motions, by whom").click()
    page.locator(".moved .notice").first.wait_for()
    assert_readable(page, "good", "start", "−1", "set, not moved")
    assert_touchable(page)
    assert_nothing_cut_off(page)
    press(button(page, "Back to good"))
    page.get_by_text("It may be another place now").wait_for()
    assert_readable(page, "Go all the same", "x: its 0 was set since")
    assert_touchable(page)


@pytest.mark.full
def test_an_answer_in_a_dialog_is_of_its_own_mount(open_page, tmp_path):
    panel = Panel("--virtual", tmp_path, "--mounts", "2", "--patience", "2")
    try:
        page = open_page(panel.url)
        second = page.locator("#mount-2")
        second.get_by_label("Name of a position").fill("good")
        second.get_by_label("Name of a position").press("Enter")
        page.get_by_text("good is kept").wait_for()
        press(second.get_by_role("button", name="RIGHT", exact=True))
        second.locator(".position").first.get_by_text("+1.000").wait_for()
        press(second.get_by_role("button", name="Zero", exact=True).first)
        second.get_by_text("counted", exact=True).wait_for()
        press(second.get_by_role("button", name="RIGHT", exact=True))
        second.locator(".position").first.get_by_text("+1.000").wait_for()
        press(button(second, "Back to good"))
        press(button(page, "Go all the same"))
        second.locator(".news").get_by_text("back at good, by steps").wait_for()
        assert page.locator("#mount-1 .news").get_by_text("back at").count() == 0
    finally:
        panel.kill()
