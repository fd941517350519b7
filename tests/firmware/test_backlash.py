"""Take-up of the backlash, soft limits. Runs under CPython and MicroPython."""

from rig import Rig

STEP_US = 200_000
GAP_US = 120_000


def with_gap(setup=b""):
    """A rig whose axis 1 has its gap taken up in the positive direction, and no pulses on record."""
    rig = Rig()
    rig.ask(b"1VA4;1XB%d;1DH0;1PR1\n" % GAP_US)
    rig.run(400_000)
    rig.ask(setup)
    return rig


def pulses(rig, line, us=2_000_000):
    """On-times that a line makes on axis 1, rounded to the millisecond."""
    rig.port.edges.clear()
    rig.ask(line)
    rig.run(us)
    return [(t + 500) // 1000 for t in rig.on_times(2)]


def test_nothing_is_taken_up_before_the_gap_is_found():
    rig = Rig()
    rig.ask(b"1VA4;1XB300000\n")
    assert pulses(rig, b"1PR1\n") == [200]
    assert pulses(rig, b"1PR-1\n") == [200]
    assert pulses(rig, b"1PR-1\n") == [200]  # 400 ms in one direction: now it is
    assert pulses(rig, b"1PR1\n") == [300, 200]


def test_a_reversal_takes_up_the_gap_first_and_only_then():
    rig = with_gap()
    assert pulses(rig, b"1PR1\n") == [200]
    assert pulses(rig, b"1PR-2\n") == [120, 200, 200]
    assert pulses(rig, b"1PR-1\n") == [200]
    assert pulses(rig, b"1PR1\n") == [120, 200]
    assert rig.ask(b"1TP?;1XE?\n").startswith(b"0; 1,1,3")  # no part of it counts as a step


def test_the_take_up_counts_as_on_time_and_not_as_a_step():
    rig = with_gap()
    pulses(rig, b"1PR-1\n")
    reason, steps, on_us = rig.ask(b"1XE?\n").split(b",")
    assert (reason, steps) == (b"1", b"-1")
    assert abs(int(on_us) - GAP_US - STEP_US) < 100
    assert rig.axis1.position.certainty == 1


def test_an_abort_in_the_gap_leaves_the_rest_of_it_to_be_taken_up():
    rig = with_gap()
    position = rig.axis1.position.millisteps
    rig.send(b"1PR-1\n")
    rig.send(b"!\n", after_us=50_000)
    rig.run(400_000)
    assert rig.axis1.position.millisteps == position
    assert rig.axis1.position.certainty == 1  # the mirror has not moved
    (cut_us,) = rig.on_times(2)[-1:]
    assert pulses(rig, b"1PR-1\n")[0] == (GAP_US - cut_us + 500) // 1000
    # and back again: what was taken up one way is what is to be taken up the other way
    assert pulses(rig, b"1PR1\n") == [120, 200]


def test_two_reversals_inside_the_gap_take_up_just_what_is_needed():
    rig = with_gap()
    rig.send(b"1PR-1\n")
    rig.send(b"!\n", after_us=50_000)
    rig.run(400_000)
    cut_us = rig.on_times(2)[-1]
    assert pulses(rig, b"1PR1\n") == [(cut_us + 500) // 1000, 200]


def test_runs_and_frames_move_in_the_gap_like_steps():
    rig = with_gap()
    position = rig.axis1.position.millisteps
    rig.ask(b"-2550000\n")
    rig.run(10_000)
    rig.ask(b"!\n")
    on_us = rig.axis1.ended_on_us
    assert rig.axis1.position.millisteps == position
    assert pulses(rig, b"1PR-1\n")[0] == (GAP_US - on_us + 500) // 1000
    rig.ask(b"1MV+\n")
    rig.run(400_000)
    rig.ask(b"!\n")
    counted = rig.axis1.position.millisteps - (position - 1000)
    assert abs(counted - (rig.axis1.ended_on_us - GAP_US) * 1000 // STEP_US) <= 1
    assert pulses(rig, b"1PR1\n") == [200]


def test_a_run_at_half_duty_takes_twice_as_long_through_the_gap():
    rig = with_gap(b"1XV51\n")
    position = rig.axis1.position.millisteps
    rig.ask(b"1MV-\n")
    rig.run(4 * GAP_US)
    rig.ask(b"!\n")
    assert rig.axis1.position.millisteps == position
    left = GAP_US - rig.axis1.ended_on_us // 5
    assert pulses(rig, b"1PR-1\n")[0] == (left + 500) // 1000


def test_a_new_gap_is_to_be_found_again():
    rig = with_gap()
    rig.ask(b"1XB100000\n")
    assert pulses(rig, b"1PR-1\n") == [200]
    assert pulses(rig, b"1PR1\n") == [100, 200]


def test_the_gap_that_is_set_in_mid_move_is_the_next_moves():
    rig = with_gap()
    rig.send(b"1PR-1\n")
    rig.send(b"1XB0\n", after_us=10_000)
    rig.port.edges.clear()
    rig.run(1_000_000)
    assert [(t + 500) // 1000 for t in rig.on_times(2)] == [120, 200]
    assert pulses(rig, b"1PR1\n") == [200]


def test_an_inverted_axis_keeps_its_place_in_the_gap():
    rig = with_gap(b"1XI1\n")
    assert pulses(rig, b"1PR-1\n") == [200]
    assert pulses(rig, b"1PR1\n") == [120, 200]


def test_no_limit_of_time_cuts_a_move_or_its_take_up():
    rig = with_gap(b"1XT1;1XM1\n")
    assert pulses(rig, b"1PR-2\n") == [120, 200, 200]
    assert rig.errors() == []


def test_a_target_beyond_a_soft_limit_is_refused():
    rig = Rig()
    rig.ask(b"1DH0;1ZH8;1SL-2;1SR3;1VA4\n")
    for line, error in ((b"1PR4\n", 106), (b"1PA4\n", 106), (b"1PR-3\n", 107), (b"1PA-3\n", 107)):
        assert pulses(rig, line) == []
        assert rig.errors() == [error]
    assert len(pulses(rig, b"1PA3\n")) == 3
    rig.ask(b"1ZH0\n")
    assert len(pulses(rig, b"1PR1\n")) == 1


def test_a_run_ends_at_the_soft_limit_with_the_take_up_counted():
    rig = with_gap(b"1ZH8;1SL-2;1SR3\n")
    rig.ask(b"1MV-\n")
    rig.run(5_000_000)
    assert rig.errors() == [107]
    assert rig.ask(b"1XE?\n").startswith(b"5,")
    assert abs(rig.axis1.position.millisteps + 2000) <= 1
    assert abs(rig.axis1.ended_on_us - 3 * STEP_US - GAP_US) < 100
    assert pulses(rig, b"1MV-\n") == []
    assert rig.errors() == [107]
    rig.ask(b"1MV+\n")
    assert rig.drives() == (255, 0)


def test_frames_ignore_soft_limits():
    rig = Rig()
    rig.ask(b"1DH0;1ZH8;1SL0;1SR0\n")
    rig.ask(b"02550000\n")
    assert rig.drives() == (255, 0)


def test_a_frame_takes_over_in_the_gap_and_goes_on_from_there():
    rig = with_gap()
    position = rig.axis1.position.millisteps
    rig.send(b"1PR-1\n")
    rig.send(b"-2550000\n", after_us=50_000)  # the same way: 50 ms of the gap are behind it
    rig.send(b"!\n", after_us=150_000)
    rig.run(400_000)
    moved = position - rig.axis1.position.millisteps
    assert abs(moved - (150_000 - GAP_US) * 1000 // STEP_US) <= 15
