"""The command that installs an optional part is for the Python that runs."""

import sys
from pathlib import Path

import pytest

from mirrormount.terminal import install_command

COPY = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("python", "first", "words"),
    [
        ("bin/python", "bin", "python"),
        ("bin/python", "other", "bin/python"),
        ("my venv/python", "other", '"my venv/python"'),
    ],
)
def test_the_python_that_runs_is_named_as_short_as_a_shell_finds_it(tmp_path, monkeypatch, python, first, words):
    for folder in ("bin", "other", "my venv"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "python").touch(mode=0o755)
        (tmp_path / folder / "python.exe").touch(mode=0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path / first))
    monkeypatch.setattr(sys, "executable", str(tmp_path / python))
    assert install_command("panel") == f'{words} -m pip install -e "{COPY}[panel]"'


def test_a_python_elsewhere_is_named_with_its_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", "")
    assert install_command("panel") == f'{sys.executable} -m pip install -e "{COPY}[panel]"'
