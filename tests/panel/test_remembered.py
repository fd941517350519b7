"""What a browser remembers of its fields, and units: what is shown in them, and what happens when a scale is gone."""

import pytest
from playwright.sync_api import expect
from running import Panel, press, wait_for_rest

from mirrormount.device import calibration

FRESH = {"viewport": {"width": 1600, "height": 1000}}  # a browser of its own, that remembers nothing
BOARD = "e6616408432f5a21"
STEP = calibration.Step(200_000, 255, 0)


@pytest.fixture
def panel(board, tmp_path, monkeypatch):
    """X has a whole scale, Y has none."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    calibration.write(BOARD, {2: calibration.Scale(0.2, 0.3, STEP, 2.0, 1500.0)})
    panel = Panel(str(board.link), tmp_path, "--patience", "2")
    yield panel
    panel.kill()


def memory_of(name: str) -> str:
    """Where the browser keeps what the field of that name has."""
    return f"mirrormount-{name} {BOARD}"


def again(page) -> None:
    page.reload()
    page.wait_for_selector("body.steady")


def axis(page, title: str):
    return page.locator("section", has_text=title)


def told(page):
    return page.locator("[data-lost]:not(:empty)")


def test_speed_step_units_and_amounts_are_there_when_the_page_is_loaded_again(open_page, panel):
    page = open_page(panel.url, **FRESH)
    page.get_by_role("slider", name="Speed").fill("33")
    page.get_by_label("Steps of a short press").fill("7")
    page.get_by_label("Number of steps").fill("0.25")
    page.get_by_label("Unit of fine steps").select_option("mm")
    page.get_by_label("Unit for x").select_option("beam-urad")
    page.get_by_label("Target of x").fill("5")
    again(page)
    expect(page.get_by_role("slider", name="Speed")).to_have_value("33")
    expect(page.locator('[data-shows="speed"]')).to_have_text("33")
    expect(page.get_by_label("Steps of a short press")).to_have_value("7")
    expect(page.get_by_label("Number of steps")).to_have_value("0.25")
    expect(page.get_by_label("Unit of fine steps")).to_have_value("mm")
    expect(page.get_by_label("Unit for x")).to_have_value("beam-urad")
    expect(page.get_by_label("Target of x")).to_have_value("0")  # a target is of one move
    expect(told(page)).to_have_count(0)


def test_what_was_remembered_with_one_board_is_none_of_another_at_the_same_address(open_page, panel):
    def of_another(route) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, body=answer.text().replace(BOARD, "e6616408432f5a22"))

    page = open_page(panel.url, **FRESH)
    page.get_by_label("Steps of a short press").fill("100")
    page.route(panel.url, of_another)
    page.reload()
    page.wait_for_selector("body.cut")  # its fields are filled: Chromium connects a page that a test changed to nothing
    expect(page.get_by_label("Steps of a short press")).to_have_value("1")
    page.unroute(panel.url)
    again(page)
    expect(page.get_by_label("Steps of a short press")).to_have_value("100")


@pytest.mark.full
def test_what_was_remembered_is_what_is_sent(open_page, panel, board):
    page = open_page(panel.url, **FRESH)
    page.get_by_label("Number of steps").fill("2")
    page.get_by_label("Steps of a short press").fill("3")
    again(page)
    press(page.get_by_text("right ▶"))
    expect(axis(page, "X ·").locator(".position")).to_have_text("+2.000")
    press(page.get_by_role("button", name="RIGHT", exact=True))
    expect(axis(page, "X ·").locator(".position")).to_have_text("+5.000")
    wait_for_rest(board)


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "kept", "shown"),
    [("speed", "999", "80"), ("speed", "fast", "80"), ("unit_x", "inch", "steps"), ("unit_x", "", "steps")],
)
def test_what_a_field_cannot_have_is_not_remembered(open_page, panel, name, kept, shown):
    page = open_page(panel.url, **FRESH)
    page.evaluate("([name, kept]) => localStorage.setItem(name, kept)", [memory_of(name), kept])
    again(page)
    expect(page.locator(f"[name={name}]")).to_have_value(shown)


def test_a_position_is_shown_first_in_the_unit_that_was_chosen(open_page, panel):
    page = open_page(panel.url, **FRESH)
    x, y = axis(page, "X ·"), axis(page, "Y ·")
    press(page.get_by_role("button", name="UP AND RIGHT"))
    for unit, shown, name in (
        ("mrad", "≈ +0.25", "mrad of the mirror"),
        ("urad", "≈ +250", "µrad of the mirror"),
        ("beam-mrad", "≈ +0.50", "mrad of the beam"),
        ("um", "≈ +750", "µm on the screen"),
        ("mm", "≈ +0.75", "mm on the screen"),
    ):
        x.get_by_label("Unit for x").select_option(unit)
        expect(x.locator(".position")).to_have_text(shown)
        expect(x.locator(".unit")).to_have_text(name)
        expect(x.locator(".mrad")).to_contain_text("+1.000 steps")
    expect(y.locator(".position")).to_have_text("+1.000")
    expect(y.locator(".unit")).to_have_text("steps")
    again(page)
    expect(x.locator(".position")).to_have_text("≈ +0.75")
    x.get_by_label("Unit for x").select_option("steps")
    expect(x.locator(".position")).to_have_text("+1.000")
    expect(x.locator(".mrad")).to_contain_text("≈ +0.25 mrad, +0.75 mm")


def test_a_remembered_unit_that_has_no_scale_is_told_and_no_amount_is_left_for_it(open_page, panel, board):
    page = open_page(panel.url, **FRESH)
    page.evaluate("(name) => localStorage.setItem(name, 'urad')", memory_of("unit_y"))
    again(page)
    y = axis(page, "Y ·")
    expect(y.get_by_label("Unit for y")).to_have_value("steps")
    expect(told(page)).to_have_text(
        "There is no scale for µrad of the mirror now (mirrormount setup measures it): type the amount in steps."
    )
    expect(y.get_by_label("Target of y")).to_have_value("")
    y.get_by_label("Target of y").press("Enter")
    page.get_by_text("the target of y: type a number").wait_for()
    assert board.edges() == []
    y.get_by_label("Target of y").fill("1")
    expect(told(page)).to_have_count(0)
    kept = page.evaluate("(name) => localStorage.getItem(name)", memory_of("unit_y"))
    assert kept == "urad"  # for when it has one


def test_a_unit_that_loses_its_scale_while_it_is_chosen_is_told(open_page, panel):
    page = open_page(panel.url, **FRESH)
    x = axis(page, "X ·")
    x.get_by_label("Unit for x").select_option("mm")
    x.get_by_label("Target of x").fill("3")
    expect(x.locator(".position")).to_have_text("≈ +0.00")
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    field = page.get_by_label("x: length of a step's pulse, us")
    expect(field).to_have_value("200000")
    field.fill("50000")
    page.get_by_role("button", name="Apply").click()
    expect(told(page)).to_contain_text("There is no scale for mm on the screen now")
    expect(x.get_by_label("Unit for x")).to_have_value("steps")
    expect(x.get_by_label("Target of x")).to_have_value("")
    expect(x.locator(".position")).to_have_text("+0.000")


def set_pulse_of_x(page, us: str) -> None:
    """Apply another length of a step's pulse; a scale counts for the one that it was measured with."""
    field = page.get_by_label("x: length of a step's pulse, us")
    field.fill(us)
    page.get_by_role("button", name="Apply").click()


