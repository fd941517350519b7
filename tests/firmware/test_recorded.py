"""Positions over a restart. Runs under CPython and MicroPython."""

from mountfw import codes

from rig import Rig  # isort: skip
from rig_recorded import FILE, MOTIONS, RECORDED_US, REST_US, certainty, known, recorded, restart, rises  # isort: skip

EN1, EN2 = 2, 5


def assert_right_or_unknown(rig):
    """After a power cut now: each axis knows where it is, or that it does not."""
    again = restart(rig)
    for axis, before in ((again.axis1, rig.axis1), (again.axis2, rig.axis2)):
        if axis.position.certainty:
            assert axis.position.millisteps == before.position_now()
    assert again.errors() == []
    return again


# ---- what is known again


def test_a_position_is_known_again_after_ten_seconds_of_rest_and_a_restart():
    rig = recorded()
    again = restart(rig)
    assert known(again) == known(rig)
    assert again.ask(b"1TP?;1PA?;1DH?;2TP?;2PA?;2DH?\n") == b"13; 13; 10; -5; -5; -3\r\n"
    assert certainty(again) == (codes.COUNTED, codes.COUNTED)
    assert again.errors() == []
    assert known(restart(again)) == known(rig)  # and it stays, for as long as nothing moves


def test_a_position_that_is_only_defined_is_known_again():
    rig = Rig()
    rig.ask(b"1DH10;2DH-3\n")
    rig.run(RECORDED_US)
    again = restart(rig)
    assert known(again) == known(rig)
    assert certainty(again) == (codes.COUNTED, codes.COUNTED)
    again.ask(b"2DH4\n")  # takes the record off
    again.run(RECORDED_US)
    assert restart(again).ask(b"1TP?;2TP?\n") == b"10; 4\r\n"


def test_an_estimate_stays_an_estimate():
    rig = recorded()
    rig.ask(b"1MV-\n")
    rig.run(333_000)
    rig.ask(b"!\n")
    rig.run(RECORDED_US)
    assert known(restart(rig)) == known(rig)
    assert certainty(restart(rig)) == (codes.ESTIMATED, codes.COUNTED)


def test_a_home_is_known_again():
    from test_homing import Track

    rig = Track(300_000)
    rig.ask(b"SM\n")
    assert rig.until_done(b"1OR\n") == codes.DONE
    rig.ask(b"1PR2\n")
    rig.run(1_000_000 + RECORDED_US)
    again = restart(rig)
    assert known(again) == known(rig)
    assert again.axis1.position.certainty == codes.HOMED
    assert again.axis1.position.home_known
    assert again.ask(b"1TP?\n") == b"2\r\n"


