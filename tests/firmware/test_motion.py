"""Pulses, runs, limits, end-stops, keep-alive. Runs under CPython and MicroPython."""

from rig import Board, Rig

from mountfw.boards import pico_drv8833
from mountfw.wire.ticks import diff


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
    rig.ask(b"1PR1000001;1PR-1000001;1PA1000001;1DH1000001\n")
    assert rig.errors() == [101] * 4
    rig.ask(b"1DH1000000;1PR1\n")
    assert rig.errors() == [101]
    assert rig.drives() == (0, 0)


def test_a_move_over_the_whole_travel_is_accepted_whatever_time_it_takes():
    for settings in (b"\n", b"1XP2000000;1XT1;1XM1\n"):
        for here, there in ((1_000_000, -1_000_000), (-1_000_000, 1_000_000)):
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
    rig.ask(b"1DH1000000;1MV-\n")
    rig.run(100_000)
    assert rig.drives() == (-255, 0)
    rig.ask(b"!1DH-1000000;1MV+\n")
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


# ---- end-stops


def with_switches(bits=3, pressed=()):
    rig = Rig()
    for pin in (10, 11, 12, 13):
        rig.port.switches[pin] = 1 if pin in pressed else 0
    rig.ask(b"1XL%d;2XL%d\n" % (bits, bits))
    return rig


def test_switches_that_are_not_fitted_are_not_read():
    rig = Rig()  # nothing connected: every input is pulled up
    rig.ask(b"02550255")
    assert rig.drives() == (255, 255)
    assert rig.ask(b"PH?;1XL?\n") == b"0; 0\r\n"


def test_an_end_stop_ends_the_move_into_it_and_is_told():
    for move, pin, error, bit in (
        (b"1MV+\n", 10, 104, 1),
        (b"1PR-5\n", 11, 105, 2),
        (b"02550000", 10, 104, 1),
    ):
        rig = with_switches()
        rig.ask(move)
        rig.run(50_000)
        assert rig.drives()[0]
        rig.port.switches[pin] = 1
        rig.run(500)
        assert rig.drives() == (0, 0), move
        assert rig.ask(b"1XE?\n").split(b",")[0] == b"4"
        assert rig.ask(b"PH?\n") == b"%d\r\n" % bit
        assert rig.errors() == [error]


def test_a_burst_of_input_does_not_hold_up_an_end_stop():
    rig = with_switches()
    rig.ask(b"1MV+\n")
    rig.send(b" " * 256)
    rig.port.switches[10] = 1
    opened = rig.now()
    rig.take_in()
    off = [us for us, pin, duty in rig.port.edges if pin == 2 and not duty][-1]
    assert off - opened < 2_000  # polled; with an interrupt it does not wait for the burst


def test_at_an_end_stop_only_the_way_into_it_is_blocked():
    rig = with_switches(pressed=(10,))
    rig.ask(b"1MV+\n")
    assert rig.drives() == (0, 0)
    assert rig.errors() == [104]
    rig.ask(b"1MV-\n")
    assert rig.drives() == (-255, 0)


def test_end_stops_belong_to_the_electrical_direction_and_their_names_swap():
    rig = with_switches(pressed=(10,))
    rig.ask(b"1XI1\n")
    assert rig.ask(b"PH?\n") == b"2\r\n"
    rig.ask(b"1MV-\n")
    assert rig.drives() == (0, 0)
    assert rig.errors() == [105]
    rig.ask(b"1MV+\n")
    assert rig.drives() == (-255, 0)


def test_one_axis_at_its_end_stop_does_not_hold_the_other():
    rig = with_switches(pressed=(13,))
    rig.ask(b"0255-255")
    assert rig.drives() == (255, 0)


def test_both_end_stops_active_is_a_fault_until_checking_is_off():
    rig = with_switches(pressed=(10, 11))
    for move in (b"1MV+\n", b"1MV-\n", b"1PR1\n"):
        rig.ask(move)
        assert rig.drives() == (0, 0)
        assert rig.errors() == [142]
        assert rig.ask(b"1XE?\n").split(b",")[0] == b"9"
    rig.ask(b"1ZH1;1MV+\n")
    assert rig.drives() == (255, 0)


def test_a_switch_that_the_board_has_not_cannot_be_fitted():
    rig = Rig()
    rig.ask(b"1XL4\n")
    assert rig.errors() == [135]
    assert rig.ask(b"1XL?\n") == b"0\r\n"


