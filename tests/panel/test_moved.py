"""What the page moves by itself is not pressed: it stands still where it can, and is looked at where it cannot."""

import pytest
from running import wait_for_rest
from served import wait_for

PLACES = """() => JSON.stringify([...document.querySelectorAll("[data-press]")].map((element) => {
  const { x, y, width } = element.getBoundingClientRect();
  return [element.dataset.press, Math.round(x), Math.round(y), Math.round(width)];
}))"""
AT_FIRST = f"""addEventListener("DOMContentLoaded", () => new MutationObserver(() => {{
  if (document.body.classList.contains("steady")) window.atFirst ??= ({PLACES})();
}}).observe(document.body, {{ attributes: true }}));"""
# all that is under a finger is another 100 px further down, in the moment in which the finger comes
MOVE_AND_PRESS = """([place, kind]) => {
  document.querySelector(".cards").style.paddingTop = "116px";
  const target = document.querySelector(place);
  for (const type of kind) {
    const event = { bubbles: true, button: 0, pointerId: 1, detail: 1 };
    target.dispatchEvent(type === "click" ? new MouseEvent(type, event) : new PointerEvent(type, event));
  }
}"""
TOLD = "Not carried out: the page had just moved what you pressed."


def step(page, board) -> None:
    """A step by a press, and what the page shows of it."""
    before = len(board.edges())
    page.get_by_role("button", name="RIGHT", exact=True).click()
    wait_for(lambda: len(board.edges()) > before, "the step")  # the page may tell of an earlier one still
    wait_for_rest(board)
    page.get_by_text("last move: done").first.wait_for()


@pytest.mark.full
def test_once_the_page_stands_no_button_moves(open_page, panel, board):
    page = open_page(panel.url, before=lambda page: page.add_init_script(AT_FIRST))
    step(page, board)
    assert page.evaluate("window.atFirst") == page.evaluate(PLACES)


@pytest.mark.full
def test_a_message_that_comes_moves_no_button(page, board):
    before = page.evaluate(PLACES)
    board.process.kill()
    page.get_by_text("The panel looks for it every second").wait_for()
    assert page.evaluate(PLACES) == before


def test_a_press_on_a_button_that_has_just_moved_is_not_carried_out(page, board):
    step(page, board)
    before = board.edges()
    page.evaluate(MOVE_AND_PRESS, ['[data-press="x:1"]', ["pointerdown", "pointerup"]])
    page.get_by_text(TOLD).wait_for()
    page.get_by_text(TOLD).wait_for(state="hidden")
    assert board.edges() == before
    step(page, board)
    assert len(board.edges()) == 2 * len(before)


@pytest.mark.full
def test_a_click_that_has_just_moved_is_not_carried_out_either(page, board):
    place = """[data-send*='"goto"']"""
    step(page, board)
    before = board.edges()
    page.get_by_label("Target of x", exact=True).fill("3")
    page.evaluate(MOVE_AND_PRESS, [place, ["pointerdown", "click"]])
    page.get_by_text(TOLD).wait_for()
    page.get_by_text(TOLD).wait_for(state="hidden")
    assert board.edges() == before
    page.locator(place).first.click()
    wait_for(board.driving, "the move")


@pytest.mark.full
def test_stop_is_carried_out_wherever_it_has_moved_to(page, board):
    page.keyboard.down("ArrowUp")
    wait_for(board.driving, "the motor")
    page.evaluate("""() => {
      document.querySelector(".bottom").style.bottom = "200px";
      document.querySelector("[data-stop]").dispatchEvent(new PointerEvent("pointerdown", { bubbles: true }));
    }""")
    wait_for_rest(board)