def pulses(rig, line):
    """On-times that a line makes on axis 1, in milliseconds."""
    rig.port.edges.clear()
    rig.ask(line)
    rig.run(1_000_000)
    return [(t + 500) // 1000 for t in rig.on_times(EN1)]


def test_a_reversal_after_the_restart_takes_up_just_the_gap():
    rig = Rig()
    rig.ask(b"1XB120000\n")
    rig.ask(b"SM\n")
    again = restart(recorded(rig=rig))
    assert pulses(again, b"1PR-1\n") == [120, 200]
    assert pulses(again, b"1PR-1\n") == [200]
    assert pulses(restart(recorded(rig=again)), b"1PR1\n") == [200]


def test_the_rest_of_a_gap_that_was_half_taken_up_is_taken_up_after_the_restart():
    rig = Rig()
    rig.ask(b"1XB120000\n")
    rig.ask(b"SM\n")
    recorded(rig=rig)
    rig.send(b"1PR-1\n")
    rig.send(b"!\n", after_us=100_000)  # 45 ms of which go to the flash
    rig.run(200_000 + RECORDED_US)
    cut_ms = (rig.on_times(EN1)[-1] + 500) // 1000
    assert 20 < cut_ms < 100
    assert known(restart(rig)) == known(rig)
    first, step = pulses(restart(rig), b"1PR-1\n")
    assert abs(first - (120 - cut_ms)) <= 1
    assert step == 200


def test_rst_at_rest_knows_the_recorded_position_again_and_in_motion_does_not():
    rig = recorded()
    knew = known(rig)
    rig.ask(b"*RST\n")
    assert known(rig) == knew
    assert rig.ask(b"1TP?;2TP?\n") == b"13; -5\r\n"
    rig.send(b"1PR9\n")
    rig.send(b"*RST\n", after_us=300_000)
    rig.run(600_000)
    assert certainty(rig) == (codes.UNKNOWN, codes.UNKNOWN)
    assert certainty(restart(rig)) == (codes.UNKNOWN, codes.UNKNOWN)


# ---- when it is recorded


def test_nothing_is_recorded_before_ten_seconds_of_rest():
    rig = Rig()
    rig.ask(b"1DH0\n")
    rig.ask(b"1PR1\n")
    while rig.axis1.moving():
        rig.run(1_000)
    ended_us = rig.now()
    rig.port.file_log.clear()
    rig.run(RECORDED_US)
    assert [entry[1:] for entry in rig.port.file_log] == [("store", FILE + ".new"), ("rename", FILE + ".new")]
    assert rig.port.file_log[0][0] >= ended_us + REST_US
    assert rig.port.file_log[1][0] < ended_us + RECORDED_US


def test_the_shortest_motion_begins_the_ten_seconds_anew():
    for motion in (b"1PR1\n", b"02550000!", b"1MV+;AB\n", b"0255000000000000"):
        rig = recorded(b"1XP200\nSM\n")
        rig.ask(b"1MV+;AB\n")
        rig.run(REST_US - 1_000_000)
        moved_us = rig.now()
        rig.ask(motion)
        rig.port.file_log.clear()
        rig.run(RECORDED_US)
        stored_us, what, _ = rig.port.file_log[0]
        assert what == "store"
        assert stored_us >= moved_us + REST_US, motion
        assert known(restart(rig)) == known(rig)


def test_nothing_is_recorded_while_an_axis_moves():
    rig = Rig()
    rig.ask(b"1XM400000;2VA0.05;1DH0;2DH0\n")
    for line in (b"1MV+\n", b"2PR3\n"):
        rig.ask(line)
        rig.port.file_log.clear()
        rig.run(3 * REST_US)
        assert rig.controller.moving()
        assert rig.port.file_log == []
        rig.ask(b"!\n")
        rig.run(RECORDED_US)
        assert known(restart(rig)) == known(rig)


def test_nothing_is_recorded_while_a_line_is_unfinished():
    rig = Rig()
    rig.ask(b"1DH7\n")
    rig.run(REST_US - 500_000)
    for c in b"1TP?;1TP?":
        rig.send(bytes([c]))
        rig.run(900_000)
    assert rig.port.file_log == []
    assert rig.ask(b"\n") == b"7; 7\r\n"
    rig.run(1_000_000)
    assert known(restart(rig)) == known(rig)


def test_nothing_is_recorded_while_answers_wait():
    rig = Rig()
    rig.ask(b"1DH7\n")
    rig.port.reading = False
    rig.ask(b"*IDN?\n")
    rig.run(3 * REST_US)
    assert rig.port.file_log == []
    rig.port.reading = True
    rig.run(1_000_000)
    assert known(restart(rig)) == known(rig)


def test_at_most_one_record_in_ten_seconds_whatever_comes():
    import random

    random.seed(3)
    lines = (b"1PR1\n", b"1XP200;1PR1\n", b"02550255!", b"1DH4\n", b"SM\n", b"*RST\n", b"1MV+\n", b"!\n", b"*RCL1\n")
    rig = Rig()
    for _ in range(150):
        rig.ask(random.choice(lines))
        rig.run(random.choice((1_000, 50_000, 700_000, 9_900_000, 10_100_000, 11_000_000)))
    times = [us for us, what, name in rig.port.file_log if what == "store" and name == FILE + ".new"]
    assert len(times) > 10
    assert min([b - a for a, b in zip(times, times[1:])]) >= REST_US


# ---- gone before anything drives


def test_the_record_is_gone_before_the_first_pin_rises():
    for motion in MOTIONS + (b"1MT+\n", b"2MT-\n", b"1OR\n", b"2OR\n"):
        for again in (False, True):
            rig = recorded(b"1XL3;2XL3\n")
            if again:
                rig = restart(rig)
                rig.ask(b"1XL3;2XL3\n")
            for pin in (10, 11, 12, 13):
                rig.port.switches[pin] = 0
            rig.port.edges.clear()
            rig.port.file_log.clear()
            rig.ask(motion)
            rig.run(100_000)
            gone_us, what, name = rig.port.file_log[0]
            assert (what, name) == ("remove", FILE)
            assert gone_us < min(rises(rig)), motion
            assert len(rig.port.file_log) == 1


def test_a_refused_motion_and_one_of_no_length_leave_the_record():
    rig = recorded()
    knew = known(rig)
    rig.ask(b"1PR0\n1PA13\n1PR9999999\n3PR1\n1PR\n00000000!\n")
    rig.run(100_000)
    assert FILE in rig.port.files
    assert known(restart(rig)) == knew


def test_after_a_power_cut_in_a_motion_the_position_is_unknown():
    for motion in MOTIONS:
        rig = recorded()
        rig.port.edges.clear()
        rig.send(motion)
        while not rises(rig):
            rig.step()
        for _ in range(40):
            rig.run(25_000)
            assert certainty(restart(rig)) == (codes.UNKNOWN, codes.UNKNOWN), motion
        rig.ask(b"!\n")
        rig.run(RECORDED_US)
        assert known(restart(rig)) == known(rig)


def test_what_moves_or_counts_anew_while_the_record_is_being_written_is_not_forgotten():
    for line in (b"1DH5\n", b"1PR1\n", b"02550000!", b"1MV-;AB\n", b"*RST\n", b"1XI1\n", b"SM\n"):
        for us in range(9_960_000, 10_200_000, 6_000):
            rig = Rig()
            rig.ask(b"1XP200;2XP200\n")
            rig.ask(b"SM\n")
            rig.run(200_000)
            rig.ask(b"1DH9;2DH9\n")
            rig.run(us)
            rig.send(line)
            rig.run(400_000)
            if line == b"1XI1\n":  # is not saved, so the old sign is the right one after a restart
                rig.ask(b"1XI0\n")
            assert_right_or_unknown(rig)


def test_a_stop_that_comes_while_the_record_goes_keeps_the_motor_off():
    for motion in (b"1PR1\n", b"1MV+\n", b"02550000"):
        rig = recorded()
        rig.port.edges.clear()
        rig.send(motion)
        rig.send(b"!\n", after_us=20_000)
        rig.run(400_000)
        assert rises(rig) == []
        assert rig.axis1.reason == codes.ABORTED
        assert rig.axis1.position.millisteps == 13_000


# ---- what counts anew


def test_a_position_that_was_defined_anew_is_not_the_recorded_one():
    rig = recorded()
    rig.ask(b"1DH5\n")
    rig.run(60_000)
    assert certainty(restart(rig)) == (codes.UNKNOWN, codes.UNKNOWN)
    rig.run(RECORDED_US)
    assert restart(rig).ask(b"1TP?;2TP?\n") == b"5; -5\r\n"
    assert known(restart(rig)) == known(rig)


def test_another_step_that_was_not_saved_leaves_the_old_step_and_the_old_position():
    for line in (b"1XP100000\n", b"1XD100\n", b"1XI1\n"):
        rig = recorded()
        knew = known(rig)
        rig.ask(line)
        rig.run(RECORDED_US)
        assert known(restart(rig)) == knew


def test_another_step_that_was_saved_makes_the_position_an_estimate_or_unknown():
    for line in (b"1XP100000\n", b"1XD100\n"):
        rig = recorded()
        rig.ask(line + b"SM\n")
        rig.run(300_000)
        assert certainty(restart(rig)) == (codes.UNKNOWN, codes.UNKNOWN)
        rig.run(RECORDED_US)
        assert known(restart(rig)) == known(rig)
        assert certainty(restart(rig)) == (codes.ESTIMATED, codes.COUNTED)


def test_an_inverted_axis_knows_its_position_with_the_other_sign_once_that_is_saved():
    rig = recorded()
    rig.ask(b"1XI1\nSM\n")
    rig.run(300_000)
    assert certainty(restart(rig)) == (codes.UNKNOWN, codes.UNKNOWN)
    rig.run(RECORDED_US)
    assert restart(rig).ask(b"1TP?;2TP?\n") == b"-13; -5\r\n"


def test_a_record_of_other_steps_than_the_saved_ones_is_not_believed():
    for line in (b"1XP100000\n", b"1XD100\n", b"1XI1\n"):
        rig = recorded()
        rig.ask(line)
        rig.ask(b"1PR1;2PR1\n")
        rig.run(1_000_000 + RECORDED_US)
        assert FILE in rig.port.files
        assert certainty(restart(rig)) == (codes.UNKNOWN, codes.COUNTED)


def test_another_gap_leaves_the_position_and_is_to_be_found_again():
    rig = Rig()
    rig.ask(b"1XB120000\n")
    recorded(rig=rig)
    again = restart(rig)  # its gap was not saved
    assert again.axis1.position.millisteps == 13_000
    assert again.axis1.position.certainty == codes.COUNTED
    again.ask(b"1XB120000\n")
    assert pulses(again, b"1PR-1\n") == [200]
