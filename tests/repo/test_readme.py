"""The README's Python lines and shell commands do what they say."""

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

from mirrormount.device.mount import Mount
from mirrormount.device.settings import SETTINGS

ROOT = Path(__file__).parent.parent.parent
README = (ROOT / "README.md").read_text()
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
OF_EXTRAS = ("cv2", "h5py", "matplotlib", "nicegui", "numpy", "segno")  # what the extras bring, as it is imported
ASKED_FOR = re.compile(r'pip install .*\[([a-z,]+)\]"')
UNTIL_CTRL_C = ("panel", "serve")
# what is shown in mrad says whose angle it is: the beam turns about twice as far as the mirror
SAYS = {"measure": ("urad of the beam", "mrad a step (of the mirror)")}
ANSWERS = {"setup": "yes\nright\nup\nnone\nnone\nno\nno\n0\nno\n"}


def test_the_ten_lines_of_the_readme_run(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert code.count('"virtual://"') == 1
    exec(compile(code.replace("virtual://", "virtual://?speed=max"), "README.md", "exec"), {})
    assert capsys.readouterr().out == "5.0 unknown\n"


def shell_lines() -> list[str]:
    blocks = re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
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
def test_every_command_of_the_readme_works_in_its_order_on_the_readmes_board(tmp_path):
    for words in commands():
        status, said = run(words, tmp_path, port())
        assert status == 0 or (status == 130 and words[0] in UNTIL_CTRL_C), (words, status, said)
        assert "Traceback" not in said, said
        assert all(part in said for part in SAYS.get(words[0], ())), said


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent as a POSIX signal")
def test_the_readme_installs_the_extras_that_its_commands_ask_for(tmp_path):
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
    assert re.findall(r'`\$env:MIRRORMOUNT_PORT="(.*)"`', README) == [port()]


def test_the_pages_of_pydoc_that_the_readme_names_have_all_of_a_mount_and_its_axes():
    pages = [pydoc.plain(pydoc.render_doc(name)) for name in re.findall(r"`python -m pydoc ([\w.]+)`", README)]
    for name in ("step", "jog", "home", "move_to", "zero", "position", "save", "apply", *SETTINGS):
        assert any(re.search(rf"^ \|  {name}\b", page, re.MULTILINE) for page in pages), name
