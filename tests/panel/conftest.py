"""Fixtures: a virtual board, the panel on it, and a real browser in front of it."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright
from running import CHROMIUM, Panel
from served import PATIENCE_S, ServedBoard

# how long a page may take is no fact of these tests: a wait ends by its event
expect.set_options(timeout=1000 * PATIENCE_S)

# an emulated graphics card takes a sixth of a page's time, a process for each page a fifth
PLAIN = ["--disable-gpu", "--disable-software-rasterizer", "--process-per-site"]
# what is judged is where things come to rest: every frame on the way there is painted by the processor
AT_ONCE = """addEventListener("DOMContentLoaded", () => {
  const style = document.createElement("style");
  style.textContent =
    "*, *::before, *::after { transition-duration: 0s !important; animation-duration: 0s !important }";
  document.head.append(style);
});"""


def pytest_itemcollected(item: pytest.Item) -> None:
    """A page that stands still for 0.35 s is stopped by design, so a busy computer stops what these tests drive."""
    if "browser" in getattr(item, "fixturenames", ()):
        item.add_marker("wall_clock")


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium")
    with sync_playwright() as playwright:
        sandbox = os.name != "posix"
        yield playwright.chromium.launch(executable_path=CHROMIUM, args=PLAIN, chromium_sandbox=sandbox)


@pytest.fixture
def board(tmp_path: Path) -> Iterator[ServedBoard]:
    with ServedBoard(tmp_path / "board") as board:
        yield board


@pytest.fixture
def panel_options() -> list[str]:
    return []


@pytest.fixture
def panel(board: ServedBoard, tmp_path: Path, panel_options: list[str]) -> Iterator[Panel]:
    panel = Panel(str(board.link), tmp_path, *panel_options)
    yield panel
    panel.kill()


@pytest.fixture(scope="session")
def context(browser: Browser) -> BrowserContext:
    """A browser that keeps what it has loaded, from test to test."""
    return browser.new_context()


@pytest.fixture
def open_page(browser: Browser, context: BrowserContext) -> Iterator[Callable[..., Page]]:
    """Opens a page (with options in a browser of its own), and waits until it can drive. Fails on errors of scripts."""
    pages, faults = [], []

    def open_page(url: str, until: str = "body.steady", before: Callable[[Page], object] = str, **options) -> Page:
        page = browser.new_page(**options) if options else context.new_page()
        page.set_default_timeout(1000 * PATIENCE_S)
        before(page)
        pages.append(page)
        page.on("pageerror", lambda e: faults.append(str(e)))
        page.add_init_script(AT_ONCE)
        page.goto(url)
        page.wait_for_selector(until)
        return page

    yield open_page
    for page in pages:
        page.close()
    assert faults == []


@pytest.fixture
def page(open_page: Callable[..., Page], panel: Panel) -> Page:
    return open_page(panel.url)
