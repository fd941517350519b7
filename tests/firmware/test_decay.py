"""PWM frequency and decay, at the pins: what drives, what a pause is, and that all is off when it has to be."""

from rig import Board, Rig

from mountfw.boards import pico, pico_drv8833

HIGH = 65535
OFF = (0, 0, 0)


def pins(rig, axis=1):
    """Duties of enable (0 where there is none), `pos` and `neg`."""
    of = rig.board.AXIS_1 if axis == 1 else rig.board.AXIS_2
    return tuple([rig.port.pins.get(of[name], 0) for name in ("en", "pos", "neg")])


def rigs():
    """A rig with each bridge and each decay, at 25 Hz, with switches that are closed."""
    for board in (pico, pico_drv8833):
        for slow in (0, 1):
            rig = Rig(Board(board))
            rig.port.switches.update({10: 0, 11: 0, 12: 0, 13: 0})
            rig.ask(b"1XY%d;2XY%d;1XQ25;2XQ25;1XL3;2XL3\n" % (slow, slow))
            assert rig.ask(b"TB?;1XY?;1XQ?\n") == b"0, NO ERROR DETECTED; %d; 25\r\n" % slow
            yield rig


def driving(frame):
    for rig in rigs():
        rig.ask(frame)
        yield rig, pins(rig)


def test_fast_decay_has_a_duty_on_one_pin_and_slow_decay_a_pause_with_both_legs_alike():
    shown = [found for _, found in driving(b"01000000")]
    assert shown == [
        (100 * 257, HIGH, 0),
        (HIGH, 100 * 257, 0),
        (0, 100 * 257, 0),
        (0, HIGH, 155 * 257),
    ]
    shown = [found for _, found in driving(b"-1000000")]
    assert shown == [
        (100 * 257, 0, HIGH),
        (HIGH, 155 * 257, HIGH),
        (0, 0, 100 * 257),
        (0, 155 * 257, HIGH),
    ]


def test_full_duty_is_three_levels_whatever_the_decay():
    for frame, legs in ((b"02550000", (HIGH, 0)), (b"-2550000", (0, HIGH))):
        for rig, found in driving(frame):
            assert found == (HIGH if rig.board.AXIS_1["en"] is not None else 0,) + legs


def test_a_step_is_a_pulse_of_levels_after_a_run_with_a_duty():
    for rig in rigs():
        rig.ask(b"01000000")
        rig.ask(b"!\n")
        del rig.port.edges[:]
        rig.ask(b"1PR1\n")
        assert pins(rig)[1:] == (HIGH, 0)
        rig.run(300_000)
        assert pins(rig) == OFF
        assert [duty for _, _, duty in rig.port.edges if 0 < duty < HIGH] == []


def us_to_off(rig, stop):
    """From sending a stop, while both motors have a duty, to the last edge. All pins are low then."""
    rig.ask(b"0100-100")
    assert pins(rig, 1) != OFF and pins(rig, 2) != OFF
    del rig.port.edges[:]
    since_us = rig.now()
    stop(rig)
    assert pins(rig, 1) == pins(rig, 2) == OFF
    return max([us for us, _, _ in rig.port.edges]) - since_us


def test_every_stop_brings_all_pins_low_as_soon_with_slow_decay_as_with_fast():
    def sends(data):
        return lambda rig: rig.ask(data)

    def opens(rig):  # both end-stops ahead
        rig.port.switches.update({10: 1, 13: 1})
        rig.run(20_000)

    def falls_silent(rig):
        rig.ask(b"XK50\n")
        rig.run(100_000)

    def loop_fails(rig):
        rig.controller.shutdown()

    stops = [sends(data) for data in (b"!", b"0" * 8, b"AB\n", b"ST\n", b"255255")]
    for stop in stops + [opens, falls_silent, loop_fails]:
        late_us = [us_to_off(rig, stop) for rig in rigs()]
        for fast_us, slow_us in (late_us[:2], late_us[2:]):
            assert slow_us <= fast_us + 30, late_us  # one more write of a leg, after the drive is off


