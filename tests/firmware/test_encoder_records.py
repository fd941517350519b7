"""Measured positions over a restart: records, and the angle of an AS5600. Runs under CPython and MicroPython."""

from mountfw import codes
from mountfw.store import seal, unseal

from rig_encoder import GearedPort, encoded, ended, move, status  # isort: skip


def recorded():
    """A board at step 1 whose position is on the flash."""
    rig = encoded()
    rig.ask(b"1DH0;SM\n")
    rig.run(300_000)
    move(rig, b"1PR1\n")
    rig.run(10_800_000)
    assert "mountfw.position" in rig.port.files
    return rig


def test_a_record_of_the_position_goes_when_a_hand_turns_the_shaft():
    rig = recorded()
    rig.motor1.at += 1  # less than a dead band is no turn
    rig.run(100_000)
    assert "mountfw.position" in rig.port.files
    rig.motor1.at += 100
    rig.run(100_000)
    assert "mountfw.position" not in rig.port.files
    rig.run(10_800_000)
    again = encoded(rig.port.files, b"")
    assert abs(status(again)[0] - 1361) <= 8
    assert status(again)[1] == codes.COUNTED  # while it was off nobody measured


def test_a_record_goes_so_too_when_a_query_has_seen_the_hand_first():
    rig = recorded()
    rig.motor1.at += 100
    rig.send(b"XS?\n")
    rig.run(200_000)
    at = rig.axis1.position.millisteps
    assert "mountfw.position" not in rig.port.files
    rig.run(11_000_000)
    assert status(encoded(dict(rig.port.files), b"")) == (at, codes.COUNTED)
    unset = encoded(dict(rig.port.files) | {"mountfw.settings": seal("")}, b"")
    assert status(unset) == (at, codes.ESTIMATED)  # in the open loop, between two steps


def test_a_record_goes_when_a_smaller_dead_band_calls_what_was_turned_a_turn():
    rig = encoded(settings=b"XN280;MM1;DB100")
    rig.ask(b"1DH0\n")
    rig.run(13_000_000)
    rig.motor1.at += 80
    rig.run(200_000)
    assert "mountfw.position" in rig.port.files
    rig.ask(b"1DB1\n")
    rig.run(200_000)
    assert "mountfw.position" not in rig.port.files


def test_counts_that_come_as_the_record_is_written_are_in_it():
    rig = encoded(settings=b"XN280;MM1;DB20")
    rig.ask(b"1DH0\n")
    rig.run(5_000_000)
    records = rig.controller.records
    counts = rig.motor1.counts
    record = []

    def turned_late():
        """The shaft turns between the last look at it and the record: 18 counts, which is no turn."""
        if records.waiting and not record and rig.now() - late_us > 9_990_000:
            record.append(rig.now())
            rig.motor1.at += 18
        return counts()

    late_us = rig.now() - 5_000_000
    rig.motor1.counts = turned_late
    rig.run(13_000_000)
    assert record and "mountfw.position" in rig.port.files
    rig.motor1.at -= 37  # of what was recorded
    rig.run(200_000)
    assert "mountfw.position" not in rig.port.files


def test_after_a_run_to_a_soft_limit_the_encoder_is_looked_at_as_after_any_move():
    rig = encoded(settings=b"XN280;MM1;DB1;SR3;SL-3;ZH8")
    rig.ask(b"1DH0;SM\n")
    rig.run(300_000)
    move(rig, b"1MV+\n")
    assert ended(rig)[0] == codes.SOFT_LIMIT
    rig.run(11_000_000)
    at = status(rig)[0]
    assert at > 3000 and status(encoded(dict(rig.port.files), b"")) == (at, codes.COUNTED)
    rig.motor1.at += 900
    rig.run(100_000)
    assert "mountfw.position" not in rig.port.files


def test_a_sensor_whose_lowest_bits_flicker_at_rest_has_a_record_all_the_same():
    rig = encoded(settings=b"XN97;MM1;DB1;XG80", port=GearedPort)
    rig.ask(b"1DH0\n")
    counts = rig.motor1.counts
    rig.motor1.counts = lambda: counts() + (rig.motor1.reads & 3)
    rig.run(12_000_000)
    assert "mountfw.position" in rig.port.files
    rig.motor1.at += 60  # a hand: more than the play of the gears
    rig.run(500_000)
    assert "mountfw.position" not in rig.port.files


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
    rig.run(10_800_000)
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


def test_a_record_without_an_angle_keeps_its_position_as_the_estimate_that_it_is():
    rig = encoded(settings=b"XN102;MM1")
    on_screw(rig, 300)
    rig.ask(b"1DH0;SM\n")
    rig.run(300_000)
    move(rig, b"1PR100\n")
    at = rig.motor1.at
    rig.motor1.gone = True
    rig.motor1.angle = lambda: -1
    rig.run(11_500_000)
    again = started_again(dict(rig.port.files), at)
    assert (again.axis1.position.millisteps, again.axis1.position.certainty) == (100_000, codes.ESTIMATED)


def test_the_first_answer_of_a_sensor_that_was_silent_at_the_start_is_no_motion():
    rig = encoded(settings=b"XN102;MM1")
    on_screw(rig, 700)
    rig.ask(b"1DH9;SM\n")
    rig.run(11_500_000)
    assert "mountfw.position" in rig.port.files
    again = encoded(dict(rig.port.files), b"")
    again.motor1.gone = True
    again.controller.reset()
    assert status(again) == (9000, codes.ESTIMATED)
    again.motor1.at += 700
    again.motor1.slips += 1
    again.motor1.gone = False
    again.run(200_000)
    assert status(again) == (9000, codes.ESTIMATED)
    again.motor1.at += 102  # a hand, from here on
    again.run(200_000)
    assert status(again) == (10_000, codes.ESTIMATED)


def test_a_position_that_was_measured_in_other_steps_is_not_known_again():
    for saved, meanwhile, known in (
        (b"XN280;MM1", b"1XN140", codes.UNKNOWN),
        (b"XN280;MM1", b"1DB2", codes.COUNTED),
        (b"XN280", b"1MM1", codes.COUNTED),
        (b"XN280", b"1XN140;1MM1", codes.ESTIMATED),  # by time from now on, as after MM0
    ):
        rig = encoded(settings=saved + b";SM")
        rig.run(200_000)
        rig.ask(meanwhile + b";1DH0\n")
        move(rig, b"1PR2\n")
        rig.run(11_500_000)
        at = status(rig)[0]
        assert "mountfw.position" in rig.port.files
        assert status(encoded(dict(rig.port.files), b"")) == (at if known else 0, known)


def test_a_step_of_another_length_is_remembered_over_a_restart_until_the_loop_opens():
    rig = encoded()
    rig.ask(b"1DH0\n")
    move(rig, b"1PR4\n")
    rig.ask(b"1XP100000;SM\n")
    rig.run(11_500_000)
    again = encoded(dict(rig.port.files), b"")
    assert status(again)[1] == codes.COUNTED
    again.ask(b"1MM0\n")
    assert status(again)[1] == codes.ESTIMATED


def test_a_record_of_a_firmware_that_did_not_note_the_step_is_known_again():
    rig = encoded()
    rig.ask(b"1DH3;SM\n")
    rig.run(11_500_000)
    files = dict(rig.port.files)
    lines = unseal(files["mountfw.position"])
    files["mountfw.position"] = seal("".join([line.rsplit(" ", 2)[0] + "\n" for line in lines]))
    assert status(encoded(files, b"")) == (3000, codes.COUNTED)