def test_a_single_noisy_reading_is_not_a_stop():
    rig = with_switches()
    rig.ask(b"1MV+\n")
    readings = [0]
    stop = rig.axis1.positive_stop
    quiet = stop._read

    def noisy():
        readings[0] += 1
        return 1 if readings[0] % 5 == 0 else quiet()

    stop._read = noisy
    rig.run(100_000)
    assert readings[0] > 100
    assert rig.drives() == (255, 0)


# ---- keep-alive


def test_motion_stops_when_the_client_falls_silent_and_says_why():
    for motion in (b"XK500;1MV+\n", b"XK500;1PR20\n", b"XK500\n02550000"):
        rig = Rig()
        rig.ask(motion)
        rig.run(400_000)
        assert rig.controller.moving()
        rig.run(100_000)
        assert rig.drives() == (0, 0), motion
        assert rig.errors() == [62]
        assert rig.ask(b"1XE?;XK?\n").split(b",")[0] == b"7"


def test_a_short_keep_alive_is_kept_to():
    rig = Rig()
    rig.send(b"XK5;1MV+\n")
    for i in range(1, 10):
        rig.send(b"\n", after_us=i * 18_000)
    rig.take_in()
    assert 4_500 < rig.on_times(2)[0] < 5_100  # counted from the byte, not from the motion's beginning
    rig = Rig()
    rig.send(b"XK20;1MV+\n")
    for i in range(1, 10):
        rig.send(b"\n", after_us=i * 18_000)
    rig.run(9 * 18_000)
    assert rig.drives() == (255, 0)


def test_any_byte_keeps_a_motion_alive():
    rig = Rig()
    rig.ask(b"XK500;1MV+\n")
    for _ in range(20):
        rig.run(100_000)
        rig.ask(b"\n")
    assert rig.drives() == (255, 0)


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


def test_a_byte_that_comes_just_before_the_end_keeps_a_motion_alive():
    for before_us in range(50, 5000, 50):
        rig = Rig()
        rig.ask(b"XK100;1MV+\n")
        left_us = rig.controller.silence(rig.port.ticks_us(), rig.app._receiver.received_at)
        rig.send(b"\n", after_us=left_us - before_us)
        rig.run(left_us + 50_000)
        assert rig.drives() == (255, 0), before_us
        rig.run(60_000)
        assert rig.drives() == (0, 0)


def test_a_dead_clients_keep_alive_does_not_cut_the_next_one():
    rig = Rig()
    rig.ask(b"XK300;1PR1\n")
    rig.run(1_000_000)  # its move is done, it is silent: nothing to stop, nothing to tell
    assert rig.errors() == []
    assert rig.ask(b"XK?\n") == b"0\r\n"
    rig.ask(b"1MV+\n")
    rig.run(2_000_000)
    assert rig.drives() == (255, 0)
    rig = Rig()
    rig.ask(b"XK300;1MV+\n")
    rig.run(1_000_000)
    rig.ask(b"1MV+\n")
    rig.run(2_000_000)
    assert rig.drives() == (255, 0)


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


def test_a_switch_that_opens_shortly_before_a_pulse_ends_cuts_it_without_an_interrupt():
    rig = with_switches()
    rig.ask(b"1PR1\n")
    began = [us for us, pin, duty in rig.port.edges if pin == 2 and duty][-1]
    rig.axis1.positive_stop._read = lambda: 1 if rig.now() > began + 198_500 else 0
    rig.run(250_000)
    on_us = rig.on_times(2)[-1]
    assert 198_490 < on_us < 198_700, on_us
    assert abs(rig.axis1.ended_on_us - on_us) < 50
    assert rig.errors() == [104]


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


def test_checking_is_not_switched_off_in_a_move():
    rig = with_switches()
    rig.ask(b"1MV+;1ZH1\n")
    assert rig.errors() == [114]
    assert rig.ask(b"1ZH?\n") == b"0\r\n"


def test_an_end_stop_that_opens_after_a_drive_was_cut_adds_nothing_to_its_time():
    rig = Rig()
    rig.port.switches[10] = 0
    rig.ask(b"1XL1\n")
    drive = rig.controller.axes[0].drive
    drive.aim(255)
    assert drive.on(100_000) == 0
    rig.port.us += 300
    drive.cut()
    cut_at = drive.cut_at
    rig.port.us += 275
    rig.port.switches[10] = 1
    drive.guard(None)
    assert drive.tripped
    assert rig.drives() == (0, 0)
    assert drive.cut_at == cut_at
    assert drive.measured_us(True) == diff(cut_at, drive.on_at)
