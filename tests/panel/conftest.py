"""Fixtures: a virtual board, the panel on it, and a real browser in front of it."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright
from running import CHROMIUM, Panel
from served import ServedBoard


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium")
    with sync_playwright() as playwright:
        yield playwright.chromium.launch(executable_path=CHROMIUM, chromium_sandbox=os.name != "posix")


@pytest.fixture
def board(tmp_path: Path) -> Iterator[ServedBoard]:
    if os.name != "posix":
        pytest.skip("a pty needs POSIX")
    folder = tmp_path / "board"
    folder.mkdir()
    board = ServedBoard(folder)
    yield board
    board.kill()
    board.process.stdout.close()


@pytest.fixture
def panel(board: ServedBoard, tmp_path: Path) -> Iterator[Panel]:
    panel = Panel(str(board.link), tmp_path)
    yield panel
    panel.kill()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[..., Page]]:
    """Opens a page in a browser of its own, and waits until it can drive. Fails on any error of its scripts."""
    contexts, faults = [], []

    def open_page(url: str, **options) -> Page:
        contexts.append(browser.new_context(**options))
        page = contexts[-1].new_page()
        page.on("pageerror", lambda e: faults.append(str(e)))
        page.goto(url)
        page.wait_for_selector("body.ready")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert faults == []


@pytest.fixture
def page(open_page: Callable[..., Page], panel: Panel) -> Page:
    return open_page(panel.url)
