"""Pulses, runs, limits. Runs under CPython and MicroPython."""

from rig import Board, Rig

from mountfw.boards import pico_drv8833


def edges_of(rig, pins):
    return [(pin, duty) for _, pin, duty in rig.port.edges if pin in pins]


def test_a_step_is_one_pulse_of_its_length_and_steps_keep_their_period():
    rig = Rig()
    rig.ask(b"2PR4\n")
    rig.run(2_500_000)
    on_times = rig.on_times(5)
    assert len(on_times) == 4
    assert all(abs(us - 200_000) < 50 for us in on_times), on_times
    starts = [us for us, pin, duty in rig.port.edges if pin == 5 and duty]
    assert all(abs(b - a - 500_000) < 300 for a, b in zip(starts, starts[1:])), starts
    assert rig.ask(b"2TP?;2PA?;2PR?;2MD?\n") == b"4; 4; 4; 1\r\n"
    reason, steps, on_us = rig.ask(b"2XE?\n").split(b",")
    assert (reason, steps) == (b"1", b"4") and abs(int(on_us) - 800_000) < 200


def test_a_burst_of_input_does_not_hold_up_the_end_of_a_pulse():
    for burst in (8, 64, 256, 2000):
        for before_us in range(100, 4_000, 100):
            rig = Rig()
            rig.send(b"1PR1\n")
            rig.send(b"\n" * burst, after_us=200_150 - before_us)
            rig.take_in()
            rig.run(10_000)
            assert abs(rig.on_times(2)[0] - 200_000) < 100, (burst, before_us)


def test_a_new_velocity_counts_from_the_next_move_on():
    rig = Rig()
    rig.ask(b"1VA0.01;1PR1\n")
    rig.run(300_000)
    rig.ask(b"1VA2;1PR1\n")
    rig.run(500_000)
    assert len(rig.on_times(2)) == 2


def test_pulse_length_duty_and_velocity_are_the_axis_own():
    rig = Rig()
    rig.ask(b"1XP1000;1XD100;1VA50;1PR3;2PR1\n")
    rig.run(1_000_000)
    assert all(abs(us - 1000) < 50 for us in rig.on_times(2))
    assert len(rig.on_times(2)) == 3
    assert (2, 100 * 257) in edges_of(rig, (2,))
    assert abs(rig.on_times(5)[0] - 200_000) < 50


def test_a_negative_move_swaps_the_legs_and_inverting_swaps_them_back():
    for setup, legs in ((b"", (4, 65535)), (b"1XI1;", (3, 65535))):
        rig = Rig()
        rig.ask(setup + b"1PR-1\n")
        assert [e for e in edges_of(rig, (3, 4)) if e[1]] == [legs]


def test_inverting_keeps_the_spot_where_it_is():
    rig = Rig()
    rig.ask(b"1DH7;1XI1\n")
    assert rig.ask(b"1TP?;1XI?\n") == b"-7; 1\r\n"


def test_the_enable_drops_before_a_leg_changes_and_rises_after_the_dead_time():
    rig = Rig()
    rig.ask(b"02550000")
    start = len(rig.port.edges)
    rig.ask(b"-2550000")
    edges = rig.port.edges[start:]
    assert [(pin, duty) for _, pin, duty in edges] == [(2, 0), (3, 0), (4, 65535), (2, 65535)]
    assert edges[3][0] - edges[2][0] >= rig.board.DEAD_TIME_US > 0


def test_the_same_direction_again_changes_the_duty_without_a_gap():
    rig = Rig()
    rig.ask(b"02550000")
    start = len(rig.port.edges)
    rig.ask(b"01000000")
    assert [(pin, duty) for _, pin, duty in rig.port.edges[start:]] == [(2, 100 * 257)]


