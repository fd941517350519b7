"""Moves of the closed loop, on motors that turn as the pins say. Runs under CPython and MicroPython."""

from mountfw import codes

from rig_encoder import GearedPort, encoded, ended, move, status, why  # isort: skip


def counted(rig):
    return rig.motor1.counts()


def test_a_step_is_its_counts_whatever_the_supply():
    for supply in (0.8, 1.0, 1.2):
        rig = encoded()
        rig.ask(b"1DH0\n")
        rig.motor1.supply = supply
        for i in range(12):
            before = counted(rig)
            move(rig, b"1PR%d\n" % (1 if i % 4 < 2 else -1))
            made = counted(rig) - before
            assert 278 <= abs(made) <= 282, (supply, i, made)
            assert ended(rig) == (codes.DONE, 1 if i % 4 < 2 else -1, [])
        assert abs(counted(rig)) <= 1
        assert status(rig) == (round(counted(rig) * 1000 / 280), codes.MEASURED)


def test_a_move_of_many_steps_ends_at_its_place_and_no_step_adds_to_the_error():
    for sign, inverted in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
        rig = encoded(settings=b"XN%d;MM1;XI%d" % (280 * sign, inverted))
        rig.motor1.sign = sign
        rig.ask(b"1DH0;1VA4\n")
        move(rig, b"1PR25\n")
        assert abs(abs(rig.motor1.at) - 7000) < 2, rig.motor1.at
        assert (rig.motor1.at > 0) == (inverted == 0)
        assert rig.ask(b"1TP?\n") == b"25\r\n"
        assert ended(rig) == (codes.DONE, 25, [])
        move(rig, b"1PA-3\n")
        assert abs(abs(rig.motor1.at) - 840) < 2, rig.motor1.at
        assert ended(rig) == (codes.DONE, -28, [])


def by_hand(rig, counts):
    """Turn the shaft of axis 1, and let the board see it."""
    rig.motor1.at += counts
    rig.run(100_000)


def test_a_move_to_a_step_ends_there_from_between_two_steps_too():
    for at in (112, -112, 139, 140, 141, -140, 279, 580):
        for steps in (0, 1, -1, 3):
            rig = encoded()
            rig.ask(b"1DH0\n")
            by_hand(rig, at)
            move(rig, b"1PA%d\n" % steps)
            assert abs(counted(rig) - steps * 280) <= 1, (at, steps)
            assert why(rig) == (codes.DONE, [])
            assert status(rig) == (round(counted(rig) * 1000 / 280), codes.MEASURED)
            assert rig.ask(b"1PA?\n") == b"%d\r\n" % steps


def test_a_move_to_a_step_from_between_two_makes_one_pulse_for_each_whole_step():
    rig = encoded()
    rig.ask(b"1DH0\n")
    by_hand(rig, 112)
    rig.send(b"1PA3\n")
    rig.settle()
    rig.run(400_000)
    assert abs(counted(rig) - 280) <= 20 and rig.axis1.moving()  # the first one is short
    rig.run(500_000)
    assert abs(counted(rig) - 560) <= 20 and rig.axis1.moving()


def test_a_move_to_where_it_stands_within_the_dead_band_is_done_at_once_and_drives_nothing():
    for at, dead_band in ((0, 1), (1, 1), (-1, 1), (9, 10), (-9, 10)):
        rig = encoded(settings=b"XN280;MM1;DB%d" % dead_band)
        rig.ask(b"1DH0\n")
        by_hand(rig, at)
        edges = len(rig.port.edges)
        assert rig.ask(b"1PA0;1MD?\n") == b"1\r\n"
        assert ended(rig) == (codes.DONE, 0, [])
        assert len(rig.port.edges) == edges
        assert status(rig) == (round(at * 1000 / 280), codes.MEASURED)  # and it says where that is
    by_hand(rig, -2)  # out of it
    move(rig, b"1PA0\n")
    assert abs(counted(rig)) <= 10 and len(rig.port.edges) > edges


