"""Each example of docs/examples that drives a mount from Python or a notebook runs as it stands, and is listed."""

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from iocs import PREFIX, Ioc
from served import HANG_S

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs/examples"
SCRIPTS = {
    "paper_square": r"open without take-up: (2|3)\d\.\d px\nopen with take-up: [0-3]\.\d px\n",
    "spots_to_csv": "",
    "raster": r"25 places: raster\.csv, raster\.h5\n",
    "find_lost_beam": r"before: no spot.*\nfound at x [+-]\d+, y [+-]\d+ steps, at place \d+\nspot at x .*\n",
    "fibre_by_signal": r"reached: 0\.01\d* at the begin, (0\.9\d*|1\.?\d*) at the end\n",
    "step_size": r"(?s)x\.positive\.step +1\d\.\d+ ± 0\.\d+ px\n.*",
}
# a sign of each in its outputs
NOTEBOOKS = {"first_steps": "<iframe", "raster": "25 of 25 places", "two_mounts_hold": "corrections"}
MARKS = dict.fromkeys(("raster", "find_lost_beam", "step_size", "first_steps"), pytest.mark.slow)
MARKS["two_mounts_hold"] = pytest.mark.full  # a calibration, and a minute of four axes and two cameras
RUN_NOTEBOOK = """
import nbformat, sys
from nbclient import NotebookClient
book = nbformat.read(sys.argv[1], 4)
NotebookClient(book, timeout=600, kernel_name="python3").execute()
print(nbformat.writes(book))
"""


def parameters(names):
    return [pytest.param(name, marks=MARKS.get(name, ())) for name in names]


def run(folder: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    own = {"IPYTHONDIR": str(folder), "JUPYTER_RUNTIME_DIR": str(folder), **environment}
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=os.environ | own, capture_output=True, text=True, timeout=5 * HANG_S
    )


@pytest.mark.parametrize("name", parameters(SCRIPTS))
def test_a_script_runs_as_it_stands(tmp_path, name):
    done = run(tmp_path, "-P", str(EXAMPLES / f"{name}.py"))
    assert (done.returncode, done.stderr) == (0, "")
    assert re.fullmatch(SCRIPTS[name], done.stdout), done.stdout
    if name == "spots_to_csv":
        rows = [*csv.reader((tmp_path / "spots.csv").read_text().splitlines())]
        assert len(rows) == 25 and all(len(row) == 4 for row in rows)
        assert float(rows[4][2]) > float(rows[0][2]) + 20, "four steps to the right move the spot to the right"


@pytest.mark.slow
@pytest.mark.wall_clock  # a thread of the IOC that is late by its patience cuts moves, by design
def test_the_client_of_epics_moves_a_motor_and_stops(tmp_path):
    with Ioc("--virtual", "--patience", "2") as ioc:
        done = run(tmp_path, "-P", str(EXAMPLES / "epics_client.py"), PREFIX, **ioc.environment)
    assert done.returncode == 0, done.stderr
    assert [line.split(",")[0] for line in done.stdout.splitlines()] == [
        "asked for 3: at 3 steps",
        "asked for -3: at -3 steps",
        "asked for 0: at 0 steps",
    ]


@pytest.mark.parametrize("name", parameters(NOTEBOOKS))
def test_a_notebook_runs_as_it_stands(tmp_path, name):
    pytest.importorskip("nbclient")
    done = run(tmp_path, "-W", "ignore", "-c", RUN_NOTEBOOK, str(EXAMPLES / f"{name}.ipynb"))
    assert done.returncode == 0, done.stderr
    assert NOTEBOOKS[name] in done.stdout


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_outputs_and_names_no_machine(path):
    book = json.loads(path.read_text(encoding="utf-8"))
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in book["cells"])
    assert set(book["metadata"]) == {"kernelspec", "language_info"}
    assert not re.search(r"/home|/root|/tmp|/work|[A-Z]:\\\\", path.read_text(encoding="utf-8"))


OURS = [*(f"{name}.py" for name in (*SCRIPTS, "epics_client")), *(f"{name}.ipynb" for name in NOTEBOOKS)]


@pytest.mark.parametrize("name", OURS)
def test_an_example_is_short_says_what_is_learned_and_names_the_line_for_real_hardware(name):
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    if name.endswith(".ipynb"):
        cells = json.loads(text)["cells"]
        assert "Learn: " in "".join(cells[0]["source"])
        text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    else:
        assert text.startswith("# Learn: ")
    assert "# real hardware" in text
    assert text.count("\n") <= 40


def test_the_page_lists_each_example():
    page = (ROOT / "docs/examples.md").read_text(encoding="utf-8")
    there = {path.name for path in EXAMPLES.iterdir()}
    assert set(re.findall(r"\]\(examples/([\w.]+)", page)) == there  # of a folder its files are listed
