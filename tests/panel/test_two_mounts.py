"""The panel on a table of two mounts, in a browser: each part drives its own mount, and STOP stops both."""

import pytest
from looks import DESK, PHONE, THEMES, assert_nothing_cut_off, assert_readable, assert_touchable, dress
from playwright.sync_api import expect
from running import NotStarted, Panel, press, wait_for_rest
from served import ServedBoard, wait_for
from test_driving import FRESH
from test_gamepad import DRIVES, MADE, RIGHT, Pad

NAMES = ("first", "second")


@pytest.fixture
def boards(tmp_path):
    """Two boards by name, which a test may end and start again."""
    served = {name: ServedBoard(tmp_path / name) for name in NAMES}
    yield served
    for board in served.values():
        board.__exit__()


@pytest.fixture
def table(tmp_path):
    """A table.toml with both."""
    file = tmp_path / "table.toml"
    file.write_text("".join(f'[mounts.{name}]\nport = "{tmp_path / name / "mount"}"\n' for name in NAMES))
    return file


@pytest.fixture
def panel(boards, table, tmp_path):
    panel = Panel(f"--table={table}", tmp_path, "--patience", "2")
    yield panel
    panel.kill()


def unplug(board):
    board.end()
    board.__exit__()


def part(page, name):
    return page.locator(f'[data-mount="{name}"]')


def axis(page, name, title):
    return part(page, name).locator("section", has_text=title).locator(".position")


def run(page, name):
    """Both motors of one mount, until somebody stops them."""
    for word in "XY":
        part(page, name).get_by_label(f"Speed of {word}").fill("200")
    press(part(page, name).get_by_role("button", name="OK", exact=True))


def test_each_part_drives_its_own_mount_and_arrow_keys_the_one_that_was_touched_last(page, boards):
    page.keyboard.press("ArrowRight")  # no mount was touched: none is driven
    press(part(page, "second").get_by_label("UP", exact=True))
    expect(axis(page, "second", "Y · up and down")).to_have_text("+1.000")
    page.keyboard.press("ArrowRight")
    expect(axis(page, "second", "X · right and left")).to_have_text("+1.000")
    part(page, "first").get_by_label("Number of steps").fill("2")
    press(part(page, "first").get_by_text("◀ left"))
    expect(axis(page, "first", "X · right and left")).to_have_text("−2.000")
    assert {edge["pin"][:2] for edge in boards["first"].edges() if edge.get("duty")} == {"m2"}
    expect(axis(page, "first", "Y · up and down")).to_have_text("+0.000")
    expect(axis(page, "second", "X · right and left")).to_have_text("+1.000")


def test_a_gamepad_drives_the_one_that_was_touched_last_and_before_a_touch_none(open_page, panel, boards):
    page = open_page(panel.url, before=lambda page: page.add_init_script(MADE))
    pad = Pad(page)
    pad.plug()
    pad.says(DRIVES)
    pad.tap(RIGHT)
    pad.says(DRIVES)
    press(part(page, "second").get_by_label("UP", exact=True))
    expect(axis(page, "second", "Y · up and down")).to_have_text("+1.000")
    pad.tap(RIGHT)
    expect(axis(page, "second", "X · right and left")).to_have_text("+1.000")
    assert boards["first"].edges() == []


@pytest.mark.full
def test_each_mount_has_its_own_remembered_fields(open_page, panel):
    page = open_page(panel.url, **FRESH)
    for name, step in (("first", "7"), ("second", "9")):
        part(page, name).get_by_label("Steps of a short press").fill(step)
    page.reload()
    page.wait_for_selector("body.steady")
    for name, step in (("first", "7"), ("second", "9")):
        expect(part(page, name).get_by_label("Steps of a short press")).to_have_value(step)


@pytest.mark.parametrize("how", ["button", "key"])
def test_stop_stops_both(page, boards, how):
    for name, board in boards.items():
        run(page, name)
        wait_for(board.driving, f"{name} to run")
    page.keyboard.press("Escape") if how == "key" else page.get_by_role("button", name="STOP").click()
    for name, board in boards.items():
        wait_for_rest(board)
        expect(part(page, name).locator(".news:not(.moved)")).to_contain_text("stopped: STOP was pressed")


@pytest.mark.full
def test_one_is_unplugged_while_the_other_works_and_is_back_when_it_is_plugged_in(page, boards, tmp_path):
    expect(axis(page, "first", "X · right and left")).to_have_text("+0.000")
    unplug(boards["first"])
    expect(part(page, "first").locator(".trouble")).to_contain_text("No board:")
    expect(part(page, "second").locator(".trouble")).to_be_hidden()
    press(part(page, "second").get_by_label("RIGHT", exact=True))  # which has moved: the first has another line
    expect(axis(page, "second", "X · right and left")).to_have_text("+1.000")
    boards["first"] = ServedBoard(tmp_path / "first")
    expect(part(page, "first").locator(".trouble")).to_be_hidden()
    expect(part(page, "first").locator(".news:not(.moved)")).to_contain_text("nothing moves until you ask for it")
    press(part(page, "first").get_by_label("RIGHT", exact=True))
    expect(axis(page, "first", "X · right and left")).to_have_text("+1.000")


@pytest.mark.full
def test_both_can_be_read_and_touched_and_nothing_is_cut_off(page, boards):
    expect(axis(page, "second", "Y · up and down")).to_have_text("+0.000")
    press(part(page, "second").get_by_label("UP", exact=True))
    for viewport in (PHONE, {"width": 1300, "height": 900}, DESK):
        page.set_viewport_size(viewport)
        assert_touchable(page)
        assert_nothing_cut_off(page)
        for colors in THEMES:
            dress(page, colors)
            assert_readable(page, "first", "second", "arrow keys", "STOP ALL", "Go to")


@pytest.mark.full
def test_the_way_to_a_mount_leads_to_it_on_a_phone(page):
    page.set_viewport_size(PHONE)
    page.get_by_role("link", name="second").click()
    expect(part(page, "second").get_by_label("UP", exact=True)).to_be_in_viewport()


@pytest.mark.full
def test_one_that_is_not_there_is_told_and_looked_for(boards, table, tmp_path, open_page):
    unplug(boards["first"])
    panel = Panel(f"--table={table}", tmp_path, "--patience", "2")
    try:
        assert any(line == "first: not there yet" for line in panel.said)
        page = open_page(panel.url)
        expect(part(page, "first").locator(".trouble")).to_contain_text("No board:")
        boards["first"] = ServedBoard(tmp_path / "first")
        expect(part(page, "first").locator(".trouble")).to_be_hidden()
        told = panel.end()
    finally:
        panel.kill()
    assert told.startswith("mirrormount: warning: first: ") and told.count("\n") == 1


def test_a_table_without_any_of_its_mounts_is_one_line(table, tmp_path):
    with pytest.raises(NotStarted, match="no mount of the table is there: first, second"):
        Panel(f"--table={table}", tmp_path)


def test_a_click_on_a_picture_needs_one_mount(table, tmp_path):
    with pytest.raises(NotStarted, match=r"name it \(mirrormount panel NAME\): first, second"):
        Panel(f"--table={table}", tmp_path, "--camera", "0")