@pytest.fixture
def page_whose_scale_was_gone(open_page, panel):
    """Half a mrad was typed; then the scale was lost, and the amount with it."""
    page = open_page(panel.url, **FRESH)
    page.get_by_label("Unit of fine steps").select_option("mrad")
    page.get_by_label("Number of steps").fill("0.5")
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    set_pulse_of_x(page, "50000")
    expect(page.get_by_label("Unit of fine steps")).to_have_value("steps")
    expect(page.get_by_label("Number of steps")).to_have_value("")
    return page


def get_scale_back(page) -> None:
    set_pulse_of_x(page, "200000")
    expect(page.locator('[name=steps_unit] option[value="mrad"]')).to_be_enabled()


def test_an_amount_that_was_typed_in_steps_is_none_in_the_remembered_unit(page_whose_scale_was_gone):
    page = page_whose_scale_was_gone
    page.get_by_label("Number of steps").fill("200")
    get_scale_back(page)
    again(page)
    expect(page.get_by_label("Number of steps")).to_have_value("200")
    expect(page.get_by_label("Unit of fine steps")).to_have_value("steps")


@pytest.mark.full
def test_a_remembered_amount_is_none_in_a_unit_that_was_chosen_without_it(page_whose_scale_was_gone):
    page = page_whose_scale_was_gone
    get_scale_back(page)
    page.get_by_label("Unit of fine steps").select_option("mm")
    again(page)
    expect(page.get_by_label("Unit of fine steps")).to_have_value("mm")
    expect(page.get_by_label("Number of steps")).to_have_value("")


@pytest.mark.full
def test_a_remembered_amount_and_its_unit_are_back_with_the_scale(page_whose_scale_was_gone):
    page = page_whose_scale_was_gone
    get_scale_back(page)
    again(page)
    expect(page.get_by_label("Number of steps")).to_have_value("0.5")
    expect(page.get_by_label("Unit of fine steps")).to_have_value("mrad")