def test_a_refused_move_to_a_place_leaves_nothing_to_the_next_move():
    rig = encoded(settings=b"XN280;MM1;ZH8;SR2")
    rig.ask(b"1DH0\n")
    by_hand(rig, 112)
    rig.ask(b"1PA3\n")
    assert rig.errors() == [106]
    move(rig, b"1PR1\n")
    assert abs(counted(rig) - 392) <= 1


def test_a_pulse_of_its_own_length_is_so_many_counts():
    rig = encoded()
    for us, counts in ((100_000, 140), (50_000, 70), (-350_000, -490), (1_000, 1), (200, 0)):
        before = counted(rig)
        move(rig, b"1XU%d\n" % us)
        assert abs(counted(rig) - before - counts) <= 2, us
        assert why(rig) == (codes.DONE, [])


def test_a_count_right_at_the_begin_of_a_drive_is_no_speed_to_cut_by():
    rig = encoded()
    for n in (1, 1, -1, -1, 1):  # what it coasts is learned
        move(rig, b"1PR%d\n" % n)
    rig.motor1.at = rig.motor1.at // 1 + 1 - 1e-7  # a hair before its next count
    rig.run(100_000)
    before, edges = counted(rig), len(rig.port.edges)
    move(rig, b"1PR1\n")
    assert abs(counted(rig) - before - 280) <= 2
    assert sum(pin == 2 and duty > 0 for _, pin, duty in rig.port.edges[edges:]) == 1  # and no correction


