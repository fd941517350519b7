"""The commands of the pages are those of the parser, and the marked ones, commands.md and python.md work."""

import os
import pydoc
import re
import shlex
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from mirrormount.cli.main import parser
from mirrormount.device.mount import Mount
from mirrormount.device.settings import SETTINGS
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_table
from mirrormount_beam import cameras

ROOT = Path(__file__).parent.parent.parent
COMMANDS = (ROOT / "docs" / "commands.md").read_text()
PYTHON = (ROOT / "docs" / "python.md").read_text()
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
OF_EXTRAS = ("cv2", "h5py", "matplotlib", "nicegui", "numpy", "segno")  # what the extras bring, as it is imported
ASKED_FOR = re.compile(r'pip install .*\[([a-z,]+)\]"')
UNTIL_CTRL_C = ("panel", "serve")
# what is shown in mrad says whose angle it is: the beam turns about twice as far as the mirror
SAYS = {"measure": ("urad of the beam", "mrad a step (of the mirror)")}
ANSWERS = {"setup": "yes\nright\nup\nnone\nnone\nno\nno\n0\nno\n"}


def test_the_ten_lines_of_python_run(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", PYTHON, re.DOTALL)
    assert code.count('"virtual://"') == 1
    exec(compile(code.replace("virtual://", "virtual://?speed=max"), "python.md", "exec"), {})
    assert capsys.readouterr().out == "5.0 unknown\n"


def test_the_raster_of_the_page_writes_where_the_spot_is(tmp_path, monkeypatch):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "beam.md").read_text(encoding="utf-8"), re.DOTALL)
    (code,) = [block for block in blocks if "raster.csv" in block]
    monkeypatch.chdir(tmp_path)
    with open_table("virtual-table://?mounts=1") as table:
        monkeypatch.setattr(Mount, "open", lambda: Mount(Link(table.ports[0])))
        monkeypatch.setattr(cameras, "open_webcam", lambda *_, **__: table.cameras[0])
        exec(compile(code, "beam.md", "exec"), {})
    rows = [[float(value) for value in line.split(",")] for line in (tmp_path / "raster.csv").read_text().splitlines()]
    assert [row[:2] for row in rows] == [[x, y] for y in range(5) for x in range(5)]
    places = {(x, y): (right, down) for x, y, right, down in rows}
    for y in range(5):
        for x in range(4):
            assert places[x + 1, y][0] > places[x, y][0] and places[y, x + 1][1] < places[y, x][1]


def shell_lines() -> list[str]:
    blocks = re.findall(r"```sh\n(.*?)```", COMMANDS, re.DOTALL)
    return [line.partition(" #")[0].strip() for block in blocks for line in block.splitlines()]


def commands() -> list[list[str]]:
    found = [shlex.split(line)[1:] for line in shell_lines() if line.startswith("mirrormount ")]
    assert len(found) >= 14
    return found


def port() -> str:
    (found,) = re.findall(r'export MIRRORMOUNT_PORT="(.*)"', "\n".join(shell_lines()))
    return found


