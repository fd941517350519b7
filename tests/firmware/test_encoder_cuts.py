"""The power goes at any moment in the life of a board with an encoder, and a hand may turn the shaft while it is off.

What the next start says of its position must not be worth more than it is. Each point of each operation on a file, and
moments of each motion, are looked at: the files as they are then, and the place where the shaft comes to rest.
"""

from math import exp, log

from rig_cuts import cuttable
from rig_encoder import DRY, FLOOR, TAU_S, EncoderPort, encoded, finish

from mountfw import codes

PER_STEP = 102
TURN = 4096
REST_US = 10_800_000
NEAR = 12  # counts: the dead band, what a hand may turn without a look, and the sensor's play
_EVERY = 40  # passes of the loop
OFTEN = (codes.UNKNOWN, codes.COUNTED, codes.ESTIMATED)


class Watched(cuttable(EncoderPort)):
    """A port that notes what a power cut would leave, at each point of each operation on a file."""

    def __init__(self, files=None):
        super().__init__(files)
        self.cuts = []  # (files, counts at which motor 1 comes to rest, what was done)
        self.doing = ""

    def point(self):
        motor = self.motors[0]
        motor.catch_up()
        self.cuts.append((dict(self.files), motor.at + coast(motor.speed), self.doing))


def coast(speed):
    """The way that a motor at this speed turns on."""
    s = TAU_S * log(1 + abs(speed) / FLOOR)
    way = (abs(speed) + FLOOR) * TAU_S * (1 - exp(-s / TAU_S)) - DRY * TAU_S * s
    return way if speed > 0 else -way


def on_screw(rig):
    """Make motor 1's encoder one that knows its angle."""
    motor = rig.motor1
    motor.angle = lambda: motor.counts() & (TURN - 1)
    rig.axis1.position.look()


def life(absolute):
    """What a power cut leaves at each moment of a life with moves, a run, records, saves and hands."""
    rig = encoded(settings=b"XN%d;MM1" % PER_STEP, port=Watched)
    port, motor = rig.port, rig.motor1
    motor.at = 300
    motor.supply = 0.36  # a step's time is a step's counts, as in a run
    if absolute:
        on_screw(rig)
    port.doing = "zero"
    rig.ask(b"1DH0;SM\n")  # saved: a loop that is open at the next start asks no encoder
    rig.run(200_000)
    port.cuts.clear()
    zero = motor.at

    def rest(us=REST_US):
        rig.run(us)
        port.point()

    def move(line):
        rig.ask(line)
        passes = 0
        while rig.controller.moving():
            port.horizon_us = port.us + 1_000_000
            rig.step()
            passes += 1
            if passes % _EVERY == 0:
                port.point()
        port.point()

    for port.doing, line in (
        ("first move", b"1PR2\n"),
        ("stopped", b"1PR9\n"),
        ("back", b"1PR-3\n"),
        ("run", b"XK0;1XM400;1MV-\n"),
    ):
        move(line)
        rest()
        if port.doing == "back":
            port.doing = "saved"
            rig.ask(b"1XG70;SM\n")
            rest()

    def turn(counts):
        for _ in range(abs(counts)):
            motor.at += 1 if counts > 0 else -1
            rest(2_000)

    port.doing = "hand"
    turn(77)
    rest()
    port.doing = "hand, and a move at once"
    turn(-150)
    move(b"1PR1\n")
    rest()
    finish(rig)
    return port.cuts, zero


def restarted(files, at, absolute):
    """The certainty and the error of the position, in counts, at the next start."""
    again = encoded(dict(files), b"")
    again.motor1.at = at
    if absolute:
        on_screw(again)
    else:
        again.axis1.position.look()
    again.controller.records.restore()
    axis = again.axis1
    return axis.position.certainty, axis.position_now() * PER_STEP / 1000, again.errors()


def worth(absolute, turned):
    """Go through each cut with the shaft turned so far while the board is off."""
    cuts, zero = life(absolute)
    seen = {}
    certainties = set()
    for files, at, doing in cuts:
        key = (tuple(sorted(files.items())), round(at), turned)
        if key in seen:
            continue
        seen[key] = True
        certainty, place, errors = restarted(files, at + turned, absolute)
        certainties.add(certainty)
        where = (doing, certainty, place, at + turned - zero, errors)
        assert certainty in OFTEN, where  # nobody measured while it was off
        off = abs(place - (at + turned - zero))
        if not turned or (absolute and turned % TURN):
            assert certainty != codes.COUNTED or off <= NEAR, where
    return certainties


def test_a_position_that_is_counted_is_right_wherever_the_power_went():
    assert worth(False, 0) == {codes.UNKNOWN, codes.COUNTED}
    assert worth(True, 0) == {codes.ESTIMATED, codes.COUNTED}  # its angle tells within half a turn of 0


def test_what_a_hand_turned_while_the_board_was_off_is_told_by_an_encoder_on_the_screw():
    for turned in (51, -1000, 1900):
        assert codes.COUNTED not in worth(True, turned)


def test_nothing_is_measured_after_a_start_whatever_was_turned():
    worth(False, 700)
    worth(True, TURN)
