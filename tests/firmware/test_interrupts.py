"""Interrupts before any single bytecode of the firmware, on CPython: nothing is lost, nothing ends wrongly."""

import sys
from pathlib import Path

import pytest
from rig import Rig

import mountfw
from mountfw import codes

FOLDER = Path(mountfw.__file__).parent
MOTION = ("axis", "drive", "controller")
FILES = {
    str(FOLDER / "app.py"),
    *(str(FOLDER / "motion" / f"{name}.py") for name in MOTION),
}
seen: set[str] = set()
END_STOP = 10  # GPIO of axis 1's positive one


def interrupted(rig: Rig, passes: int, before: int) -> bool:
    """Run some passes with the end-stop opening before that bytecode. False if they have fewer."""
    count = 0

    def each_bytecode(_frame, event, _arg):
        nonlocal count
        if event == "opcode":
            count += 1
            if count == before:
                sys.settrace(None)
                rig.port.switches[END_STOP] = 1
                rig.port.handlers[END_STOP](None)
        return each_bytecode

    def trace(frame, _event, _arg):
        if frame.f_code.co_filename not in FILES:
            return None
        seen.add(frame.f_code.co_filename)
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        return each_bytecode

    sys.settrace(trace)
    try:
        for _ in range(passes):
            rig.step()
    finally:
        sys.settrace(None)
    return count >= before


@pytest.mark.parametrize(
    ("move", "after_us"),
    [
        (b"1MV+\n", 50_000),
        (b"1PR1\n", 50_000),
        pytest.param(b"1XP200000;1PR1\n", 196_900, marks=pytest.mark.full),
    ],
)
def test_an_end_stop_that_opens_before_any_bytecode_ends_the_move_as_an_end_stop(move, after_us):
    before = 0
    seen.clear()
    while True:
        before += 3
        rig = Rig()
        rig.port.switches[END_STOP] = 0
        rig.port.switches[11] = 0
        rig.ask(b"1XL3;1DH0\n")
        rig.send(move)
        rig.take_in()
        rig.port.horizon_us = rig.port.us + after_us
        while rig.port.us < rig.port.horizon_us:
            rig.step()
        assert rig.controller.driving()
        if not interrupted(rig, 2, before):
            break
        rig.run(5_000)
        assert rig.drives() == (0, 0), before
        ended_by_itself = rig.axis1.reason == codes.DONE and after_us > 100_000
        assert rig.axis1.reason == codes.END_STOP or ended_by_itself, before
        assert rig.errors() == ([] if ended_by_itself else [104]), before
        assert abs(rig.axis1.ended_on_us - rig.on_times(2)[0]) < 30, before
    assert before > 500
    assert seen >= FILES, "a file that is traced has another name now"
