"""The emulator's fast way through the instructions (virtual/rp2040/execute.mjs) does what rp2040js does."""

import subprocess
from pathlib import Path

import pytest

from mirrormount.errors import EmulatorMissing
from mirrormount_sim import emulator

STATED = 65_000  # of 65,536 first half-words; the others are breakpoints, and one in which rp2040js is wrong


@pytest.mark.full
def test_every_instruction_leaves_the_state_that_rp2040js_leaves_in_the_same_time():
    try:
        node, main, *_ = emulator.command()
    except EmulatorMissing as e:
        pytest.skip(str(e))
    run = subprocess.run([node, str(Path(main).with_name("compare.mjs"))], capture_output=True, text=True, check=True)
    *lines, last = run.stdout.splitlines()
    assert not lines, lines[:10]
    compared, _, different, _ = last.split()
    assert int(compared) > STATED and different == "0"