def test_a_stop_cuts_a_slow_decay_with_the_first_writes_and_no_pin_rises_after_it():
    for rig in rigs():
        rig.ask(b"0100-100")
        del rig.port.edges[:]
        rig.ask(b"!\n")
        assert rig.port.edges and not any(duty for _, _, duty in rig.port.edges)


def test_a_reversal_goes_through_off_and_the_dead_time():
    for rig in rigs():
        rig.ask(b"01000000")
        del rig.port.edges[:]
        rig.ask(b"-1000000")
        now = {}
        off_at = None
        for us, pin, duty in rig.port.edges:
            now[pin] = duty
            if duty == 0 and off_at is None:
                off_at = us
            carriers = [rig.board.AXIS_1[name] for name in ("en", "pos", "neg")]
            if duty and pin == carriers[0]:
                assert us - off_at >= rig.board.DEAD_TIME_US
        first = rig.port.edges[0]
        assert first[2] == 0  # what drives goes first


def test_the_frequency_is_set_on_the_pins_that_may_carry_the_duty_and_0_is_the_board_files():
    rig = Rig()
    made = dict(rig.port.hz)
    assert made == {2: 4000, 3: 4000, 5: 4000, 6: 4000}
    rig.ask(b"1XQ25\n")
    assert rig.port.hz == {2: 25, 3: 25, 5: 4000, 6: 4000}
    rig.ask(b"1XQ0\n")
    assert rig.port.hz == made


def test_what_cannot_be_is_refused_and_changes_nothing():
    rig = Rig()
    rig.ask(b"1XQ19;1XQ20001;1XY2\n")
    assert [rig.ask(b"TE?\n") for _ in range(4)] == [b"7\r\n"] * 3 + [b"0\r\n"]
    rig.ask(b"1MV+;1XQ25;1XY1\n")
    assert rig.ask(b"TE?;TE?;TE?\n") == b"114; 114; 0\r\n"
    rig.ask(b"!\n")
    assert rig.ask(b"1XQ?;1XY?\n") == b"0; 0\r\n" and rig.port.hz[2] == 4000


def test_a_slice_that_another_axis_uses_keeps_its_frequency_and_its_decay():
    board = Board()
    # its enable and `pos` are at slices 1 and 2, as those of axes 1 and 2
    setattr(board, "AXIS_3", {"en": 19, "pos": 20, "neg": 21, "stop_pos": None, "stop_neg": None})  # noqa: B010
    rig = Rig(board)
    for axis in (1, 2, 3):
        rig.ask(b"%dXQ25;%dXY1\n" % (axis, axis))
        assert rig.ask(b"TE?;TE?;TE?\n") == b"%d35; %d35; 0\r\n" % (axis, axis)
        rig.ask(b"%dXQ0;%dXY0\n" % (axis, axis))
        assert rig.ask(b"TE?\n") == b"0\r\n"
    assert 3 not in rig.port.hz  # that leg has no PWM: its output is that of axis 3's enable


def test_a_port_that_cannot_change_its_pwm_refuses_both():
    rig = Rig()
    for axis in rig.axes:
        axis.drive.bridge.made_hz = 0
    rig.ask(b"1XQ25;1XY1;1XQ0;1XY0\n")
    assert rig.ask(b"TE?;TE?;TE?\n") == b"135; 135; 0\r\n"


def test_saved_they_are_there_after_a_restart_and_gone_with_rcl0():
    rig = Rig()
    rig.ask(b"1XY1;1XQ50;SM\n")
    rig.run(200_000)
    again = Rig(rig.board, rig.port.files)
    assert again.port.hz[2] == 50
    again.ask(b"01000000")
    assert pins(again) == (HIGH, 100 * 257, 0)
    again.ask(b"!\n*RCL0\n")
    assert again.port.hz[2] == 4000
    again.ask(b"01000000")
    assert pins(again) == (100 * 257, HIGH, 0)
