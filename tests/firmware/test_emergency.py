"""The emergency stop, and switches that open between any two steps of the firmware."""

from rig import Board, Rig

STOP = 14  # where it is wired here: closed is 0


def with_emergency_stop():
    board = Board()
    board.EMERGENCY_STOP = STOP
    rig = Rig(board)
    rig.port.switches[STOP] = 0
    rig.ask(b"*RST\n")  # it was open, as a broken wire is, while the rig was made
    return rig


def test_without_one_in_the_board_file_nothing_is_asked_of_that_pin():
    rig = Rig()
    assert STOP not in rig.port.handlers
    rig.ask(b"02550255")
    assert rig.drives() == (255, 255)


def test_it_turns_both_motors_off_and_ends_both_moves():
    for move in (b"02550255", b"1MV+;2MV-\n", b"1PR5;2PR5\n", b"1PR5\n02550255"):
        rig = with_emergency_stop()
        rig.ask(move)
        assert rig.drives() != (0, 0)
        rig.port.switches[STOP] = 1
        opened = rig.now()
        rig.run(2_000)
        assert rig.drives() == (0, 0)
        assert max(us for us, _, _ in rig.port.edges) - opened < 1_000
        assert [rig.ask(b"%dXE?\n" % axis).split(b",")[0] for axis in (1, 2)] == [b"10", b"10"], move
        assert rig.errors() == [143, 243]


def test_it_latches_until_a_reset():
    rig = with_emergency_stop()
    rig.port.switches[STOP] = 1
    rig.run(100_000)
    rig.port.switches[STOP] = 0
    rig.run(100_000)
    for axis, motion in ((1, b"1PR1\n"), (2, b"2MV+\n"), (1, b"1PA5\n"), (2, b"00000255"), (1, b"-2550000")):
        rig.ask(motion)
        assert rig.drives() == (0, 0), motion
        assert rig.errors() == [axis * 100 + 43], motion
    rig.ask(b"*RST\n")
    rig.ask(b"02550000")
    assert rig.drives() == (255, 0)


class Tap(dict):
    """Switches, of which one is open from since_us to until_us."""

    since_us = until_us = 0

    def get(self, pin, default=None):
        if pin == STOP:
            return 1 if self.since_us <= self.port.us < self.until_us else 0
        return super().get(pin, default)


def test_a_tap_at_rest_latches_on_a_port_without_interrupts():
    for us in range(0, 260_000, 20_000):
        rig = with_emergency_stop()
        rig.port.switches = switches = Tap()
        switches.port = rig.port
        rig.run(500_000)
        switches.since_us = rig.port.us + us
        switches.until_us = switches.since_us + 100_000
        rig.run(500_000)
        assert rig.axis1.drive.emergency, us


def test_a_reset_does_not_help_while_it_is_open_or_its_wire_is_broken():
    rig = with_emergency_stop()
    del rig.port.switches[STOP]
    rig.ask(b"*RST\n02550255")
    assert rig.drives() == (0, 0)
    assert rig.errors() == [143, 243]


def test_a_reset_is_as_power_up_with_a_new_boot_id():
    rig = Rig()
    rig.ask(b"1XP1000;1VA9;2XI1;1DH7;XK500;1XL3;FOO\n1MV+\n")
    before = rig.ask(b"XS?\n").split(b",")[0]
    rig.ask(b"*RST\n")
    assert rig.drives() == (0, 0)
    assert rig.ask(b"1XP?;1VA?;2XI?;1TP?;XK?;1XL?;TE?\n") == b"200000; 2; 0; 0; 0; 0; 0\r\n"
    after = rig.ask(b"XS?\n")
    assert after.split(b",")[0] != before
    assert int(after.split(b",")[1]) < 100  # milliseconds since
    assert after.split(b"|")[1].split(b",")[4:] == [b"0", b"0"]  # no move yet, position unknown


def test_a_reset_with_a_value_is_refused():
    rig = Rig()
    rig.ask(b"1MV+\n*RST1\n")
    assert rig.drives() == (255, 0)
    assert rig.errors() == [7]


def opened_at(make, pin, commands, instants):
    """A rig on which the switch opened after so many instants of what the commands start."""
    rig = make()
    rig.port.opens = pin
    rig.send(commands)
    rig.port.instants = instants
    rig.run(30_000)
    return rig


def test_an_interrupt_between_any_two_steps_of_a_start_leaves_nothing_driven():
    for commands in (b"02550255", b"1MV+;2MV+\n", b"-255-255"):
        for instants in range(120):
            rig = opened_at(with_emergency_stop, STOP, commands, instants)
            assert rig.port.instants < 0
            assert rig.drives() == (0, 0), (commands, instants)
            assert not rig.controller.moving(), (commands, instants)


def with_end_stop():
    rig = Rig()
    rig.port.switches.update({10: 0, 11: 0})
    rig.ask(b"1XL3;1DH0\n")
    return rig


def test_an_end_stop_that_opens_between_any_two_steps_of_a_start_stops_the_axis_that_goes_into_it():
    for commands, blocked in ((b"02550255", True), (b"1MV+;2MV+\n", True), (b"-2550255", False)):
        for instants in range(120):
            rig = opened_at(with_end_stop, 10, commands, instants)
            assert rig.drives() == (0 if blocked else -255, 255), (commands, instants)
            assert rig.axis1.moving() != blocked, (commands, instants)


def test_an_end_stop_that_bounces_has_ended_the_move_all_the_same():
    rig = with_end_stop()
    rig.ask(b"1MV+\n")
    rig.port.switches[10] = 1
    rig.port.handlers[10](None)
    rig.port.switches[10] = 0
    cut = rig.now()
    rig.run(5_000)
    assert rig.drives() == (0, 0)
    reason, _, on_us = rig.ask(b"1XE?\n").split(b",")
    assert reason == b"4"
    assert abs(int(on_us) - rig.on_times(2)[0]) < 20
    assert rig.on_times(2)[0] <= cut