def run(words: list[str], folder: Path, port: str, start: tuple[str, ...] = ("-m", "mirrormount")) -> tuple[int, str]:
    """The exit status of a command, and all that it printed. A server gets Ctrl-C when it has said its first line."""
    serves = words[0] in UNTIL_CTRL_C
    if not serves:
        port += "&speed=max"
    process = subprocess.Popen(
        [sys.executable, *start, *words],
        cwd=folder,
        env=os.environ | {"MIRRORMOUNT_PORT": port, "BROWSER": "true", "MIRRORMOUNT_CONFIG": str(folder)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    said = ""
    if serves:
        said = process.stdout.readline()
        process.send_signal(signal.SIGINT)
    said += process.communicate(ANSWERS.get(words[0], ""), timeout=600)[0]
    return process.returncode, said


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent as a POSIX signal")
def test_every_command_of_the_page_works_in_its_order_on_the_pages_board(tmp_path):
    for words in commands():
        status, said = run(words, tmp_path, port())
        assert status == 0 or (status == 130 and words[0] in UNTIL_CTRL_C), (words, status, said)
        assert "Traceback" not in said, said
        assert all(part in said for part in SAYS.get(words[0], ())), said


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent as a POSIX signal")
def test_the_page_installs_the_extras_that_its_commands_ask_for(tmp_path):
    without = f"import sys; sys.modules |= dict.fromkeys({OF_EXTRAS}); from mirrormount.cli.main import main; main()"
    said = [run(words, tmp_path, port(), ("-c", without))[1] for words in commands()]
    missing = {extra for text in said for named in ASKED_FOR.findall(text) for extra in named.split(",")}
    (installed,) = {extras for line in shell_lines() for extras in ASKED_FOR.findall(line)}
    assert missing == set(installed.split(",")) <= set(EXTRAS)


def test_a_position_outlives_a_command_only_after_ten_seconds_of_rest(tmp_path):
    address = f"virtual://?speed=max&files={tmp_path}"
    for rest_s, position, certainty in ((9, 0, "unknown"), (11, 5, "counted")):
        with Mount.open(address) as mount:
            mount.x.zero()
            mount.x.step(5)
            mount.sleep(rest_s)
        with Mount.open(address) as mount:
            assert (mount.x.position, mount.status().x.certainty) == (position, certainty)


def test_the_line_for_powershell_names_the_same_board():
    assert re.findall(r'`\$env:MIRRORMOUNT_PORT="(.*)"`', COMMANDS) == [port()]


def test_the_pages_of_pydoc_that_python_md_names_have_all_of_a_mount_and_its_axes():
    pages = [pydoc.plain(pydoc.render_doc(name)) for name in re.findall(r"`python -m pydoc ([\w.]+)`", PYTHON)]
    for name in ("step", "jog", "home", "move_to", "zero", "position", "save", "apply", *SETTINGS):
        assert any(re.search(rf"^ \|  {name}\b", page, re.MULTILINE) for page in pages), name


def typed(page: str, mark: str = "") -> list[list[str]]:
    """The words of each `mirrormount` line in a page's blocks of code (all, or those with a mark)."""
    text = (ROOT / page).read_text(encoding="utf-8")
    fence = f"sh {mark}" if mark else "(?:|sh|text|sh runnable|sh runnable full)"
    blocks = re.findall(rf"^```{fence}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line.strip().removeprefix("$ ") for block in blocks for line in block.splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("mirrormount ")]


PAGES = ["README.md", *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md")))]


def test_every_command_of_the_pages_is_one_of_the_parser(capsys):
    lines = [(page, words) for page in PAGES for words in typed(page)]
    assert len(lines) > 90
    whole = parser()
    for page, words in lines:
        try:
            whole.parse_args(words)
        except SystemExit:
            pytest.fail(f"{page}: mirrormount {shlex.join(words)}: {capsys.readouterr().err}")


def run_marked(mark: str, folder: Path) -> None:
    lines = [words for page in PAGES for words in typed(page, mark)]
    assert lines
    for words in lines:
        status, said = run(words, folder, "")
        assert (status, "Traceback" in said) == (0, False), (words, said)


def test_the_commands_that_are_marked_as_runnable_work_in_their_order(tmp_path):
    run_marked("runnable", tmp_path)


@pytest.mark.full
def test_those_of_a_minute_and_more_work_too(tmp_path):
    run_marked("runnable full", tmp_path)


@pytest.mark.full
def test_the_site_is_built_without_a_warning_and_asks_no_other_site_for_anything(tmp_path):
    program = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    pages = {
        path.relative_to(tmp_path).as_posix(): path.read_text(encoding="utf-8") for path in tmp_path.rglob("*.html")
    }
    assert {"index.html", "tutorial-hold/index.html", "compare/index.html"} <= set(pages)
    assert "find_spot" in pages["python/index.html"]
    assert "backlash" in (tmp_path / "search" / "search_index.json").read_text(encoding="utf-8")
    asked = re.compile(
        r'<(?:script|img|iframe)[^>]*src="?https?:|<link[^>]*rel="?(?:stylesheet|preconnect)[^>]*https?:'
    )
    assert [name for name, text in pages.items() if asked.search(text)] == []