def test_a_two_pwm_bridge_drives_one_input_and_never_both():
    rig = Rig(Board(pico_drv8833))
    rig.ask(b"0100-255")
    assert rig.drives() == (100, -255)
    rig.ask(b"-100025!")
    assert rig.drives() == (0, 0)
    level = {3: 0, 4: 0, 6: 0, 7: 0}
    for _, pin, duty in rig.port.edges:
        level[pin] = duty
        assert not (level[3] and level[4]) and not (level[6] and level[7])


def test_a_run_ends_at_its_limit_and_says_so():
    rig = Rig()
    rig.ask(b"1XM300;1MV-\n")
    rig.run(1_000_000)
    assert rig.drives() == (0, 0)
    assert abs(rig.on_times(2)[0] - 300_000) < 100
    assert rig.ask(b"1XE?\n").split(b",")[0] == b"6"
    assert rig.errors() == [140]


def test_a_frame_ends_at_the_run_limit_and_another_frame_starts_it_anew():
    rig = Rig()
    rig.ask(b"1XM300\n02550000")
    for _ in range(5):
        rig.run(200_000)
        assert rig.drives() == (255, 0)
        rig.ask(b"02550000")
    rig.run(400_000)
    assert rig.drives() == (0, 0)


def test_a_run_counts_its_time_and_duty_as_an_estimate():
    rig = Rig()
    rig.ask(b"1DH0;1XV51;1MV+\n")
    rig.run(2_000_000)
    rig.ask(b"!\n")
    on_us = rig.axis1.ended_on_us
    assert abs(rig.axis1.position.millisteps - on_us * 51 // 255 // 200) <= 1
    assert rig.ask(b"XS?\n").split(b"|")[1].split(b",")[5] == b"3\r\n"[:1]


def test_whole_steps_after_a_reset_of_the_count_are_counted():
    rig = Rig()
    assert rig.axis1.position.certainty == 0
    rig.ask(b"1PR1\n")
    rig.run(300_000)
    assert rig.axis1.position.certainty == 0  # nobody knows where it began
    rig.ask(b"1DH0;1PR1\n")
    rig.run(800_000)
    assert rig.axis1.position.certainty == 1
    rig.ask(b"1XP100000\n")
    assert rig.axis1.position.certainty == 3  # a step is another thing now


def test_absolute_moves_from_a_fraction_make_the_nearest_whole_number_of_pulses():
    for millisteps, target, pulses in (
        (1400, 3, 2),
        (1500, 3, 2),
        (1600, 3, 1),
        (-1500, 0, 2),
        (-400, 0, 0),
        (500, 0, -1),
    ):
        rig = Rig()
        rig.axis1.position.millisteps = millisteps
        rig.ask(b"1PA%d\n" % target)
        assert rig.axis1.last_relative == pulses, millisteps


def test_a_zero_length_move_ends_once_and_drives_nothing():
    rig = Rig()
    rig.ask(b"1PR0;2PA0\n")
    assert rig.ask(b"1XE?;2XE?;1MD?\n") == b"1,0,0; 1,0,0; 1\r\n"
    assert rig.on_times(2) == []


def test_motion_commands_are_refused_while_the_axis_moves_and_the_other_axis_is_not_affected():
    rig = Rig()
    rig.ask(b"1MV+\n")
    rig.ask(b"1PR1;1PA1;1MV-;1DH5;1XI1;1XP500;1XL1;2MV-\n")
    assert rig.drives() == (255, -255)
    assert rig.errors() == [114] * 7
    rig.ask(b"1XD9;1XM20;1XV9;1VA1;1XT99\n")
    assert rig.errors() == []
    assert rig.drives() == (255, -255)  # these apply to the next move


def test_a_frame_takes_both_axes():
    rig = Rig()
    rig.ask(b"1PR5;2MV-\n")
    rig.ask(b"00500000")
    assert rig.drives() == (50, 0)
    assert rig.ask(b"2XE?\n").split(b",")[0] == b"8"
    rig.ask(ZERO)
    assert rig.ask(b"1XE?\n").split(b",")[0] == b"2"


ZERO = b"00000000"


def test_a_target_beyond_what_can_be_counted_is_refused():
    rig = Rig()
    rig.ask(b"1PR1000000;1PR-1000000;1PA1000000;1DH1000000\n")
    assert rig.errors() == [101] * 4
    rig.ask(b"1DH999999;1PR1\n")
    assert rig.errors() == [101]
    assert rig.drives() == (0, 0)


def test_a_move_over_the_whole_travel_is_accepted_whatever_time_it_takes():
    for settings in (b"\n", b"1XP2000000;1XT1;1XM1\n"):
        for here, there in ((999_999, -999_999), (-999_999, 999_999)):
            rig = Rig()
            rig.ask(settings)
            rig.ask(b"1DH%d;1PA%d\n" % (here, there))
            assert rig.errors() == []
            assert rig.drives() == (255 if there > here else -255, 0)
            assert rig.ask(b"1PA?;1MD?\n") == b"%d; 0\r\n" % there


def test_the_time_under_drive_of_a_long_move_is_counted_up_to_1000_seconds():
    rig = Rig()
    rig.ask(b"1XP2000000;1PR502\n")
    rig.run(1_030_000_000)
    assert rig.ask(b"1XE?\n") == b"1,502,1000000000\r\n"


def test_a_run_ends_at_the_edge_of_what_can_be_counted():
    rig = Rig()
    rig.ask(b"1DH999999;1MV+\n")
    rig.run(1_000_000)
    assert rig.drives() == (0, 0)
    assert rig.errors() == [101]


def test_the_way_back_from_the_edge_is_open():
    rig = Rig()
    rig.ask(b"1DH999999;1MV-\n")
    rig.run(100_000)
    assert rig.drives() == (-255, 0)
    rig.ask(b"!1DH-999999;1MV+\n")
    rig.run(100_000)
    assert rig.drives() == (255, 0)
    assert rig.errors() == []


def test_velocity_is_kept_in_hundredths_and_bounded_by_the_pulse():
    rig = Rig()
    assert rig.ask(b"1VA?;1VA0.05;1VA?;1VA2.5;1VA?\n") == b"2; 0.05; 2.5\r\n"
    rig.ask(b"1VA0;1VA-1;1VA0.001;1VA2000.01\n")
    assert rig.errors() == [7, 7, 7, 7]
    assert rig.ask(b"1VA?;1VA4.97;1VA?\n") == b"2.5; 4.97\r\n"
    assert rig.errors() == []


def test_a_velocity_above_what_the_pulses_allow_is_kept_and_what_is_possible_is_told():
    rig = Rig()
    assert rig.ask(b"1VA4.98;1VA?;1VA2000;1VA?\n") == b"4; 4\r\n"  # in whole steps, as drivers read them
    assert rig.errors() == [110, 110]
    assert rig.ask(b"1XP2000000;1VA?;1XP1000;1VA?;1XP200;1VA?\n") == b"0.49; 500; 833\r\n"
    assert rig.ask(b"1XP20000;1VA?\n") == b"47\r\n"
    assert rig.errors() == []


def test_steps_that_cannot_be_as_fast_as_set_are_as_fast_as_the_pulses_allow():
    rig = Rig()
    rig.ask(b"1XP20000;1VA2000;1PR4\n")
    rig.run(200_000)
    starts = [us for us, pin, duty in rig.port.edges if pin == 2 and duty]
    assert [20_900 < b - a < 22_500 for a, b in zip(starts, starts[1:])] == [True] * 3  # 47 a second


def test_every_parameter_is_checked_and_answered():
    for name, least, most, default in (
        (b"XP", 200, 2_000_000, 200_000),
        (b"XD", 1, 255, 255),
        (b"XV", 1, 255, 255),
        (b"XM", 1, 400_000, 10_000),
        (b"XT", 1, 400_000, 120_000),
        (b"XI", 0, 1, 0),
    ):
        rig = Rig()
        ask = b"2" + name + b"?\n"
        assert rig.ask(ask) == b"%d\r\n" % default, name
        for value in (least, most):
            rig.ask(b"2%s%d\n" % (name, value))
            assert rig.ask(ask) == b"%d\r\n" % value, name
        assert rig.errors() == [], name
        rig.ask(b"2%s%d;2%s%d;2%s1.5;2%s;2%s+\n" % (name, least - 1, name, most + 1, name, name, name))
        assert rig.errors() == [7, 7, 7, 38, 7], name
        assert rig.ask(ask) == b"%d\r\n" % most, name


def test_a_train_of_short_pulses_leaves_time_for_all_else():
    rig = Rig()
    rig.port.start_watchdog()
    rig.ask(b"1XP1000;2XP1000;1VA450;2VA450\n")
    rig.app._feed = rig.port.feed
    rig.send(b"1PR2000;2PR-2000\n")
    for _ in range(20):
        for _pass in range(5):
            before = rig.port.us
            rig.step()
            assert rig.port.us - before < 20_000  # a pass ends, though the next pulse is always near
        assert rig.port.us - rig.port.fed_at < 100_000
    rig.send(b"1MD?;2MD?\n")
    rig.run(300_000)
    assert bytes(rig.port.sent).endswith(b"0; 0\r\n")
    rig.send(b"ST\n")
    rig.run(300_000)
    assert not rig.controller.moving()


def test_status_tells_all_that_a_panel_polls():
    rig = Rig()
    rig.ask(b"2DH-3;2PR1\n")
    rig.run(600_000)
    head, one, two = rig.ask(b"XS?\n").strip().split(b"|")
    boot_id, uptime_ms, waiting = head.split(b",")
    assert boot_id == b"4711" and abs(int(uptime_ms) - rig.now() // 1000) < 30 and waiting == b"0"
    assert one == b"0,0,0,0,0,0"
    assert two == b"-2000,0,0,0,1,1"
    rig.ask(b"1MV-\nAT\n")
    head, one, two = rig.ask(b"XS?\n").strip().split(b"|")
    assert head.split(b",")[2] == b"1"
    assert one.split(b",")[1:3] == [b"1", b"-1"]
    assert rig.ask(b"1MV?;2MV?\n") == b"-; 0\r\n"


def test_a_frame_that_takes_over_a_pulse_leaves_it_counted():
    for frame, way in ((b"02550000", 1), (b"-2550000", -1)):
        rig = Rig()
        rig.ask(b"1DH0;1PR1\n")
        began = [us for us, pin, duty in rig.port.edges if pin == 2 and duty][-1]
        rig.run(100_000)
        rig.send(frame)
        rig.take_in()
        came = rig.now()
        rig.settle()
        reason, _, on_us = rig.ask(b"1XE?\n").split(b",")
        assert reason == b"8"
        assert abs(int(on_us) - (came - began)) < 1_000, frame
        rig.ask(b"!\n")
        driven_us = int(on_us) + way * rig.axis1.ended_on_us
        assert abs(rig.axis1.position.millisteps - driven_us / 200) < 5, frame


def test_no_query_and_no_frame_takes_a_position_beyond_what_can_be_counted():
    for often in (b"XS?\n", b"02550000\n"):
        rig = Rig()
        rig.ask(b"1XP200;1XD1;1DH999000;1MV+\n")
        for _ in range(200):
            rig.ask(often)
            rig.port.sent = bytearray()
        assert rig.axis1.position.millisteps < 1 << 30, often
        assert 101 in rig.errors()


def test_soft_limits_stay_where_they_are_when_the_axis_is_inverted():
    rig = Rig()
    rig.ask(b"1DH0;1SL-50;1SR3;1XI1\n")
    assert rig.ask(b"1SL?;1SR?\n") == b"-3; 50\r\n"
