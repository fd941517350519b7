"""The panel on a virtual table with a camera and encoders, in a browser: the camera's card, units, what is measured.

One panel for all of them. The last test closes the loop of x and jams its motor.
"""

import re

import pytest
from looks import DESK, PHONE, THEMES, assert_nothing_cut_off, assert_readable, assert_touchable, dress
from playwright.sync_api import expect
from running import PANEL_ON_BENCH, Panel, press
from served import HANG_S, wait_for

from mirrormount.device import calibration

BOARD = "e6616408432f5a21"
STEP = calibration.Step(200_000, 255, 0)
WORK_MS = HANG_S * 1000  # for up to 40 moves, each with its pictures
NEWS = ".news:not(.moved)"  # the events, not the log of motions
OVER_LEARN = re.compile(r"now click where|the move of the spot has ")  # however it ended
OVER_MOVE = re.compile(r"the spot is |the move of the spot has ")

# How many pixels of the picture have one of its colours: green is the spot's ring, red the trail, blue the target.
COLOURS = """(canvas) => {
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  const counts = { green: 0, red: 0, blue: 0 };
  for (let i = 0; i < data.length; i += 4) {
    const [r, g, b] = data.slice(i, i + 3);
    if (g > r + 60 && g > b + 40) counts.green++;
    if (r > g + 60 && r > b + 60) counts.red++;
    if (b > r + 60 && g > r + 30) counts.blue++;
  }
  return counts;
}"""


@pytest.fixture(scope="module")
def panel(tmp_path_factory):
    """A table's mount with encoders; x has a whole scale, y the mirror's alone."""
    folder = tmp_path_factory.mktemp("bench")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MIRRORMOUNT_CONFIG", str(folder))
        calibration.write(BOARD, {2: calibration.Scale(0.215, 0.215, STEP, 2.0, 1500.0)})
        calibration.write(BOARD, {1: calibration.Scale(0.33, 0.33, STEP)})
        # on other mechanics one of a hundred ways of the spot does not arrive: tests/beam/test_pointing.py counts them
        options = ("--patience", "60", "--camera", "2", "--encoder", "motor", "--profile", "smooth")
        panel = Panel("--virtual", folder, *options, program=PANEL_ON_BENCH)
    yield panel
    panel.kill()


def take_control(page) -> None:
    """For the page of the test before, which had it, may leave only now; it is gone after this."""
    page.get_by_role("button", name="Take control", include_hidden=True).dispatch_event("click")
    expect(page.locator(".role")).to_be_hidden()


@pytest.fixture
def page(page):
    take_control(page)
    return page


@pytest.fixture(scope="module")
def learned(panel, browser):
    """Learn was pressed, and is over."""
    page = browser.new_page()
    page.goto(panel.url)
    page.wait_for_selector("body.steady")
    take_control(page)
    page.get_by_role("button", name="Learn").click()
    expect(page.locator(NEWS)).to_contain_text(OVER_LEARN, timeout=WORK_MS)
    assert "now click where it should go" in page.locator(NEWS).inner_text()
    page.close()


def click_on_picture(page, x: float, y: float) -> None:
    """Where: shares of the picture's width and height."""
    expect(page.locator(".camera-says")).to_contain_text("x ")
    box = page.locator("canvas.picture").bounding_box()
    page.locator("canvas.picture").click(position={"x": x * box["width"], "y": y * box["height"]})


def driving(panel) -> bool:
    return any(panel.bench("duties").values())


@pytest.mark.full
def test_the_card_of_the_camera_can_be_read_and_touched_and_nothing_is_cut_off(page):
    expect(page.locator(".camera-says")).to_contain_text("± ")
    for viewport in (PHONE, DESK):
        page.set_viewport_size(viewport)
        assert_touchable(page)
        assert_nothing_cut_off(page)
        for colors in THEMES:
            dress(page, colors)
            assert_readable(page, "x ", "threshold", "Move the spot there", "Learn", "Click on the picture")


