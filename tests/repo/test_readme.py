"""The README's Python lines and shell commands do what they say."""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent.parent / "README.md").read_text()
UNTIL_CTRL_C = ("panel", "serve")
# what is shown in mrad says whose angle it is: the beam turns about twice as far as the mirror
SAYS = {"measure": ("urad of the beam", "mrad a step (of the mirror)")}
ANSWERS = {"setup": "yes\nright\nup\nnone\nnone\n0\nno\n"}


def test_the_ten_lines_of_the_readme_run(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert code.count('"virtual://"') == 1
    exec(compile(code.replace("virtual://", "virtual://?speed=max"), "README.md", "exec"), {})
    assert capsys.readouterr().out == "5.0 unknown\n"


def shell_lines() -> list[str]:
    blocks = re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    return [line.partition(" #")[0].strip() for block in blocks for line in block.splitlines()]


def run(words: list[str], folder: Path, port: str) -> tuple[int, str]:
    """The exit status of a command, and all that it printed. A server gets Ctrl-C when it has said its first line."""
    serves = words[0] in UNTIL_CTRL_C
    if not serves:
        port += "&speed=max"
    process = subprocess.Popen(
        [sys.executable, "-m", "mirrormount", *words],
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
    lines = shell_lines()
    (port,) = re.findall(r'export MIRRORMOUNT_PORT="(.*)"', "\n".join(lines))
    commands = [shlex.split(line)[1:] for line in lines if line.startswith("mirrormount ")]
    assert len(commands) >= 14
    for words in commands:
        status, said = run(words, tmp_path, port)
        assert status == 0 or (status == 130 and words[0] in UNTIL_CTRL_C), (words, status, said)
        assert "Traceback" not in said, said
        assert all(part in said for part in SAYS.get(words[0], ())), said
