"""The instrument of pymeasure in docs/examples, on a virtual board: pins and positions."""

import sys
from pathlib import Path

import pytest
from served import ServedBoard, wait_for

pytest.importorskip("pymeasure", reason="pymeasure is not installed here")
sys.path.insert(0, str(Path(__file__).parents[2] / "docs/examples"))

from pymeasure_mount import MirrorMount


def test_an_instrument_of_pymeasure_steps_stops_and_tells_what_ended_early(tmp_path):
    with ServedBoard(tmp_path / "board") as board, MirrorMount(str(board.link)) as mount:
        assert mount.identity[0] == "mirrormount"
        mount.x.step(3)
        mount.x.move_to(1)
        assert (mount.x.position, mount.y.position, mount.x.moving) == (1, 0, False)
        off = [edge for edge in board.edges() if edge["pin"] == "m2_en" and edge["duty"] == 0]
        assert len(off) == 3 + 2
        mount.x.write("XK500;2PR50")
        wait_for(board.driving, "a motor to run")
        mount.stop()
        assert not mount.x.moving
        assert not board.driving()
        with pytest.raises(RuntimeError, match="reason"):
            mount.x.step(2_000_000)  # beyond the range: nothing moves
        assert not board.driving()