def test_a_drive_that_is_over_before_a_speed_is_known_is_its_counts_by_corrections():
    for counts in (2, 3, 5):
        for supply in (0.8, 1.0, 1.2):
            rig = encoded(settings=b"XN140;XP100000;MM1;DB2")
            rig.motor1.supply = rig.motor2.supply = supply
            rig.motor1.at = rig.motor2.at = 0.37
            goal = 0
            for i in range(12):
                way = 1 if i % 4 < 2 else -1
                goal += way * counts
                us = way * (counts * 100_000 // 140 + 1)
                move(rig, b"1XU%d;2XU%d\n" % (us, us))
                for axis, motor in ((1, rig.motor1), (2, rig.motor2)):
                    reason, _, errors = ended(rig, axis)
                    assert (reason, errors) == (codes.DONE, []), (counts, supply, i, axis)
                    assert abs(motor.counts() - goal) <= 2, (counts, supply, i, axis)


def test_a_step_shorter_than_a_motor_takes_to_its_speed_is_its_counts_and_a_run_is_no_error():
    for us, counts in ((60_000, 70), (40_000, 42), (20_000, 16), (10_000, 5)):
        for supply in (0.8, 1.2):
            rig = encoded(settings=b"XP%d;XN%d;MM1" % (us, counts))
            rig.motor1.supply = supply
            rig.motor1.at = 0.37
            way = 1
            for i in range(12):
                before = rig.motor1.at
                move(rig, b"1PR%d\n" % way)
                assert why(rig) == (codes.DONE, [])
                assert i < 3 or abs(rig.motor1.at - before - way * counts) < 3, (us, supply, i)
                way = -way if i % 3 else way
            rig.ask(b"1XM500\n")
            move(rig, b"1MV+\n")
            assert ended(rig)[0] == codes.RUN_LIMIT


def test_a_move_that_is_stopped_tells_the_steps_that_it_made():
    for stop, us, reason, steps in (
        (b"!", 1_120_000, codes.ABORTED, 2),
        (b"!", 1_350_000, codes.ABORTED, 3),
        (b"02000000", 1_350_000, codes.SUPERSEDED, 3),
        (b"1ST", 1_120_000, codes.STOPPED, 3),
    ):
        rig = encoded()
        rig.ask(b"1DH0\n")
        rig.send(b"1PR5\n")
        rig.run(us)
        rig.send(stop + b"\n")
        rig.settle()
        while rig.axis1.reason == codes.NONE_YET:
            rig.run(10_000)
        assert (rig.axis1.reason, rig.axis1.ended_steps) == (reason, steps)


def test_the_backlash_is_taken_up_in_counts():
    rig = encoded(settings=b"XN280;MM1;XB100000")  # half a step's time: 140 counts
    rig.ask(b"1DH0\n")
    move(rig, b"1PR2\n")
    before = counted(rig)
    move(rig, b"1PR-1\n")
    assert abs(counted(rig) - before + 280 + 140) <= 2
    before = counted(rig)
    move(rig, b"1PR-1\n")
    assert abs(counted(rig) - before + 280) <= 2
    assert rig.ask(b"1TP?\n") == b"0\r\n"


def test_the_closed_loop_allocates_nothing():
    rig = encoded(settings=b"XN280;MM1;XB20000;XA128")
    rig.motor1.ends = (-3000, 1e9)
    rig.port.locked = True
    for data in (
        b"1DH0;1PR2;2XU90000\n",
        b"1PR-2;2PR1\n",
        b"1XC?;1TP?;1PR2;1TP?;1PA?;1PR?;1DH?;1XE?;XS?\n",
        b"1DH7;1PA-20;ZZ?;ZZ1;ZZ0\n",
        b"1XG61;1FE200;1DB2;1CL0.06;1CL?;1MM0;1MM1;1XI1;1XI0;1XB0\n",
        b"02550255\n",
        b"-2550100\n",
        b"1MV+;2MV-\n",
        b"!\n",
        b"1OR\n",
    ):
        rig.send(data)
        rig.settle()
        rig.run(900_000)
    rig.run(3_000_000)
    rig.motor1.stuck = rig.motor2.broken = True
    rig.send(b"1PR1;2PR1\n")
    rig.settle()
    rig.run(300_000)
    rig.motor1.at += 500
    rig.run(300_000)
    rig.port.locked = False
    assert rig.axis1.reason == rig.axis2.reason == codes.STALLED
    assert codes.INTERNAL_FAULT not in rig.errors()


def test_a_run_ends_at_the_soft_limit_where_the_encoder_says_that_it_is():
    for supply in (0.8, 1.0, 1.2):
        for inverted in (0, 1):
            rig = encoded(settings=b"XN280;MM1;XI%d" % inverted)
            rig.motor1.supply = supply
            rig.ask(b"1DH0;1SR5;1SL-3;1ZH8\n")
            for line, limit, number in ((b"1MV+\n", 5000, 106), (b"1MV-\n", -3000, 107)):
                move(rig, line)
                beyond = status(rig)[0] - limit if limit > 0 else limit - status(rig)[0]
                assert 0 <= beyond < 250, (supply, inverted, limit, beyond)  # a look each 10 ms, and the motor coasts
                assert why(rig) == (codes.SOFT_LIMIT, [number])
                before = counted(rig)
                rig.ask(line)
                assert rig.errors() == [number]
                assert counted(rig) == before
            move(rig, b"1PR1\n")
            assert why(rig) == (codes.DONE, [])


def test_another_soft_limit_counts_from_the_next_run_on():
    rig = encoded()
    rig.ask(b"1DH0;1SR5;1ZH8\n")
    rig.ask(b"1MV+\n")
    rig.ask(b"1SR9\n")
    rig.run(5_000_000)
    assert 0 <= status(rig)[0] - 5000 < 250
    assert why(rig) == (codes.SOFT_LIMIT, [106])
    move(rig, b"1MV+\n")
    assert 0 <= status(rig)[0] - 9000 < 250


def test_a_frame_in_the_closed_loop_has_no_soft_limit_also_after_a_run_that_had_one():
    rig = encoded()
    rig.ask(b"1DH0;1SR5;1ZH8;1XM3000\n")
    rig.ask(b"1MV+\n")
    rig.run(300_000)
    move(rig, b"02550000")
    assert status(rig)[0] > 10_000
    assert why(rig)[0] == codes.RUN_LIMIT


def test_an_axis_that_was_inverted_has_its_gears_play_before_it():
    for line in (b"1XI1\n", b"1XN-97\n"):
        rig = encoded(settings=b"XN97;MM1;DB4;XG80", port=GearedPort)
        move(rig, b"1PR3\n")
        assert why(rig) == (codes.DONE, [])
        if b"N" in line:
            rig.motor1.sign = -1
        rig.ask(line)
        move(rig, b"1PR%d\n" % (2 if b"I" in line else -2))
        assert why(rig) == (codes.DONE, []), line
