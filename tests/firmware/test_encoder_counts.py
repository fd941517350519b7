"""What an encoder counts: settings, position at rest, an AS5600. Runs under CPython and MicroPython."""

from rig import Board, Rig

from mountfw import codes, store
from mountfw.ports.encoders import Phases, Turns

from rig_encoder import EncoderPort, GearedPort, encoded, ended, finish, move, status  # isort: skip


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


def test_the_closed_loop_needs_the_counts_of_a_step():
    rig = encoded(settings=b"")
    rig.ask(b"1MM1\n")
    assert rig.errors() == [135]
    rig.ask(b"1XN280;1MM1\n")
    assert rig.errors() == []
    rig.ask(b"1XN0\n")
    assert rig.ask(b"1MM?\n") == b"0\r\n"


def test_moves_and_positions_are_told_in_steps_alone():
    rig = encoded()
    rig.ask(b"1SN0\n")
    assert rig.errors() == []
    rig.ask(b"1SN1\n")
    assert rig.errors() == [135]
    assert rig.ask(b"1SN?\n") == b"0\r\n"


def test_the_settings_of_an_encoder_are_saved_with_the_others():
    rig = encoded(settings=b"XN-281;MM1;DB3;CL0.25;FE90;XG75;XA120;XZ9")
    rig.ask(b"SM\n")
    rig.run(200_000)
    again = encoded(rig.port.files, b"")
    names = (b"XN", b"MM", b"DB", b"CL", b"FE", b"XG", b"XA", b"XZ")
    answer = again.ask(b";".join([b"1%s?" % name for name in names]) + b"\n")
    assert answer == b"-281; 1; 3; 0.25; 90; 75; 120; 9\r\n"
    assert again.errors() == []


def test_units_that_an_older_firmware_saved_are_left_out_and_told_where_they_were_counts():
    for units, told in ((0, []), (1, [codes.SETTINGS_LEFT_OUT])):
        files = {"mountfw.settings": store.seal("1 counts_per_step 280\n1 units %d\n" % units)}
        rig = encoded(files, b"")
        assert rig.errors() == told
        assert rig.ask(b"1XN?\n") == b"280\r\n"


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


def test_the_position_follows_a_hand():
    rig = encoded()
    rig.ask(b"1DH0\n")
    for turned, millisteps in ((140, 500), (-700, -2000), (1, -1996)):
        rig.motor1.at += turned
        rig.run(100_000)
        assert rig.axis1.position.millisteps == millisteps  # before anybody asks
        assert status(rig) == (millisteps, codes.MEASURED)


def test_an_encoder_at_rest_is_looked_at_15_times_a_second():
    rig = encoded()
    rig.run(500_000)
    before = rig.app.queries.about.passes
    rig.run(10_000_000)
    assert rig.app.queries.about.passes - before > 150  # a hand may turn an AS5600 by half a turn between two


def test_after_the_end_of_a_move_an_encoder_is_looked_at_within_a_tenth_of_a_second():
    board = Board()
    board.AXIS_1 = dict(board.AXIS_1, encoder=(8, 9))  # the other axis has none, which would wake the loop
    for line in (b"1PR1\n", b"1XM300;1MV+\n"):
        rig = Rig(board, None, EncoderPort())
        rig.ask(b"1XN280;1MM1\n")
        rig.run(700_000)
        looks = []
        counts = rig.port.motors[0].counts
        rig.axis1.reader.counts = lambda rig=rig, looks=looks, counts=counts: looks.append(rig.now()) or counts()
        rig.send(line)
        rig.run(3_000_000)
        assert not rig.controller.moving()
        assert max([later - sooner for sooner, later in zip(looks, looks[1:])]) < 100_000, line


def test_a_sensor_behind_gears_is_looked_at_between_two_pulses_too():
    rig = encoded(settings=b"XN97;MM1;DB4;XG80;VA0.1", port=GearedPort)
    rig.ask(b"2MM0\n")  # nothing else wakes the loop
    looks = []
    counts = rig.motor1.counts

    def noted():
        looks.append(rig.now())
        return counts()

    rig.motor1.counts = noted
    rig.send(b"1PR2\n")
    rig.settle()
    rig.run(2_000_000)
    assert rig.drives() == (0, 0) and rig.controller.moving()
    # half a turn between two would be lost
    assert max([late - early for early, late in zip(looks, looks[1:])]) < 100_000


def test_no_look_at_rest_or_in_the_open_loop_costs_a_board_without_an_encoder_anything():
    rig = encoded(settings=b"XN280")
    reads = rig.motor1.reads
    rig.ask(b"1PR2\n")
    finish(rig)
    rig.run(1_000_000)
    assert rig.motor1.reads == reads


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
    assert not turns.silent() and turns.gone
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
    assert [turns.silent() for _ in range(4)] == [False, False, True, True]
    assert turns.gone
    turns.take(0x20, 0, 0)
    assert not turns.gone and turns.slips == before + 1
