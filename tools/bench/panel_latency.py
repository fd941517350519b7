"""Measures the panel from the browser to the pins: a button goes down, comes up, or its page is gone.

    .venv/bin/python tools/bench/panel_latency.py [--n N] [--json FILE]

A real Chromium (headless, on the loopback interface) in front of `mirrormount panel` in front of a virtual board
(`cpython`, in real time), each in a process of its own. The beginning is the time stamp of the browser's event, or
the moment before a page is closed, frozen or cut off; the end is the line that the board writes about its enable. Both
are this computer's clock, so the figures are those of this computer, as busy as it was: they are not exact.
"""

import argparse
import json
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import _paths  # noqa: F401  (the tests' helpers)
from playwright.sync_api import Browser, Page, sync_playwright
from running import CHROMIUM, Network, Panel
from served import ServedBoard

_NOTE = """
  window.stamps = {};
  for (const kind of ["pointerdown", "pointerup"])
    addEventListener(kind, (e) => { stamps[kind] = performance.timeOrigin + e.timeStamp; }, true);
"""
_FREEZE = "setTimeout(() => { const end = Date.now() + 2000; while (Date.now() < end); })"
AIMS_MS = {"press": (20, 50), "release": (20, 50)}  # median, p95
MUST_MS = {"closed": 500}


class Watch:
    """Reads the board's edges as they are written, and the wall's clock with each."""

    def __init__(self, board: ServedBoard) -> None:
        self._board = board
        self._seen: list[tuple[float, dict]] = []
        self._news = threading.Condition()
        self._ending = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def next(self, on: bool) -> float:
        """When, in ms of the wall's clock, motor 2's enable next goes on or off."""
        with self._news:
            while True:
                while not self._seen:
                    if not self._news.wait(20):
                        raise SystemExit("waited in vain for an edge")
                at_ms, edge = self._seen.pop(0)
                if edge["pin"] == "m2_en" and (edge["duty"] > 0) == on:
                    return at_ms

    def end(self) -> None:
        """Read no more."""
        self._ending = True
        self._thread.join()

    def _read(self) -> None:
        with self._board.edges_file.open() as file:
            part = ""
            while not self._ending:
                part += file.readline()
                if not part.endswith("\n"):
                    time.sleep(0.0002)
                    continue
                with self._news:
                    self._seen.append((time.time() * 1000, json.loads(part)))
                    self._news.notify()
                part = ""


def hold(page: Page, watch: Watch) -> float:
    """Hold RIGHT until it runs. Returns the ms from the press to the enable."""
    page.mouse.down()
    on_ms = watch.next(True)
    watch.next(False)  # the step
    watch.next(True)  # the run
    return on_ms - page.evaluate("stamps.pointerdown")


def open_page(browser: Browser, url: str) -> Page:
    """A page with the mouse over RIGHT."""
    page = browser.new_page()
    page.goto(url)
    page.wait_for_selector("body.steady")
    page.evaluate(_NOTE)
    page.get_by_role("button", name="RIGHT", exact=True).hover()
    return page


def presses(browser: Browser, panel: Panel, watch: Watch, n: int) -> dict[str, list[float]]:
    """ms from press to on and from release to off, of so many holds."""
    page = open_page(browser, panel.url)
    found: dict[str, list[float]] = {"press": [], "release": []}
    for i in range(n):
        found["press"].append(hold(page, watch))
        page.wait_for_timeout(20 + i * 37 % 200)  # so that it comes at any phase of what the panel does
        page.mouse.up()
        off_ms = watch.next(False)
        found["release"].append(off_ms - page.evaluate("stamps.pointerup"))
        page.wait_for_timeout(50 + i * 53 % 100)
    page.close()
    return found


def losses(browser: Browser, url: str, watch: Watch, n: int, lose: Callable[[Page], None]) -> list[float]:
    """ms from the moment at which a page that holds is lost to the enable off."""
    found = []
    for i in range(n):
        page = open_page(browser, url)
        hold(page, watch)
        page.wait_for_timeout(20 + i * 37 % 200)
        start_ms = time.time() * 1000
        lose(page)
        found.append(watch.next(False) - start_ms)
        if not page.is_closed():
            page.close()
    return found


def measure(n: int) -> dict[str, list[float]]:
    """All rows: name to ms."""
    few = max(1, n // 5)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, chromium_sandbox=False)
        board = ServedBoard(Path(folder))
        panel = Panel(str(board.link), Path(folder))
        watch = Watch(board)
        try:
            found = presses(browser, panel, watch, n)
            found["closed"] = losses(browser, panel.url, watch, few, lambda page: page.close())
            found["frozen"] = losses(browser, panel.url, watch, few, lambda page: page.evaluate(_FREEZE))
            found["cut"] = []
            for _ in range(few):
                network = Network(panel.port)
                found["cut"] += losses(browser, network.url, watch, 1, lambda _, net=network: net.cut())
                network.close()
            return found
        finally:
            watch.end()
            panel.end()
            board.end()


def main(arguments: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--n", type=int, default=100, metavar="N", help="presses (default 100); a fifth of losses")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every value to FILE, too")
    options = parser.parse_args(arguments)
    found = measure(options.n)
    print("| held button, in ms | n | median | p95 | worst | aim |\n|---|--:|--:|--:|--:|---|")
    for name, values in found.items():
        p95 = sorted(values)[min(len(values) - 1, int(0.95 * len(values)))]
        aim = "{} median, {} p95".format(*AIMS_MS[name]) if name in AIMS_MS else f"{MUST_MS.get('closed')}"
        print(f"| {name} | {len(values)} | {statistics.median(values):.1f} | {p95:.1f} | {max(values):.1f} | {aim} |")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
