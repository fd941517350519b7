"""What ends a drive that is watched by an encoder, and homing by stall. Runs under CPython and MicroPython."""

from mountfw import codes

from rig_encoder import EncoderPort, GearedPort, encoded, ended, finish, move, status, why  # isort: skip


def off_after(rig, us):
    """When axis 1 was turned off for the last time, after `us`."""
    return [at for at, pin, duty in rig.port.edges if pin == 2 and not duty][-1] - us


def test_a_stalled_motor_is_off_within_80_ms_whatever_drives_it():
    for line in (b"1PR3\n", b"1XU900000\n", b"1MV+\n", b"02550000\n", b"1MV-\n"):
        rig = encoded()
        rig.ask(b"1DH0\n")
        rig.send(line)
        rig.settle()
        rig.run(90_000)
        assert rig.drives()[0]
        rig.motor1.stuck = True
        stuck_at = rig.now()
        rig.run(200_000)
        assert rig.drives()[0] == 0
        assert off_after(rig, stuck_at) < 80_000
        assert why(rig) == (codes.STALLED, [147]), line
        assert status(rig)[1] == codes.ESTIMATED  # was it the motor that stood still, or the encoder?


def test_a_broken_wire_ends_a_move_as_a_stall_does_and_mm0_goes_on_without():
    rig = encoded()
    rig.send(b"1PR3\n")
    rig.settle()
    rig.run(90_000)
    rig.motor1.broken = True
    broken_at = rig.now()
    finish(rig)
    assert off_after(rig, broken_at) < 80_000
    assert why(rig) == (codes.STALLED, [147])
    rig.ask(b"1MM0;1DH0\n")
    move(rig, b"1PR3\n")
    assert ended(rig) == (codes.DONE, 3, [])
    assert status(rig) == (3000, codes.COUNTED)


def test_a_move_tells_its_own_steps_alone():
    rig = encoded()
    move(rig, b"1PR5\n")
    rig.motor1.at += 900  # a hand
    rig.run(300_000)
    rig.motor1.stuck = True
    move(rig, b"1PR2\n")
    assert ended(rig)[:2] == (codes.STALLED, 0)
    rig.motor1.stuck = False
    rig.ask(b"1XM1000\n")
    move(rig, b"1MV-\n")
    assert ended(rig)[:2] == (codes.RUN_LIMIT, -5)  # 1445 counts, and what it coasts


def test_no_stall_is_seen_where_that_is_switched_off():
    for line in (b"1XG0\n", b"ZZ1\n"):
        rig = encoded()
        rig.ask(line)
        rig.motor1.stuck = True
        rig.send(b"1ZH2;1XM500;1MV+\n")
        rig.settle()
        rig.run(600_000)
        assert ended(rig)[0] == codes.RUN_LIMIT


def test_counts_the_wrong_way_end_a_drive_at_once():
    for line in (b"1PR3\n", b"1MV+\n", b"02550000\n"):
        rig = encoded()
        rig.motor1.sign = -1
        rig.send(line)
        rig.settle()
        rig.run(100_000)
        assert rig.drives()[0] == 0
        assert why(rig) == (codes.WRONG_WAY, [148])


def test_counts_the_wrong_way_are_no_stall_however_slow_they_come():
    for line in (b"01280000\n", b"00900000\n"):
        rig = encoded()
        rig.motor1.sign = -1
        rig.send(line)
        rig.settle()
        rig.run(300_000)
        assert rig.drives()[0] == 0
        assert why(rig) == (codes.WRONG_WAY, [148]), line


def test_a_motor_that_coasts_back_at_first_is_no_stall():
    rig = encoded()
    rig.send(b"02550000\n")
    rig.settle()
    rig.run(300_000)
    rig.send(b"-0500000\n")
    rig.settle()
    rig.run(700_000)
    assert rig.drives()[0] < 0 and rig.errors() == []


def test_a_motor_that_is_reversed_in_full_run_counts_no_wrong_way():
    rig = encoded()
    for _ in range(5):
        rig.ask(b"02550000\n")
        rig.run(150_000)
        rig.ask(b"-2550000\n")
        rig.run(150_000)
    assert rig.drives()[0] == -255
    assert rig.errors() == []


