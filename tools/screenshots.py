"""Makes the pictures of the panel in docs/images: .venv/bin/python tools/screenshots.py [FOLDER]

A real Chromium (headless) in front of the panel on a virtual board that has just drawn a square. Look at them before
they are committed.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests" / "panel"), str(ROOT / "tests" / "host")]
from looks import SYSTEMS, THEMES, dress  # noqa: E402
from running import CHROMIUM, PANEL_ON_BENCH, Panel  # noqa: E402

DESK, PHONE = ViewportSize(width=1600, height=1000), ViewportSize(width=390, height=844)
_SQUARE = ("right ▶", "up ▲", "◀ left", "▼ down")
_STEPS = 8
_PATIENCE_MS = 60_000


def main(folder: Path) -> None:
    """Draw a square, and take the pictures of the page; then that of the camera's card."""
    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as playwright:
        os.environ["XDG_CONFIG_HOME"] = scratch
        _calibrate()
        panel = Panel("virtual://", Path(scratch), "--patience", "2")
        browser = playwright.chromium.launch(executable_path=CHROMIUM, chromium_sandbox=False)
        try:
            page = browser.new_page(viewport=DESK)
            page.set_default_timeout(_PATIENCE_MS)
            page.goto(panel.url)
            page.wait_for_selector("body.steady")
            _draw(page)
            for name, size, themes in (("desk", DESK, THEMES), ("phone", PHONE, SYSTEMS)):
                page.set_viewport_size(size)
                for colors in themes:
                    dress(page, colors)
                    page.wait_for_timeout(1500)  # the plot is drawn anew twice a second
                    page.screenshot(path=folder / f"panel-{name}-{colors}.png")
        finally:
            panel.end()
        try:
            _camera(browser, Path(scratch), folder / "panel-camera.png")
        finally:
            browser.close()


def _camera(browser: Browser, scratch: Path, picture: Path) -> None:
    """The camera's card, with the spot on its way to a target."""
    panel = Panel("--virtual", scratch, "--patience", "2", "--camera", "2", program=PANEL_ON_BENCH)
    try:
        page = browser.new_page(viewport=DESK)
        page.set_default_timeout(_PATIENCE_MS)
        page.goto(panel.url)
        page.wait_for_selector("body.steady")
        page.get_by_role("button", name="Learn").click()
        page.locator(".news").get_by_text("now click where it should go").wait_for()
        page.locator("canvas.picture").click(position={"x": 110, "y": 90})
        page.locator(".camera-doing").get_by_text("correction 4").wait_for()
        page.locator("section:has(canvas.picture)").screenshot(path=picture)
    finally:
        panel.end()


def _calibrate() -> None:
    """Give the virtual board the paper's scales, so that positions are shown in mrad, too."""
    program = """
from mirrormount import Mount
from mirrormount.device import calibration
with Mount.open("virtual://?speed=max") as mount:
    for axis, mrad in ((mount.x, 0.43 / 2), (mount.y, 0.47 / 2**0.5)):  # the mirror turns less than the beam
        step = calibration.Step(*axis.ask_whole("XP?", "XD?", "XI?"))
        calibration.write(mount.board_id, {axis.number: calibration.Scale(mrad, mrad, step)})
"""
    subprocess.run([sys.executable, "-P", "-c", program], check=True)


def _draw(page: Page) -> None:
    """A square on the screen, and one thing that is refused, so that there is something to see."""
    for zero in page.get_by_role("button", name="Zero", exact=True).all():
        zero.click()
    page.get_by_label("Number of steps").fill(str(_STEPS))
    position = {"x": 0, "y": 0}
    for i, side in enumerate(_SQUARE):
        axis, way = "xyxy"[i], (1, 1, -1, -1)[i]
        position[axis] += way * _STEPS
        page.get_by_text(side).click()
        moved = f"{position[axis]:+d}.000".replace("-", "\N{MINUS SIGN}")
        page.locator("section", has_text={"x": "X ·", "y": "Y ·"}[axis]).get_by_text(moved).wait_for()
    page.get_by_text("right ▶").click()
    page.get_by_text("moving").first.wait_for()
    page.locator(".q-notification").first.wait_for(state="detached")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "images")
