"""A board with three axes: the panel has what a person needs for each."""

import pytest
from running import press
from served import ServedBoard, wait_for
from three_axes import make_board_files


@pytest.fixture
def panel_options() -> list[str]:
    return ["--patience", "2"]  # nothing here is about a page that is out of touch


@pytest.fixture
def board(tmp_path):
    (tmp_path / "files").mkdir()
    with ServedBoard(tmp_path / "board", *make_board_files(tmp_path / "files")) as board:
        yield board


def position(page, number: int) -> str:
    return page.locator(".position").nth(number).inner_text()


def test_the_third_axis_steps_runs_goes_home_and_has_its_settings(page):
    plus = page.get_by_role("button", name="AXIS 3 PLUS")
    press(plus)
    wait_for(lambda: position(page, 2) == "+1.000", "a step")
    press(page.get_by_role("button", name="− Axis 3"))
    wait_for(lambda: position(page, 2) == "+0.000", "a step back")
    plus.hover()
    page.mouse.down()
    wait_for(lambda: float(position(page, 2)) > 1.1, "a run")
    page.mouse.up()
    page.get_by_text("last move: aborted (the button was let go)").wait_for()
    page.get_by_label("Target of axis3").fill("-1")
    page.get_by_label("Target of axis3").press("Enter")
    wait_for(lambda: float(position(page, 2).replace("−", "-")) < 0, "the way to its target")
    assert [position(page, number) for number in (0, 1)] == ["+0.000", "+0.000"]
    page.get_by_text("Wiring, pulse and speed, take-up, limits").click()
    page.wait_for_function("""document.querySelector('[aria-label^="axis3: length of a step"]').value === "200000" """)


@pytest.mark.full
def test_stop_ends_the_third_axis(page):
    page.get_by_role("button", name="AXIS 3 PLUS").hover()
    page.mouse.down()
    wait_for(lambda: float(position(page, 2)) > 1.1, "a run")
    page.keyboard.press("Escape")
    page.get_by_text("last move: aborted (STOP was pressed)").wait_for()
