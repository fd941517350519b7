"""Axes with encoders: the closed loop, on motors that turn as the pins say. Runs under CPython and MicroPython."""

from rig import Rig

from mountfw import codes
from mountfw.ports.counted import Phases, Turns

from rig_encoder import encoded, finish  # isort: skip


def move(rig, line):
    rig.send(line)
    rig.settle()
    finish(rig)
    rig.run(60_000)


def ended(rig, axis=1):
    """Reason, whole steps and errors of the last move."""
    reason, steps, _ = rig.ask(b"%dXE?\n" % axis).split(b",")
    return int(reason), int(steps), rig.errors()


def why(rig):
    """The same without the steps."""
    reason, _, errors = ended(rig)
    return reason, errors


def status(rig):
    """Position in millisteps, and certainty, of axis 1."""
    words = rig.ask(b"XS?\n").split(b"|")[1].split(b",")
    return int(words[0]), int(words[5])


def counted(rig):
    return rig.motor1.counts()


# ---- without an encoder


def test_an_axis_without_an_encoder_says_0_and_takes_nothing_else():
    rig = Rig()
    for name in (b"SN", b"MM", b"DB", b"CL", b"FE", b"XN", b"XG", b"XA", b"XZ"):
        assert rig.ask(b"1%s0;1%s?\n" % (name, name)) == b"0\r\n"
        rig.ask(b"1%s1\n" % name)
        assert rig.errors() == [135]
    assert rig.ask(b"1XC?\n") == b"ERROR 6\r\n"


def test_on_a_board_with_one_encoder_the_other_axis_answers_as_without():
    rig = encoded()
    bare = rig.axis1
    del bare.reader
    assert rig.ask(b"1XN?;1MM?;2XN?\n") == b"0; 0; 280\r\n"
    rig.ask(b"1MM0;1XN5\n")
    assert rig.errors() == [135]
    assert rig.ask(b"1XC?\n") == b"ERROR 135\r\n"


# ---- settings


def test_the_closed_loop_and_counts_as_units_need_the_counts_of_a_step():
    rig = encoded(settings=b"")
    for line in (b"1MM1\n", b"1SN1\n"):
        rig.ask(line)
        assert rig.errors() == [135]
    rig.ask(b"1XN280;1MM1;1SN1\n")
    assert rig.errors() == []
    rig.ask(b"1XN0\n")
    assert rig.ask(b"1MM?;1SN?\n") == b"0; 0\r\n"


def test_the_settings_of_an_encoder_are_saved_with_the_others():
    rig = encoded(settings=b"XN-281;MM1;SN1;DB3;CL0.25;FE90;XG75;XA120;XZ9")
    rig.ask(b"SM\n")
    rig.run(200_000)
    again = encoded(rig.port.files, b"")
    names = (b"XN", b"MM", b"SN", b"DB", b"CL", b"FE", b"XG", b"XA", b"XZ")
    answer = again.ask(b";".join([b"1%s?" % name for name in names]) + b"\n")
    assert answer == b"-281; 1; 1; 3; 0.25; 90; 75; 120; 9\r\n"
    assert again.errors() == []


# ---- steps


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


def test_a_pulse_of_its_own_length_is_so_many_counts():
    rig = encoded()
    for us, counts in ((100_000, 140), (50_000, 70), (-350_000, -490), (1_000, 1), (200, 0)):
        before = counted(rig)
        move(rig, b"1XU%d\n" % us)
        assert abs(counted(rig) - before - counts) <= 2, us
        assert why(rig) == (codes.DONE, [])


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


def test_units_of_counts_are_those_of_moves_and_positions():
    rig = encoded(settings=b"XN280;MM1;SN1")
    rig.ask(b"1DH1000\n")
    assert rig.ask(b"1TP?;1DH?\n") == b"1000; 1000\r\n"
    move(rig, b"1PR-421\n")
    assert abs(counted(rig) + 421) <= 1
    assert abs(int(rig.ask(b"1TP?\n")) - 579) <= 1
    assert rig.ask(b"1PR?;1PA?\n") == b"-421; 579\r\n"
    move(rig, b"1PA1000\n")
    assert abs(counted(rig)) <= 1
    assert rig.errors() == []


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


# ---- what ends a drive


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


def test_a_motor_that_is_reversed_in_full_run_counts_no_wrong_way():
    rig = encoded()
    for _ in range(5):
        rig.ask(b"02550000\n")
        rig.run(150_000)
        rig.ask(b"-2550000\n")
        rig.run(150_000)
    assert rig.drives()[0] == -255
    assert rig.errors() == []


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


def test_one_lost_count_takes_the_certainty_back_and_ends_nothing():
    rig = encoded()
    rig.ask(b"1DH0\n")
    assert status(rig)[1] == codes.MEASURED
    rig.motor1.slips = 1
    move(rig, b"1PR1\n")
    assert ended(rig) == (codes.DONE, 1, [])
    assert status(rig)[1] == codes.ESTIMATED
    rig.ask(b"1DH0\n")
    assert status(rig)[1] == codes.MEASURED


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


# ---- at rest


def test_the_position_follows_a_hand():
    rig = encoded()
    rig.ask(b"1DH0\n")
    for turned, millisteps in ((140, 500), (-700, -2000), (1, -1996)):
        rig.motor1.at += turned
        rig.run(100_000)
        assert rig.axis1.position.millisteps == millisteps  # before anybody asks
        assert status(rig) == (millisteps, codes.MEASURED)


