"""The thin host where no extra is installed: NumPy, OpenCV and the web panel's packages cannot be imported."""

import subprocess
import sys

import pytest
from served import HANG_S

from mirrormount.cli import main

WITHOUT = "import sys; sys.modules.update(dict.fromkeys(('cv2', 'h5py', 'matplotlib', 'nicegui', 'numpy', 'scipy')))\n"
IMPORT_ALL = """
import importlib, pkgutil, mirrormount
names = [module.name for module in pkgutil.walk_packages(mirrormount.__path__, "mirrormount.")]
for name in names:
    if not name.endswith("__main__"):
        importlib.import_module(name)
print(len(names))
"""
RUN = "from mirrormount.__main__ import run\nsys.exit(run())\n"


def python(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-c", WITHOUT + code, *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=HANG_S)


def test_every_module_of_the_thin_host_can_be_imported():
    done = python(IMPORT_ALL)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 30


def test_the_help_lists_the_commands_of_all_packages():
    done = python(RUN, "--help")
    assert done.returncode == 0, done.stderr
    listed = done.stdout.split()
    assert {*main.MODULES, "virtual", "measure", "hold", "panel"} <= set(listed)


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        ("hold --virtual", "beam"),
        ("measure steps", "beam"),
        ("panel", "panel"),
        ("virtual", "sim"),
        ("step x 1 --port virtual://", "sim"),
    ],
)
def test_what_needs_an_extra_names_it_in_one_line(words, extra):
    done = python(RUN, *words.split())
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("mirrormount: ") and done.stderr.count("\n") == 1
    assert f"[{extra}" in done.stderr and "pip install" in done.stderr
