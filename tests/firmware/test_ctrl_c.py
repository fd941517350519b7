"""Ctrl-C comes while the loop looks at its input, wherever that is: the drive is counted, or the position unknown."""

import sys
from dis import opname

import pytest
from rig import Rig
from rig_encoder import encoded

from mountfw import codes

HIT = 10  # GPIO of axis 1's positive end-stop
PER_MS = 5  # millisteps, at pulses of 200 ms
NEAR = 30  # millisteps: what a bridge and a clock of the rig take


def in_a_run(rig):
    """A run shortly before it is counted, as it is each second."""
    rig.send(b"1MV+\n")
    rig.run(985_000)


def asked(rig):
    """A run whose position is asked for."""
    rig.send(b"1MV+\n")
    rig.run(300_000)
    rig.send(b"1TP?;XS?\n")


def at_the_end_stop(rig):
    """Homing, as the end-stop opens."""
    rig.port.switches.update({HIT: 0, HIT + 1: 0})
    rig.ask(b"1XL3\n")
    rig.send(b"1MT+\n")
    rig.run(300_000)
    rig.port.switches[HIT] = 1


def stopped(rig):
    """A run, as it is stopped."""
    rig.send(b"1MV+\n")
    rig.run(300_000)
    rig.send(b"1ST\n")


def leave_at(rig, number) -> bool:
    """Ctrl-C at look `number`, counted from now. False if the next 40 ms have fewer."""
    look, looks = rig.app._input.read, 0

    def interrupted(most, wait_ms):
        nonlocal looks
        looks += 1
        if looks == number:
            raise KeyboardInterrupt
        return look(most, wait_ms)

    rig.app._input.read = interrupted
    try:
        rig.run(40_000)
    except KeyboardInterrupt:
        rig.app._input.read = look
        rig.app._leave(codes.ABORTED)
        return True
    return False


@pytest.mark.parametrize("begin", [in_a_run, asked, at_the_end_stop, stopped])
def test_what_has_driven_is_counted_or_the_position_is_unknown(begin):
    known = 0
    for number in range(1, 120):
        rig = Rig()
        rig.ask(b"1DH0;1XM60000\n")
        begin(rig)
        if not leave_at(rig, number):
            break
        assert rig.drives() == (0, 0)
        position = rig.axis1.position
        if position.certainty:
            known += 1
            assert abs(position.millisteps - PER_MS * sum(rig.on_times(2)) / 1000) < NEAR, number
    assert known >= 5


def leave_at_jump(rig, number, action) -> bool:
    """Ctrl-C at a jump in what a position does with its encoder's counts. False if there are fewer."""
    jumps = 0

    def each(frame, event, _argument):
        nonlocal jumps
        if event == "opcode" and "JUMP" in opname[frame.f_code.co_code[frame.f_lasti]]:
            jumps += 1
            if jumps == number:
                raise KeyboardInterrupt
        return each

    def trace(frame, _event, _argument):
        if not frame.f_code.co_filename.endswith("encoder/position.py"):
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        return each

    sys.settrace(trace)
    try:
        action()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(None)
    return False


@pytest.mark.parametrize("counts", [50, 700, -700])
def test_what_an_encoder_has_turned_is_counted_whole_or_not_yet(counts):
    for number in range(1, 60):
        rig = encoded()
        rig.ask(b"1DH0\n")
        position = rig.axis1.position
        before = position.motor
        rig.motor1.at += counts
        left = leave_at_jump(rig, number, position.look)
        position.look()
        assert (position.motor - before, position.in_counts(), position.certainty) == (counts, counts, codes.MEASURED)
        assert position.millisteps == (counts * 1000 + 140) // 280
        if not left:
            break
    assert number > 3


@pytest.mark.parametrize("counts", [30, -43, 700])
def test_what_went_through_the_gap_is_right_or_an_estimate(counts):
    whole = 0
    for number in range(1, 60):
        rig = encoded(settings=b"XN280;MM1;XB60000")  # a gap of 84 counts
        rig.ask(b"1DH0\n")
        position = rig.axis1.position
        rig.motor1.at += 200
        position.look()
        rig.motor1.at -= 40  # into the gap, which is known now
        position.look()
        before = position.in_counts()
        rig.motor1.at += counts
        left = leave_at_jump(rig, number, position.look)
        position.look()
        if position.certainty == codes.MEASURED:
            whole += 1
            inside = 44 + counts
            assert position.in_counts() - before == (inside - 84 if inside > 84 else min(inside, 0))
        if not left:
            break
    assert whole and number > 3


def test_counts_that_a_sensor_has_lost_are_told_though_a_ctrl_c_comes_as_they_are_seen():
    for number in range(1, 60):
        rig = encoded()
        rig.ask(b"1DH0\n")
        rig.motor1.slips += 1
        left = leave_at_jump(rig, number, rig.axis1.position.look)
        rig.axis1.position.look()
        assert rig.axis1.position.certainty == codes.ESTIMATED
        if not left:
            break
    assert number > 2
