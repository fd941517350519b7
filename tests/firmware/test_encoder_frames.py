"""Frames that come while an encoder is looked at, with a fast lane. Runs under CPython and MicroPython."""

from lane_rig import LanePort

from mountfw import codes

from rig_encoder import EncoderPort, encoded, why  # isort: skip


class LaneEncoderPort(EncoderPort):
    lane = LanePort.lane


def driven(frame):
    """A rig in the closed loop whose motors run at this frame."""
    rig = encoded(port=LaneEncoderPort)
    rig.run(200_000)  # no frame is taken for an echo
    rig.send(frame)
    rig.take_in()
    rig.run(300_000)
    return rig


def test_a_stop_that_comes_while_an_encoder_is_looked_at_cuts_at_once():
    rig = driven(b"0255-255")
    counts = rig.motor2.counts

    def meanwhile():
        rig.motor2.counts = counts
        rig.send(b"!")
        return counts()

    rig.motor2.counts = meanwhile
    rig.controller.service(rig.port.ticks_us())
    assert rig.drives() == (0, 0)
    rig.run(20_000)
    assert why(rig)[0] == codes.ABORTED


def test_frames_that_come_in_each_look_do_not_hide_a_stall():
    for rest_s in (0, 600):  # after the latter an interval since the last look in a move has wrapped
        rig = driven(b"0255-255")
        rig.ask(b"!\n")
        rig.port.us += rest_s * 1_000_000
        rig.run(1_000_000)
        rig.motor1.stuck = True
        counts = rig.motor1.counts

        def meanwhile(rig=rig, counts=counts):
            if rig.axis1.state and rig.port.taken == len(rig.port.inbox):
                rig.send(b"0255-255" if rig.motor1.reads % 2 else b"0250-255")
            return counts()

        rig.motor1.counts = meanwhile
        since = rig.now()
        rig.send(b"0255-255")
        rig.run(110_000)
        off = [us for us, pin, duty in rig.port.edges if us > since and pin == 2 and not duty]
        assert off and off[0] - since < 80_000, rest_s
        assert rig.controller.errors.pop() == 147


def test_frames_do_not_hide_counts_that_are_too_few():
    rig = driven(b"0255-255")
    follows = rig.axis1.watch.follows

    def behind(now_us):
        """A frame comes behind each judgement that it does not follow."""
        if follows(now_us):
            return True
        rig.send(b"0255-255")
        return False

    rig.axis1.watch.follows = behind
    rig.motor1.supply = 0.1
    rig.run(1_000_000)
    assert rig.controller.errors.pop() == 144


def test_a_first_look_that_comes_late_takes_nothing_for_a_stall():
    rig = driven(b"0255-255")
    rig.ask(b"!\n")
    rig.run(300_000)
    rig.send(b"0255-255")
    rig.port.horizon_us = rig.port.us + 1_000
    while not rig.axis1.state:
        rig.app._read(0)
    rig.port.us += 65_000  # garbage was collected, or flash erased
    rig.run(200_000)
    assert rig.axis1.state and not rig.controller.errors.waiting


def test_where_a_motor_turns_back_in_the_gap_is_seen():
    rig = encoded(settings=b"XN280;MM1;DB1;XB60000", port=LaneEncoderPort)
    rig.run(200_000)
    rig.send(b"0255+000")
    rig.run(1_000_000)
    rig.ask(b"!\n")
    rig.run(300_000)
    gap = rig.axis1.measured._gap_counts
    at, most = rig.motor1.at, [0]
    turn = rig.motor1.turn

    def watched(us):
        while rig.motor1.us < us:
            turn(min(us, rig.motor1.us + 500))
            most[0] = max(most[0], rig.motor1.at - at)

    rig.motor1.turn = watched
    place = rig.axis1.measured.place
    rig.send(b"0255+000")
    rig.run(300_000)
    rig.send(b"-255+000")
    rig.run(60_000)
    rig.ask(b"!\n")
    rig.run(300_000)
    assert gap > 80 and most[0] - (rig.motor1.at - at) < gap  # it is still in there
    assert abs(rig.axis1.measured.place - place - most[0]) < 2
