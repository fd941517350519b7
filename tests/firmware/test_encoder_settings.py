"""What settings, *RST and the other unit make of a measured position. Runs under CPython and MicroPython."""

from mountfw import codes

from rig_encoder import encoded, ended, finish, move, status, why  # isort: skip


def test_the_loop_closes_and_opens_with_a_take_up_and_nothing_else_is_lost():
    for line in (b"*RST\n", b"*RCL1\n"):
        rig = encoded(settings=b"XN280;MM1;XB20000;XL3;SR5;SL-5")
        rig.ask(b"SM\n")
        rig.run(300_000)
        rig.ask(line)
        rig.run(100_000)
        assert rig.errors() == []
        assert rig.ask(b"1XL?;1SR?;1MM?;2XB?\n") == b"3; 5; 1; 20000\r\n"
        assert [axis.drive.watched for axis in rig.axes] == [True, True]
    for line in (b"*RCL0\n", b"XX\n"):
        rig = encoded(settings=b"XN280;MM1;XB20000")
        rig.ask(line)
        assert rig.errors() == []
        assert rig.ask(b"1MM?;1XB?;2MM?\n") == b"0; 0; 0\r\n"
    rig = encoded(settings=b"XP200;XD1;XN10000;XB1;MM1;MM0")  # a gap of fewer parts than counts
    assert rig.errors() == []


def test_after_a_restart_motors_are_checked_again():
    rig = encoded()
    rig.ask(b"SM\n")
    rig.run(300_000)
    assert rig.ask(b"ZZ1;ZZ?\n") == b"1\r\n"
    rig.ask(b"*RST\n")
    rig.run(100_000)
    assert rig.ask(b"ZZ?;1MM?\n") == b"0; 1\r\n"
    rig.motor1.stuck = True
    move(rig, b"1MV+\n")
    assert why(rig) == (codes.STALLED, [147])


def test_after_a_restart_it_is_told_again_that_an_encoder_does_not_answer():
    rig = encoded()
    rig.ask(b"SM\n")
    rig.run(300_000)
    rig.motor1.gone = True
    rig.run(200_000)
    assert rig.errors() == [149]
    rig.ask(b"*RST\n")
    rig.run(200_000)
    assert rig.errors() == [149]


def test_a_position_told_by_other_steps_or_another_direction_is_an_estimate():
    for line in (b"1XP100000;1MM0\n", b"1XN-280\n", b"1XN281\n"):
        rig = encoded()
        rig.ask(b"1DH0\n")
        move(rig, b"1PR10\n")
        assert status(rig) == (10_000, codes.MEASURED)
        rig.ask(line)
        assert status(rig) == (10_000, codes.ESTIMATED), line
        rig.ask(b"1DH0;1MM0\n")
        assert status(rig) == (0, codes.COUNTED), line


def test_the_loop_that_opens_while_the_motor_coasts_leaves_an_estimate():
    for recorded in (False, True):
        for run_us in range(500_000, 700_000, 40_000):  # it ends in all places of a step
            rig = encoded()
            rig.ask(b"1DH0;SM\n")
            rig.run(11_000_000)
            if recorded:  # after a restart nothing is measured
                rig = encoded(dict(rig.port.files), b"")
                assert status(rig) == (0, codes.COUNTED)
            rig.send(b"1MV+\n")
            rig.settle()
            rig.run(run_us)
            rig.ask(b"!\n1MM0\n")
            assert status(rig)[1] == codes.ESTIMATED


def test_the_loop_that_opens_on_a_step_leaves_it_counted():
    rig = encoded()
    rig.ask(b"1DH0\n")
    move(rig, b"1PR3\n")
    rig.ask(b"1MM0\n")
    at, certainty = status(rig)
    assert (abs(at - 3000) < 10, certainty) == (True, codes.COUNTED)


def test_a_place_in_the_gap_that_was_recorded_is_that_of_the_first_move():
    rig = encoded(settings=b"XN280;MM1;XB100000")
    rig.ask(b"1DH0;SM\n")
    rig.run(300_000)
    move(rig, b"1PR5\n")
    rig.run(11_000_000)
    again = encoded(dict(rig.port.files), b"")
    move(again, b"1PR1\n")
    assert ended(again) == (codes.DONE, 1, [])
    assert again.on_times(2)[0] < 220_000  # a step, and no gap before it


def test_a_dead_band_larger_than_a_step_turns_no_move_round():
    rig = encoded(settings=b"XN280;MM1;DB600")
    rig.ask(b"1DH0\n")
    move(rig, b"1PR1\n")
    rig.motor1.at += 500  # a hand
    rig.run(200_000)
    rig.send(b"1PR1\n")
    rig.settle()
    rig.run(50_000)
    assert rig.drives()[0] == 255


def test_a_soft_stop_lets_a_pulse_end_but_not_later_than_it_would_have():
    for settings in (b"XN280;MM1", b"XN280;MM1;ZH2;XG0", b"XN2900;XP2000000;MM1"):
        rig = encoded(settings=settings)
        rig.send(b"1PR1\n")
        rig.settle()
        rig.run(rig.axis1.pulse_us - 100_000)
        rig.motor1.catch_up()
        rig.motor1.supply = 0.1  # a hand brakes it
        asked_at = rig.now()
        rig.send(b"1ST\n")
        finish(rig)
        assert [at for at, pin, duty in rig.port.edges if pin == 2 and not duty][-1] - asked_at < 250_000


def test_a_pulse_whose_counts_do_not_come_ends_at_three_times_its_length():
    rig = encoded(settings=b"XN280;MM1;XG0;ZH2")
    rig.ask(b"1DH0\n")
    rig.send(b"1PR1\n")
    rig.settle()
    rig.run(150_000)
    rig.motor1.stuck = True
    finish(rig)
    assert max(rig.on_times(2)) < 3 * 210_000 + 50_000
    assert why(rig) == (codes.FOLLOWING, [144])
    assert status(rig)[1] == codes.ESTIMATED


def test_after_xi_a_step_begins_where_the_last_one_has_ended():
    rig = encoded(settings=b"XN280;MM1;DB100")
    rig.ask(b"1DH0\n")
    move(rig, b"1PR1\n")
    rig.motor1.at += 60  # a hand, within the dead band: the goal is there no more
    rig.ask(b"1XI1\n")
    before = rig.motor1.at
    move(rig, b"1PR1\n")
    assert ended(rig)[0] == codes.DONE
    assert abs(rig.motor1.at - before + 280) < 20


def test_the_first_step_after_a_run_in_the_open_loop_waits_for_nothing():
    rig = encoded(settings=b"XN280;VA0.1")
    rig.run(700_000_000)  # more than half a turn of the clock
    rig.send(b"1MV+\n")
    rig.run(100_000)
    rig.ask(b"1ST\n")
    rig.port.edges.clear()
    rig.send(b"1PR1\n")
    rig.run(100_000)
    assert rig.drives()[0]
