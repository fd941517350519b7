"""The core with a port's gate: it cuts first, the parser tells, and both agree. The gate is gate_rig.py's."""

import random

from gate_rig import GatedRig
from rig import Rig

from mountfw import codes

ENABLES = (2, 5)


def reasons(rig):
    return [axis.reason for axis in rig.axes]


def parsed(rig):
    return rig.app.gated.received - rig.app._receiver.stops_ahead


def hang(rig, us):
    """The loop stands still."""
    rig.port.us += us
    rig.gate.run()


def test_a_stop_is_cut_when_it_lands_and_told_when_it_is_parsed():
    rig = GatedRig()
    rig.send(b"02550255")
    rig.settle()
    assert rig.drives() == (255, 255)
    rig.send(b"!")
    hang(rig, 0)
    assert rig.drives() == (0, 0) and rig.controller.moving()
    rig.settle()
    assert reasons(rig) == [codes.ABORTED] * 2
    rig.send(b"0255-100")
    rig.settle()
    assert rig.drives() == (255, -100)


def test_the_on_time_ends_where_the_gate_has_cut():
    rig = GatedRig()
    rig.send(b"0255")
    rig.send(b"0000")
    rig.settle()
    on_at = [us for us, pin, duty in rig.port.edges if pin == 2 and duty][-1]
    rig.send(b"!", after_us=40_000)
    cut_at = rig.now() + 40_000
    rig.run(30_000)
    hang(rig, 300_000)
    rig.settle()
    assert abs(rig.axis1.ended_on_us - (cut_at - on_at)) < 20


def test_a_drive_ends_at_its_deadline_while_the_loop_hangs():
    rig = GatedRig()
    rig.send(b"1XP90000;1PR1;2XM70\n")
    rig.settle()
    rig.send(b"0000")
    rig.run(10_000)
    hang(rig, 1_000_000)
    (on_us,) = rig.on_times(2)
    assert abs(on_us - 90_000) < 20
    rig.settle()
    assert rig.axis1.position.millisteps == 1000


def test_a_run_limit_ends_a_run_while_the_loop_hangs():
    rig = GatedRig()
    rig.send(b"1XM70;2XM90\n")
    rig.settle()
    rig.send(b"02550100")
    rig.run(5_000)
    hang(rig, 1_000_000)
    assert [round(rig.on_times(pin)[0], -2) for pin in ENABLES] == [70_000, 90_000]
    rig.settle()
    assert reasons(rig) == [codes.RUN_LIMIT] * 2
    assert [round(axis.ended_on_us, -2) for axis in rig.axes] == [70_000, 90_000]


def test_frames_before_an_unparsed_stop_never_drive():
    rig = GatedRig()
    rig.send(b"0255" * 20 + b"!")
    rig.settle()
    assert not [edge for edge in rig.port.edges if edge[1] in ENABLES and edge[2]]
    assert not rig.controller.inhibited


def test_lost_bytes_count_as_a_stop_and_the_drives_are_released():
    rig = GatedRig()
    rig.send(b"02550255")
    rig.settle()
    rig.gate.look(0x21)  # a reset of the bus takes it before it reaches the input
    rig.run(40_000)
    assert rig.drives() == (0, 0) and rig.controller.moving()
    rig.run(40_000)
    assert reasons(rig) == [codes.ABORTED] * 2
    rig.send(b"02550255")
    rig.settle()
    assert rig.drives() == (255, 255)


def test_a_gate_that_stays_out_is_told_and_changes_nothing():
    rig = GatedRig()
    rig.app._leave(codes.ABORTED)
    rig.gate.place = 14
    rig.app.gated.enter()
    assert rig.ask(b"XH?\n").endswith(b",14\r\n")
    rig.send(b"02550255!")
    rig.settle()
    assert rig.gate.cuts == [] and reasons(rig) == [codes.ABORTED] * 2
    assert Rig().ask(b"XH?\n").endswith(b",0\r\n")


def test_the_gate_leaves_with_the_loop_after_the_motors_are_off():
    rig = GatedRig()
    assert rig.ask(b"XH?\n").endswith(b",1\r\n")
    rig.send(b"02550255")
    rig.settle()
    rig.app._leave(codes.ABORTED)
    assert not rig.gate.entered and rig.drives() == (0, 0) and not rig.port.forced


def test_gate_and_parser_never_disagree_under_fuzz():
    chosen = random.Random(5)
    words = (b"!", b"00000000", b"0000", b"000", b"0", b"02550255", b"-100+100", b"1PR2\n", b"XS?\n", b"1", b"\n", b"/")
    for _session in range(150):
        rig = GatedRig()
        for _part in range(chosen.randrange(1, 30)):
            sent = b"".join(chosen.choice(words) for _ in range(chosen.randrange(1, 6)))
            rig.send(sent, after_us=chosen.choice((0, 50, 400, 3_000)), gap_us=chosen.choice((0, 0, 7, 90)))
            for _pass in range(chosen.randrange(0, 12)):
                rig.step()
                check(rig)
            rig.take_in()
        rig.run(2_000_000)
        check(rig)
        assert rig.gate.stops == parsed(rig)
        assert not rig.port.forced and not rig.controller.inhibited


def check(rig):
    """What a stop has cut stays low until the parser has told as many stops as the gate has found."""
    if rig.gate.stops != parsed(rig):
        assert rig.drives() == (0, 0)
