"""tools/bench/soak.py on the emulated board: that it runs and reports. What it finds is for its report."""

import pytest
import soak

from mirrormount.errors import EmulatorMissing
from mirrormount_sim import emulator

pytestmark = pytest.mark.full


def test_an_episode_is_reported(tmp_path):
    try:
        emulator.command()
    except EmulatorMissing as e:
        pytest.skip(str(e))
    file = tmp_path / "soak.md"
    soak.main(["--seed", "1", "--episode", "1", "--report", str(file)])
    text = file.read_text(encoding="utf-8")
    assert "| episodes | 1 |" in text
    assert "| resets | 0 |" in text
    assert "| ended early |" not in text
