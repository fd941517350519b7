"""tools/bench on the emulated board: that it measures. How fast the firmware is, no test says."""

import json
import math

import pytest
import run
from lab import USB_US, Lab

from mirrormount.errors import EmulatorMissing
from mirrormount_sim import emulator

pytestmark = pytest.mark.full


@pytest.fixture(autouse=True)
def _machine():
    try:
        emulator.command()
    except EmulatorMissing as e:
        pytest.skip(str(e))


def test_two_rows_give_a_table_and_json(tmp_path, capsys):
    file = tmp_path / "bench.json"
    assert run.main(["--n", "3", "--only", "stop-run,pulse-shortest", "--json", str(file)]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("mirrormount,Raspberry Pi Pico,")
    assert len([line for line in out.splitlines() if line.startswith("| ")]) == 3
    assert "stop-run: " in err
    told = json.loads(file.read_text(encoding="utf-8"))
    assert len(told["firmware"]) == 64 and told["image"]
    assert [row["name"] for row in told["rows"]] == ["stop-run", "pulse-shortest"]
    for row in told["rows"]:
        assert row["n"] == len(row["values"]) == 3
        assert all(math.isfinite(value) for value in row["values"])


def test_a_packet_lands_once_the_board_has_asked_for_it():
    waited_us = []
    with Lab("landing", 1) as lab:
        board = lab.board()
        board.run(50_000)
        for line in (b"1XP?\n", b"2XP?\n"):
            given_us = board.us
            waited_us.append(board.land(line) - given_us)
    first, second = waited_us
    assert first == USB_US  # the board was ready for it
    assert second > USB_US  # its USB stack was still at the packet before
