"""The page of a mount in the output of a cell, in JupyterLab and in Notebook 7, in a real browser."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from iocs import free_port
from kernel import get
from running import CHROMIUM
from served import HANG_S, PATIENCE_S, wait_for

pytestmark = pytest.mark.full
FIRST_STEPS = Path(__file__).parents[2] / "docs/examples/first_steps.ipynb"
OPENED = {"jupyterlab": "lab/tree/book.ipynb", "notebook": "notebooks/book.ipynb"}
LONG = "mount.x.step(500)"


@pytest.fixture(params=OPENED)
def opened(request, tmp_path):
    """A page of the program with first_steps open, whose second cell is a long motion."""
    pytest.importorskip(request.param)
    api = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("no Chromium")
    book = json.loads(FIRST_STEPS.read_text(encoding="utf-8"))
    codes = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    codes[1]["source"] = [LONG]
    book["cells"] = codes[:2]
    root = tmp_path / "root"
    root.mkdir()
    (root / "book.ipynb").write_text(json.dumps(book), encoding="utf-8")
    port = free_port()
    words = ["--no-browser", "--allow-root", f"--ServerApp.port={port}", f"--ServerApp.root_dir={root}"]
    quiet = ["--IdentityProvider.token=t", "--LabApp.news_url=None", "--LabApp.check_for_updates_class="]
    quiet[2] += "jupyterlab.handlers.announcements.NeverCheckForUpdate"
    own = {f"JUPYTER_{name}_DIR": str(tmp_path / name) for name in ("CONFIG", "RUNTIME", "DATA")}
    with (tmp_path / "log").open("w") as log, api.sync_playwright() as playwright:
        server = subprocess.Popen(
            [sys.executable, "-m", request.param, *words, *quiet],
            env=os.environ | own | {"IPYTHONDIR": str(tmp_path / "ipython")},
            stdout=log,
            stderr=log,
        )
        try:
            wait_for(lambda: _answers(f"http://127.0.0.1:{port}/api/status?token=t"), "the server")
            browser = playwright.chromium.launch(executable_path=CHROMIUM, chromium_sandbox=os.name != "posix")
            page = browser.new_page(viewport={"width": 1600, "height": 1000})
            page.set_default_timeout(1000 * PATIENCE_S)
            page.goto(f"http://127.0.0.1:{port}/{OPENED[request.param]}?token=t")
            page.locator(".jp-CodeCell .cm-content").nth(1).wait_for()
            yield page
        finally:
            server.terminate()
            server.wait(HANG_S)


def _answers(url: str) -> bool:
    try:
        return bool(get(url))
    except OSError:
        return False


def _begun(page, number: int) -> bool:
    """Whether a cell has begun. A key that comes before the kernel is there is lost, and nothing shows when it is."""
    prompt = page.locator(".jp-CodeCell .jp-InputPrompt").nth(number)
    if prompt.inner_text().strip() == "[ ]:":
        page.locator(".jp-CodeCell .cm-content").nth(number).click()
        page.keyboard.press("Control+Enter")
        page.wait_for_timeout(1000)
    return prompt.inner_text().strip() != "[ ]:"


def test_stop_in_the_frame_ends_a_cell_under_way_and_a_step_is_made_when_none_runs(opened):
    wait_for(lambda: _begun(opened, 0), "the first cell")
    frame = opened.frame_locator("iframe[title=mount]")
    frame.locator("#axes tr").nth(1).wait_for()
    right = frame.locator("button.step").nth(1)
    right.click()
    frame.get_by_text("+1.000 steps").wait_for()
    frame.locator("#picture:not([hidden])").wait_for()  # behind the step the camera was looked at
    wait_for(lambda: _begun(opened, 1), "the second cell")
    frame.get_by_text("moving").wait_for()
    assert right.is_disabled()
    frame.locator("#stop").click()
    frame.get_by_text("STOP was sent; the running cell is interrupted").wait_for()
    opened.locator(".jp-OutputArea-output").get_by_text("KeyboardInterrupt").first.wait_for()
    right.and_(frame.locator(":enabled")).wait_for()
    assert frame.get_by_text("at rest").count() == 2