def in_a_stream(rig, frame, gap_us, fault, most_us=600_000):
    """Send frames, the motor fails by fault(motor) in between. Returns how long after that it was off first; us."""
    for _ in range(500_000 // gap_us):
        rig.send(frame)
        rig.run(gap_us)
    rig.motor1.catch_up()
    fault(rig.motor1)
    failed_at, until = rig.now(), rig.now() + most_us
    while not rig.controller.errors.waiting and rig.now() < until:
        rig.send(frame)
        rig.run(gap_us)
    return min([at for at, pin, duty in rig.port.edges if pin == 2 and not duty and at > failed_at]) - failed_at


def stuck(motor):
    motor.stuck = True


def broken(motor):
    motor.broken = True


def test_frames_that_come_fast_do_not_keep_a_stall_from_being_seen():
    for frame in (b"02550000", b"02550000\n"):
        for gap_us in (20_000, 40_000, 55_000):
            for fault in (stuck, broken):
                rig = encoded()
                rig.ask(b"1DH0\n")
                assert in_a_stream(rig, frame, gap_us, fault) < 80_000
                assert rig.errors()[0] == 147
                assert status(rig)[1] == codes.ESTIMATED


def test_frames_that_come_fast_do_not_keep_a_following_error_from_being_seen():
    def slow(motor):
        motor.supply = 0.1

    rig = encoded()
    assert in_a_stream(rig, b"02550000", 40_000, slow) < 500_000
    assert rig.errors() == [144]


def reversed_geared():
    """A board whose encoders sit behind gears; the motor has run in its positive direction."""
    rig = encoded(settings=b"XN97;MM1;DB4;XG80", port=GearedPort)
    rig.ask(b"1DH0\n")
    rig.send(b"02550000")
    rig.run(1_000_000)
    rig.ask(b"00000000\n")
    rig.run(300_000)
    return rig


def test_a_slow_frame_at_first_does_not_stretch_the_play_of_those_after_it():
    rig = reversed_geared()
    rig.send(b"-0030000")
    rig.run(20_000)
    for _ in range(5):  # a stall within the play is seen when that is over
        rig.send(b"-2000000")
        rig.run(100_000)
    assert in_a_stream(rig, b"-2000000", 40_000, stuck) < 200_000
    assert rig.errors()[0] == 147


def test_frames_that_change_their_duty_in_the_play_of_gears_raise_no_error():
    for first, then in ((b"-0100000", b"-2550000"), (b"-2550000", b"-0600000")):
        rig = reversed_geared()
        rig.motor1.play = 120.0  # a quarter of a second at full duty
        rig.send(first)
        rig.run(20_000)
        for _ in range(40):
            rig.send(then)
            rig.run(40_000)
        assert rig.errors() == [], first
        assert rig.drives()[0] < 0


def test_counts_that_nobody_looked_at_in_time_are_no_following_error():
    rig = encoded()
    rig.ask(b"1ZH2;1MV+\n")
    rig.run(300_000)
    rig.axis1.checking = 0
    rig.port.us += 500_000  # the loop was at work elsewhere
    rig.run(100_000)
    assert rig.errors() == [] and rig.drives()[0] == 255


def test_a_motor_far_too_slow_is_a_following_error():
    for line in (b"1MV+\n", b"1PR1\n"):
        rig = encoded()
        rig.motor1.supply = 0.15
        rig.send(line)
        rig.settle()
        rig.run(1_000_000)
        assert rig.drives()[0] == 0
        assert why(rig) == (codes.FOLLOWING, [144])
    rig = encoded()
    rig.motor1.supply = 0.15
    rig.ask(b"1MV+\n")
    rig.ask(b"1XD254\n")  # counts from the next move on
    rig.run(1_000_000)
    assert why(rig) == (codes.FOLLOWING, [144])
    rig = encoded()
    rig.motor1.supply = 0.15
    rig.ask(b"1ZH2;1MV+\n")
    rig.run(1_000_000)
    assert rig.drives()[0] == 255


def test_an_encoder_that_is_gone_ends_the_move_and_the_position_is_an_estimate():
    for gone in (True, False):
        rig = encoded()
        rig.ask(b"1DH0;1MV+\n")
        rig.run(90_000)
        if gone:
            rig.motor1.gone = True
        else:
            rig.motor1.slips = 9
        rig.run(20_000)
        assert rig.drives()[0] == 0
        assert why(rig) == (codes.ENCODER_LOST, [149])
        assert status(rig)[1] == codes.ESTIMATED


def test_an_encoder_that_does_not_answer_at_rest_is_told_once_and_nothing_is_measured():
    rig = encoded()
    rig.ask(b"1DH0\n")
    assert status(rig)[1] == codes.MEASURED
    rig.motor1.gone = True
    rig.run(50_000)
    assert status(rig)[1] == codes.ESTIMATED
    assert why(rig)[1] == [149]
    rig.ask(b"1DH0\n")
    rig.run(50_000)
    assert (status(rig)[1], why(rig)[1]) == (codes.ESTIMATED, [])
    rig.motor1.gone = False
    rig.run(50_000)
    assert status(rig)[1] == codes.ESTIMATED  # it may have been turned meanwhile
    rig.ask(b"1DH0\n")
    assert (status(rig)[1], why(rig)[1]) == (codes.MEASURED, [])


def test_three_corrections_that_do_not_help_end_the_move():
    rig = encoded(settings=b"XN280;MM1;DB0")
    turned = rig.motor1.turn

    def pushed(us):
        turned(us)
        if not rig.drives()[0]:
            rig.motor1.at += 40 if rig.motor1.seen % 2 else 39

    rig.motor1.turn = pushed
    rig.send(b"1PR1\n")
    rig.settle()
    finish(rig)
    assert why(rig) == (codes.CLOSED_LOOP_FAILED, [150])


def test_a_search_without_a_switch_ends_where_the_motor_stalls_twice():
    rig = encoded(settings=b"XN280;MM1;XA128")
    rig.motor1.ends = (-1000, 4000)
    move(rig, b"1OR\n")
    assert why(rig) == (codes.DONE, [])
    assert abs(rig.motor1.at + 1000) < 1
    assert status(rig) == (0, codes.MEASURED)
    duties = [duty // 257 for _, pin, duty in rig.port.edges if pin == 2 and duty]
    assert set(duties) == {128}
    move(rig, b"1MT+\n")
    assert ended(rig)[0] == codes.DONE
    assert abs(rig.motor1.at - 4000) < 1


def test_such_a_search_is_refused_unless_it_is_switched_on_and_bounded():
    rig = encoded()
    rig.ask(b"1OR\n")
    assert rig.errors() == [135]
    rig.ask(b"1XA128;1XT700\n")
    move(rig, b"1OR\n")
    assert why(rig) == (codes.HOMING_FAILED, [145])


def test_such_a_search_is_refused_where_no_stall_is_checked():
    for line in (b"1XG0\n", b"ZZ1\n"):
        rig = encoded(settings=b"XN280;MM1;XA128")
        rig.ask(line)
        rig.ask(b"1OR\n")
        assert rig.errors() == [135]
        assert not any(duty for _, pin, duty in rig.port.edges if pin == 2)


def test_such_a_search_finds_no_end_where_nothing_counts():
    for port, settings in (
        (EncoderPort, b"XN280;MM1;XA128"),
        (EncoderPort, b"XN280;MM1;XA128;XG250"),
        (GearedPort, b"XN97;MM1;DB4;XG80;XA128"),
        (GearedPort, b"XN97;MM1;DB4;XG80;XA255"),
    ):
        for fault in (stuck, broken):
            rig = encoded(settings=settings, port=port)
            fault(rig.motor1)
            move(rig, b"1OR\n")
            assert why(rig) == (codes.HOMING_FAILED, [147])
            assert status(rig) == (0, codes.UNKNOWN)


def test_an_encoder_that_fails_on_the_way_back_to_the_end_makes_no_end():
    rig = encoded(settings=b"XN280;MM1;XA128")
    rig.motor1.ends = (-300, 1e9)
    rig.send(b"1OR\n")
    rig.settle()
    while rig.drives()[0] <= 0:
        rig.run(3_000)
    while rig.drives()[0] > 0:
        rig.run(3_000)
    rig.motor1.broken = True
    finish(rig)
    assert why(rig) == (codes.HOMING_FAILED, [147])
    assert status(rig)[1] != codes.MEASURED


def test_such_a_search_through_the_play_of_gears_finds_the_end():
    rig = encoded(settings=b"XN97;MM1;DB4;XG80;XA128", port=GearedPort)
    rig.motor1.ends = (-300, 1e9)
    move(rig, b"1OR\n")
    assert why(rig) == (codes.DONE, [])
    assert status(rig) == (0, codes.MEASURED)
    assert abs(rig.motor1.at + 300) < 1


def test_a_switch_that_opens_on_the_way_back_is_told_once():
    rig = encoded(settings=b"XN280;MM1;XA128;XL1")
    rig.motor1.ends = (-200, 1e9)
    rig.port.switches[rig.board.AXIS_1["stop_pos"]] = 0
    rig.send(b"1MT-\n")
    rig.settle()
    while rig.drives()[0] <= 0:
        rig.port.horizon_us = rig.port.us + 3_000
        rig.step()
    rig.port.switches[rig.board.AXIS_1["stop_pos"]] = 1
    finish(rig)
    assert why(rig) == (codes.END_STOP, [104])