def test_a_record_of_the_position_goes_when_a_hand_turns_the_shaft():
    rig = encoded()
    rig.ask(b"1DH0\n")
    move(rig, b"1PR1\n")
    rig.run(10_500_000)
    assert "mountfw.position" in rig.port.files
    rig.motor1.at += 1  # less than a dead band is no turn
    rig.run(100_000)
    assert "mountfw.position" in rig.port.files
    rig.motor1.at += 100
    rig.run(100_000)
    assert "mountfw.position" not in rig.port.files
    rig.run(10_500_000)
    again = encoded(rig.port.files)
    assert abs(status(again)[0] - 1361) <= 8
    assert status(again)[1] == codes.COUNTED  # while it was off nobody measured


def test_no_look_at_rest_or_in_the_open_loop_costs_a_board_without_an_encoder_anything():
    rig = encoded(settings=b"XN280")
    reads = rig.motor1.reads
    rig.ask(b"1PR2\n")
    finish(rig)
    rig.run(1_000_000)
    assert rig.motor1.reads == reads


def on_screw(rig, at=0.0):
    """Make motor 1's encoder one that stands on the screw and knows its angle."""
    motor = rig.motor1
    motor.at = at
    motor.angle = lambda: motor.counts() & 4095
    rig.axis1.position.look()


def started_again(files, at):
    """The same board after a power cut, with its shaft at so many counts."""
    again = encoded(files, b"")
    on_screw(again, at)
    again.controller.records.restore()
    return again


def test_an_encoder_on_the_screw_tells_if_it_was_turned_while_the_board_was_off():
    rig = encoded(settings=b"XN102;MM1")
    on_screw(rig, 300)
    rig.ask(b"1DH7;SM\n")
    rig.run(200_000)
    move(rig, b"1PR2\n")
    rig.run(10_500_000)
    at = rig.motor1.at
    for turned, error in ((0, []), (3, []), (51, [151]), (-1000, [151]), (4096, [])):
        again = started_again(dict(rig.port.files), at + turned)
        assert again.errors() == error, turned
        certainty = codes.ESTIMATED if error else codes.COUNTED
        moved = turned if error else 0
        assert abs(status(again)[0] - 9000 - moved * 1000 / 102) <= 30
        assert status(again)[1] == certainty


def test_without_a_record_the_angle_gives_the_position_within_half_a_turn_as_an_estimate():
    for sign in (1, -1):
        rig = encoded(settings=b"XN%d;MM1" % (102 * sign))
        on_screw(rig, 300)
        rig.ask(b"1DH0;SM\n")
        rig.run(200_000)
        assert "mountfw.position" not in rig.port.files
        for turned in (0, 510, -1020, 2040):
            again = started_again(dict(rig.port.files), 300 + turned)
            assert abs(status(again)[0] - sign * turned * 1000 / 102) <= 10
            assert status(again)[1] == codes.ESTIMATED
            assert again.errors() == []
    rig = encoded(rig.port.files, b"")  # an encoder that knows no angle
    assert status(rig) == (0, codes.UNKNOWN)


# ---- homing


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
    rig.motor1.stuck = True
    move(rig, b"1OR\n")
    assert why(rig) == (codes.HOMING_FAILED, [147])


def test_the_closed_loop_allocates_nothing():
    rig = encoded(settings=b"XN280;MM1;XB20000;XA128")
    rig.motor1.ends = (-3000, 1e9)
    rig.port.locked = True
    for data in (
        b"1DH0;1PR2;2XU90000\n",
        b"1PR-2;2PR1\n",
        b"1XC?;1TP?;1SN1;1PR50;1TP?;1PA?;1PR?;1DH?;1XE?;XS?\n",
        b"1DH7;1PA-20;ZZ?;ZZ1;ZZ0\n",
        b"1SN0;1XG61;1FE200;1DB2;1CL0.06;1CL?;1MM0;1MM1;1XI1;1XI0;1XB0\n",
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


# ---- what readers count


def test_phases_see_a_change_of_both_signals_at_once():
    phases = Phases()
    order = (0, 1, 3, 2)
    for n in (0, 1, 2, 3, 4, 5, 4, 3, 2, 1, 0, -1, -2, -5, -6):
        assert phases.take(n << 2 | order[n & 3]) == n
    assert phases.slips == 0
    phases.take(-6 << 2 | order[0])  # it counted nothing, and stands half a turn further
    assert phases.slips == 1
    phases.take(-5 << 2 | order[1])
    assert phases.slips == 1


def test_turns_of_an_angle_are_counted_over_its_zero_and_a_lost_magnet_is_told():
    turns = Turns()
    assert turns.gone
    turns.take(0x20, 0x0F, 0xF0)
    assert (turns.count & 4095, turns.gone) == (4080, False)
    start = turns.count
    turns.take(0x20, 0, 16)
    assert turns.count - start == 32
    turns.take(0x20, 0x0F, 0xFF)
    assert turns.count - start == 15
    before = turns.slips
    turns.take(0, 0, 0)
    turns.silent()
    assert not turns.gone
    turns.take(0x20, 0x0F, 0xFE)
    assert (turns.count - start, turns.slips) == (14, before)
    for _ in range(3):
        turns.silent()
    assert turns.gone
    turns.take(0x20, 0, 0)
    assert not turns.gone and turns.slips == before + 1