def test_a_click_moves_the_spot_there_and_the_picture_shows_spot_trail_and_target(page, learned):
    click_on_picture(page, 0.45, 0.45)
    x, y = (float(page.locator(f"input[name=place_{axis}]").input_value()) for axis in "xy")
    expect(page.locator("p.camera-doing")).to_contain_text(re.compile(r"the spot goes to .* STOP ends it"))
    expect(page.locator(NEWS)).to_contain_text(OVER_MOVE, timeout=WORK_MS)
    assert re.search(r"the spot is at .* within 0.5 px", page.locator(NEWS).inner_text())
    seen = page.locator(".camera-says").inner_text()
    assert [float(n) for n in re.findall(r"[xy] ([\d.]+)", seen)] == pytest.approx([x, y], abs=2.0)
    assert re.search(r"from the target: .* µm \(.* µrad\), .*of the beam", page.locator(".camera-off").inner_text())
    drawn = page.locator("canvas.picture").evaluate(COLOURS)
    assert min(drawn.values()) > 10, drawn


@pytest.mark.full
def test_stop_ends_a_move_of_the_spot(page, panel, learned):
    click_on_picture(page, 0.75, 0.7)
    wait_for(lambda: driving(panel), "the move")
    page.keyboard.press("Escape")
    expect(page.locator(NEWS)).to_contain_text("the move of the spot has ended: stopped: STOP was pressed")
    assert not driving(panel)
    expect(page.locator("p.camera-doing")).to_be_empty()
    expect(page.locator("section:has(.position)").first).to_contain_text("aborted (STOP was pressed)")


@pytest.mark.full
def test_a_camera_that_fails_is_one_line_and_its_picture_is_no_target(page, panel):
    expect(page.locator(".camera-says")).to_contain_text("x ")
    panel.bench("unplug")
    try:
        trouble = page.locator(".camera-trouble")
        expect(trouble).to_have_text(re.compile(r"^virtual camera 2 was unplugged\. The picture is \d+ s old\.$"))
        expect(page.locator(".camera-says")).to_be_empty()
        page.locator("canvas.picture").click()
        expect(page.locator(".toast")).to_contain_text("nothing was done: the picture is not of now")
        for colors in THEMES:
            dress(page, colors)
            assert_readable(page, "was unplugged")
    finally:
        panel.bench("plug")
    expect(trouble).to_be_empty()


@pytest.mark.full
def test_a_position_is_typed_in_the_unit_that_a_person_thinks_in(page):
    y = page.locator("section", has_text="Y · up and down")
    unit = y.get_by_label("Unit for y")
    assert unit.evaluate("(e) => [...e.options].filter((o) => o.disabled).map((o) => o.value)") == [
        "beam-urad",
        "beam-mrad",
        "mm",
        "um",
    ]
    unit.select_option("µrad of the mirror")
    y.get_by_label("Target of y").fill("-412.5")
    y.get_by_label("Target of y").press("Enter")
    expect(y.locator(".mrad")).to_contain_text("−1.250 steps")
    expect(y.locator(".position")).to_have_text("≈ −412")
    y.get_by_label("Target of y").fill("0,5")
    y.get_by_label("Target of y").press("Enter")
    told = page.locator(".toast .q-notification__message")
    expect(told).to_have_text("nothing was done: the target of y is a number such as 3 or 0.25, not '0,5'")
    expect(y.locator(".position")).to_have_text("≈ −412")


@pytest.mark.full
def test_what_an_encoder_measures_is_shown_and_a_stall_is_told_with_its_remedy(page, panel):
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    page.get_by_label("x: counts of one step").fill("280")
    page.get_by_label("x: 1: closed loop").fill("1")
    press(page.get_by_role("button", name="Apply"))
    expect(page.locator(".q-notifications")).to_contain_text("applied")
    x = page.locator("section", has_text="X · right and left")
    press(x.get_by_role("button", name="Zero", exact=True))
    expect(x.locator(".lamps")).to_contain_text("measured")
    expect(x.locator(".position")).to_have_text("+0.000")
    panel.bench("hand m2")
    expect(x.locator(".position")).to_have_text(re.compile(r"^\+(0\.[5-9]|1\.)"))
    panel.bench("jam m2")
    page.get_by_label("Number of steps").fill("40")
    press(page.get_by_text("right ▶"))
    expect(page.locator(NEWS)).to_contain_text(re.compile("x motor stalled.*Cause: .*Remedy: ", re.DOTALL))
    expect(x.locator(".reason")).to_have_text("last move: motor stalled")
    expect(x.locator(".lamps")).to_contain_text("estimated")
    assert not driving(panel)
