"""Night: nothing but red on the screen, a choice that is remembered, and lamps that differ without colour."""

import io

import pytest
from looks import DESK, dress, settled
from PIL import Image
from playwright.sync_api import expect
from running import Panel, press

RED = {"red": 255, "green": 0, "blue": 0}
LAMPS = ("on", "moves", "warn", "bad", "unknown", "")


def brightest(picture: bytes) -> dict[str, int]:
    """The highest value of each colour in a picture, 0 … 255."""
    highest = Image.open(io.BytesIO(picture)).convert("RGB").getextrema()
    return {colour: most for colour, (_, most) in zip(("red", "green", "blue"), highest, strict=True)}


@pytest.fixture
def virtual(tmp_path):
    """The panel of a virtual board, with its screen."""
    panel = Panel("virtual://", tmp_path, "--patience", "2")
    yield panel
    panel.kill()


def test_at_night_there_is_no_green_and_no_blue(open_page, virtual):
    page = open_page(virtual.url, viewport={"width": 1600, "height": 2400})
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    page.get_by_text("What goes over the wire").click()
    press(page.get_by_role("button", name="RIGHT", exact=True))
    expect(page.locator(".position").first).to_have_text("+1.000")
    page.get_by_label("Speed of Y").fill("256")
    press(page.get_by_role("button", name="OK", exact=True).first)
    page.locator(".toast").wait_for()
    assert min(brightest(page.screenshot()).values()) > 100
    dress(page, "night")
    expect(page.locator("html")).to_have_class("night")
    assert brightest(page.screenshot()) == RED
    page.get_by_role("button", name="Factory").click()
    page.get_by_text("Replace all settings by the factory's?").wait_for()
    settled(page)
    assert brightest(page.screenshot()) == RED
    page.get_by_role("button", name="Cancel").click()
    virtual.kill()
    page.get_by_text("No connection to the panel.").wait_for()
    assert brightest(page.screenshot()) == RED


@pytest.mark.full
def test_the_button_goes_round_and_the_choice_is_remembered_from_the_first_picture_on(open_page, panel):
    page = open_page(panel.url, viewport=DESK, color_scheme="light")
    button = page.locator("[data-mode]")
    ground = "() => getComputedStyle(document.body).backgroundColor"
    for name, colour in (("dark", "rgb(14, 19, 23)"), ("light", "rgb(238, 241, 243)"), ("night", "rgb(0, 0, 0)")):
        button.click()
        expect(button).to_contain_text(name)
        assert page.evaluate(ground) == colour
    page.add_init_script(
        "addEventListener('DOMContentLoaded', () => (window.first = document.documentElement.className))"
    )
    page.reload()
    page.wait_for_selector("body.steady")
    assert page.evaluate("window.first") == "night"
    expect(button).to_contain_text("night")
    button.click()
    expect(button).to_contain_text("auto")
    page.emulate_media(color_scheme="dark")
    page.wait_for_function(f"({ground})() === 'rgb(14, 19, 23)'")


def test_at_night_lamps_differ_by_shape_or_brightness(page):
    dress(page, "night")
    box = page.locator(".lamps").first
    box.evaluate("(e, states) => e.replaceChildren(...states.map((s) => Object.assign(document.createElement('span'),"
                 " { className: `lamp ${s}` })))", list(LAMPS))  # fmt: skip
    pictures = {lamp.screenshot() for lamp in box.locator(".lamp").all()}
    assert len(pictures) == len(LAMPS)
