"""A frame that comes in parts: the loop sleeps on for its rest, and nothing that is due is late."""

from lane_rig import LaneRig
from rig import Rig

ENABLES = (2, 5)


def test_a_last_byte_is_the_lanes_whenever_it_comes_after_the_others():
    missed = []
    for us in range(0, 2_000, 20):  # the first seven are looked at meanwhile
        rig = LaneRig()
        rig.ask(b"0100-100!\n")
        rig.run(200_000)
        before = rig.looks.taken
        rig.send(b"0255-25")
        rig.send(b"5", after_us=us)
        rig.run(20_000)
        if rig.looks.taken != before + 1:
            missed.append(us)
    assert missed == []


def test_each_byte_of_a_frame_may_come_alone_and_in_two_parts_at_any_place():
    for cut in range(1, 8):
        rig = LaneRig()
        rig.ask(b"0100-100!\n")
        rig.run(100_000)
        frame = b"-2550100"
        rig.send(frame[:cut])
        rig.run(20_000)
        taken = rig.looks.taken
        rig.send(frame[cut:])
        rig.settle()
        assert rig.drives() == (-255, 100) and rig.looks.taken == taken + 1, cut


def test_a_part_of_a_frame_does_not_end_the_sleep_and_its_rest_does():
    for make in (LaneRig, Rig):
        rig = make()
        rig.ask(b"0100-100!\n")
        rig.run(200_000)
        begun_us = rig.port.us + 1_000
        rig.send(b"0255-25", after_us=1_000)
        rig.send(b"5", after_us=31_000)
        rig.port.horizon_us = begun_us + 100_000
        rig.step()  # one pass
        assert 30_000 <= rig.port.us - begun_us < 33_000
        rig.run(5_000)
        assert rig.drives() == (255, -255)


def test_what_is_no_part_of_a_frame_ends_the_sleep():
    for make in (LaneRig, Rig):
        for data in (b"0255-2A", b"VE?", b"0!", b"02552550", b"+"):
            rig = make()
            rig.run(200_000)
            start_us = rig.port.us
            rig.send(data, after_us=1_000)
            rig.port.horizon_us = start_us + 100_000
            rig.step()
            assert (rig.port.us - start_us > 30_000) == (data == b"+"), data


def test_the_rest_of_a_line_is_no_part_of_a_frame():
    rig = Rig()
    rig.send(b"1PR")
    rig.run(20_000)
    rig.send(b"0", after_us=1_000)
    rig.port.horizon_us = rig.port.us + 100_000
    start_us = rig.port.us
    rig.step()
    assert rig.port.us - start_us < 10_000


def test_a_frame_that_drives_is_counted_at_once_though_a_part_of_the_next_has_come():
    rig = LaneRig()
    rig.ask(b"1XM10\n")
    rig.ask(b"0100-100!\n")
    rig.run(200_000)
    rig.port.edges.clear()
    rig.send(b"0255-25", after_us=5_000)
    rig.send(b"50100", after_us=7_000)
    rig.port.horizon_us = rig.port.us + 100_000
    while rig.port.us < rig.port.horizon_us:
        rig.step()
    (on_us, _), (off_us, _) = [(us, duty) for us, pin, duty in rig.port.edges if pin == ENABLES[0]][:2]
    assert off_us - on_us < 10_500


def test_a_part_of_a_frame_does_not_keep_the_loop_from_asking_whether_the_host_reads_again():
    rig = LaneRig()
    rig.ask(b"0100-100!\n")
    rig.run(3_000_000)
    rig.port.reading = False
    rig.send(b"*IDN?\n")
    rig.run(200_000)
    start_us = rig.port.us
    rig.send(b"0255-25", after_us=1_000)
    rig.port.horizon_us = start_us + 100_000
    rig.step()
    assert rig.port.us - start_us < 10_000


def test_a_pulse_ends_on_time_while_the_loop_sleeps_on_for_the_rest_of_a_frame():
    for make in (LaneRig, Rig):
        rig = make()
        rig.ask(b"1XP30000\n")
        rig.port.edges.clear()
        rig.send(b"1PR1\n")
        rig.send(b"0255-25", after_us=10_000)
        rig.run(200_000)
        lengths = [
            fall - rise
            for (rise, pin, duty), (fall, _, low) in zip(rig.port.edges, rig.port.edges[1:])
            if pin == 2 and duty and not low
        ]
        assert len(lengths) == 1 and abs(lengths[0] - 30_000) <= 5, lengths


def test_the_gap_after_a_part_of_a_frame_is_as_long_as_without_the_sleep():
    for make in (LaneRig, Rig):
        rig = make()
        rig.ask(b"0100-100!\n")
        rig.run(200_000)
        start_us = rig.port.us
        rig.port.horizon_us = start_us + 1_000_000
        rig.send(b"0255-25")
        while not rig.app.controller.errors.waiting:
            rig.step()
        assert 50_000 <= rig.port.us - start_us < 52_000
