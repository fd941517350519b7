"""Boards of three and four axes: what drives, stops and saves two does so for all. On CPython and MicroPython."""

from mountfw import codes
from mountfw.settings import SETTINGS

from rig import Board, Rig  # isort: skip

AXIS_3 = {"en": 16, "pos": 17, "neg": 18, "stop_pos": 19, "stop_neg": 20}
AXIS_4 = {"en": 22, "pos": 26, "neg": 27, "stop_pos": None, "stop_neg": None}
EN = (2, 5, 16, 22)
EMERGENCY_STOP = 14
RECORDED_US = 10_700_000  # after so long a rest the positions are recorded
ALL_RUN = b"1MV+;2MV-;3MV+;4MV-\n"
ALL_DRIVE = (255, -255, 255, -255)


def board(axes, emergency_stop=False):
    made = Board()
    made.AXIS_3 = AXIS_3
    if axes > 3:
        made.AXIS_4 = AXIS_4
    if emergency_stop:
        made.EMERGENCY_STOP = EMERGENCY_STOP
    return made


def running(axes=4):
    """A rig on which every axis runs."""
    rig = Rig(board(axes))
    rig.ask(ALL_RUN[: 5 * axes - 1] + b"\n")
    assert rig.drives() == ALL_DRIVE[:axes]
    rig.port.edges.clear()
    return rig


def restart(rig, axes=3):
    """Power off and on, with a board file of so many axes; the files stay."""
    return Rig(Board() if axes == 2 else board(axes), dict(rig.port.files))


def reasons(rig):
    return [axis.reason for axis in rig.axes]


# ---- stops


def test_every_stop_stops_every_axis_and_every_enable_is_low_before_anything_else_changes():
    for axes in (3, 4):
        for stop, reason in (
            (b"!", codes.ABORTED),
            (b"00000000", codes.STOPPED),
            (b"-000-000", codes.STOPPED),
            (b"AB\n", codes.ABORTED),
            (b"ST\n", codes.STOPPED),
            (b"3PR1;?\n", codes.STOPPED),  # malformed
            (b"1TP?!\n", codes.ABORTED),
            (b"0255000000000\n", codes.STOPPED),
        ):
            rig = running(axes)
            rig.send(stop)
            rig.settle()
            assert rig.drives() == (0,) * axes, stop
            assert set(reasons(rig)) == {reason}, stop
            assert not rig.controller.moving()
            if stop != b"ST\n":  # it ends one axis after the other
                falls = [pin for _, pin, duty in rig.port.edges if not duty and pin in EN]
                changed = [pin for _, pin, duty in rig.port.edges if not duty]
                assert changed[:axes] == falls == list(EN[:axes]), (stop, changed)


def test_a_stop_is_as_soon_for_the_fourth_axis_as_it_is_received():
    rig = running(4)
    rig.send(b"!")
    sent = rig.now()
    rig.settle()
    assert max(us for us, _, _ in rig.port.edges) - sent < 500


def test_a_restart_turns_every_axis_off_and_makes_it_new():
    rig = running(4)
    rig.ask(b"3XP1000;4XP2000;3XP?;4XP?\n")
    rig.ask(b"3AB;3XP1000;4XP2000\n")
    rig.ask(b"*RST\n")
    assert rig.drives() == (0, 0, 0, 0)
    assert rig.ask(b"3XP?;4XP?\n") == b"200000; 200000\r\n"
    assert reasons(rig) == [codes.NONE_YET] * 4


def test_a_lost_keep_alive_stops_every_axis():
    for line, at in ((b"XK100;3MV+\n", 2), (b"XK100;4MV-\n", 3)):
        rig = Rig(board(4))
        rig.ask(line)
        assert rig.drives()[at]
        rig.run(150_000)
        assert rig.drives() == (0, 0, 0, 0)
        assert rig.axes[at].reason == codes.KEEP_ALIVE
        assert rig.errors() == [codes.KEEP_ALIVE_LOST]


def test_the_emergency_stop_cuts_every_axis_and_inhibits_it_until_a_reset():
    for polled in (False, True):
        rig = Rig(board(4, True))
        rig.port.switches[EMERGENCY_STOP] = 0
        rig.ask(b"*RST\n")
        rig.ask(ALL_RUN)
        assert rig.drives() == ALL_DRIVE
        rig.port.switches[EMERGENCY_STOP] = 1
        if not polled:
            rig.port.handlers[EMERGENCY_STOP](None)
            assert rig.drives() == (0, 0, 0, 0)  # by the interrupt alone
        rig.run(1_000)
        assert rig.drives() == (0, 0, 0, 0)
        assert rig.errors() == [143, 243, 343, 443]
        assert reasons(rig) == [codes.EMERGENCY_STOP] * 4
        rig.port.switches[EMERGENCY_STOP] = 0
        rig.ask(b"3PR1;4MV+\n")
        assert rig.drives() == (0, 0, 0, 0)
        assert rig.errors() == [343, 443]


def test_what_precedes_an_unparsed_stop_drives_no_axis():
    rig = Rig(board(4))
    rig.send(b"3MV+;4MV+;3PR5\n" + b"1TP?;" * 15 + b"\n!")
    rig.settle()
    assert [pin for _, pin, duty in rig.port.edges if duty] == []
    rig.ask(b"3MV+\n")
    assert rig.drives() == (0, 0, 255, 0)


def test_a_fault_inside_the_loop_leaves_no_axis_driven():
    rig = running(3)
    rig.controller.shutdown(codes.FAULT)
    assert rig.drives() == (0, 0, 0)
    assert reasons(rig) == [codes.FAULT] * 3


# ---- frames


def test_a_frame_drives_axes_1_and_2_and_leaves_the_others_as_they_are():
    rig = Rig(board(4))
    rig.ask(b"3MV+;4MV-\n")
    rig.ask(b"0100-200")
    assert rig.drives() == (100, -200, 255, -255)
    rig.ask(b"00000200")
    assert rig.drives() == (0, 200, 255, -255)
    assert rig.axes[2].reason == rig.axes[3].reason == codes.NONE_YET


# ---- motion


def test_pulses_of_all_axes_at_once_have_their_length():
    for lengths in ((20_000, 21_000, 22_000, 23_000), (23_000, 22_000, 21_000, 20_000)):
        rig = Rig(board(4))
        rig.ask(b"1XP%d;2XP%d;3XP%d;4XP%d\n" % lengths)
        rig.ask(b"1PR3;2PR-3;3PR3;4PR-3\n")
        rig.run(3_000_000)
        for pin, length in zip(EN, lengths):
            times = rig.on_times(pin)
            assert len(times) == 3, pin
            for us in times:
                assert abs(us - length) < 200, (pin, times)
        assert rig.ask(b"1TP?;2TP?;3TP?;4TP?\n") == b"3; -3; 3; -3\r\n"
        assert reasons(rig) == [codes.DONE] * 4


def test_a_third_axis_drives_its_own_pins_and_no_others():
    rig = Rig(board(3))
    rig.port.edges.clear()
    rig.ask(b"3PR-1\n")
    rig.run(300_000)
    assert [(pin, duty > 0) for _, pin, duty in rig.port.edges] == [(18, True), (16, True), (16, False), (18, False)]


def test_an_end_stop_of_the_third_axis_ends_its_move_by_an_interrupt_and_without():
    for interrupt in (True, False):
        rig = Rig(board(3))
        rig.port.switches[19] = 0
        rig.port.switches[20] = 0
        rig.ask(b"3XL3\n")
        rig.ask(b"1MV+;3MV+\n")
        assert rig.drives() == (255, 0, 255)
        rig.port.switches[19] = 1
        if interrupt:
            rig.port.handlers[19](None)
            assert rig.drives() == (255, 0, 0)
        rig.run(1_000)
        assert rig.drives() == (255, 0, 0)
        assert rig.axes[2].reason == codes.END_STOP
        assert rig.errors() == [304]


def test_the_third_axis_finds_home():
    rig = Rig(board(3))
    at_us = 300_000  # where its screw stands, in microseconds of full drive; the negative switch is at 0
    rig.port.switches[19] = rig.port.switches[20] = 0
    rig.ask(b"3XL3;3DH7\n")
    rig.send(b"3OR\n")
    seen_us = rig.port.us
    until = rig.port.us + 10_000_000
    rig.port.horizon_us = until
    while rig.port.us < until and (rig.axes[2].moving() or not rig.axes[2].reason):
        drive = rig.drives()[2]
        rig.step()
        at_us += drive * (rig.port.us - seen_us) // 255
        seen_us = rig.port.us
        rig.port.switches[20] = 1 if at_us <= 0 else 0
    assert rig.ask(b"3TP?;3XE?\n").startswith(b"0; 1,")
    assert rig.axes[2].position.certainty == codes.HOMED
    assert -30_000 < at_us <= 0
    assert rig.drives() == (0, 0, 0)
    assert rig.errors() == []


def test_the_led_blinks_while_only_the_third_axis_drives():
    rig = Rig(board(3))
    rig.run(300_000)
    rig.port.shown.clear()
    rig.run(500_000)
    assert rig.port.shown == []
    rig.ask(b"3MV+\n")
    rig.run(2_000_000)
    assert len(rig.port.shown) > 2


# ---- the dialect


def test_the_status_has_a_part_for_each_axis():
    for axes in (3, 4):
        rig = Rig(board(axes))
        rig.ask(b"1DH1;2DH-2;3DH33;4DH-44\n")
        rig.errors()
        rig.ask(b"3MV-\n")
        head, *parts = rig.ask(b"XS?\n").rstrip().split(b"|")
        assert len(head.split(b",")) == 3
        assert parts[0] == b"1000,0,0,0,0,1"
        assert parts[1] == b"-2000,0,0,0,0,1"
        assert parts[2].split(b",")[1:] == [b"1", b"-1", b"0", b"0", b"3"]  # a run is an estimate
        assert parts[3:] == [b"-44000,0,0,0,0,1"][: axes - 3]


def test_the_end_stops_of_the_third_axis_are_bits_6_and_7():
    rig = Rig(board(3))
    rig.port.switches[19] = 0
    rig.ask(b"1XL1;3XL3\n")
    assert rig.ask(b"PH?\n") == b"129\r\n"
    rig.port.switches.update({10: 0, 19: 1, 20: 0})
    assert rig.ask(b"PH?\n") == b"64\r\n"


def test_an_axis_above_those_of_the_board_file_answers_as_not_connected():
    rig = Rig(board(3))
    assert rig.ask(b"3TP?;4TP?;4MD?\n") == b"0; 0; 1\r\n"
    rig.ask(b"3PR0;4PR1;4ST;5PR1\n")
    assert rig.errors() == [408, 9]
    rig = Rig(board(4))
    rig.ask(b"4PR0\n")
    assert rig.errors() == []


def test_what_is_refused_while_an_axis_moves_is_refused_while_the_third_does():
    for line in (b"SM\n", b"*RCL0\n", b"*RCL1\n", b"XX\n"):
        rig = Rig(board(3))
        rig.ask(b"1XP1000;3MV+\n")
        rig.ask(line)
        rig.run(200_000)
        assert rig.errors() == [314], line
        assert rig.ask(b"1XP?\n") == b"1000\r\n", line
        assert "mountfw.settings" not in rig.port.files


# ---- what is saved


def test_settings_of_every_axis_are_saved_and_restored():
    rig = Rig(board(4))
    for axis in (1, 2, 3, 4):
        rig.ask(b"%dXP%d;%dXD%d;%dXI1\n" % (axis, 1000 * axis, axis, 10 * axis, axis))
    rig.ask(b"3XL3\n")
    rig.ask(b"SM\n")
    rig.run(200_000)
    rig.port.switches.clear()
    again = restart(rig, 4)
    assert again.errors() == []
    for axis in (1, 2, 3, 4):
        assert again.ask(b"%dXP?;%dXD?;%dXI?\n" % (axis, axis, axis)) == b"%d; %d; 1\r\n" % (1000 * axis, 10 * axis)
    assert again.ask(b"3XL?\n") == b"3\r\n"
    for before, after in zip(rig.axes, again.axes):
        for entry in SETTINGS:
            assert getattr(before, entry[1]) == getattr(after, entry[1]), entry
    again.ask(b"*RCL0\n")
    assert again.ask(b"3XP?;4XP?\n") == b"200000; 200000\r\n"


def test_a_file_of_two_axes_is_read_on_a_board_of_three_and_of_three_all_but_the_third_on_one_of_two():
    rig = Rig()
    rig.ask(b"1XP1000;2XP2000\n")
    rig.ask(b"SM\n")
    rig.run(200_000)
    three = restart(rig, 3)
    assert three.ask(b"1XP?;2XP?;3XP?\n") == b"1000; 2000; 200000\r\n"
    assert three.errors() == []
    three.ask(b"3XP3000\n")
    three.ask(b"SM\n")
    three.run(200_000)
    two = restart(three, 2)
    assert two.ask(b"1XP?;2XP?\n") == b"1000; 2000\r\n"
    assert two.errors() == [codes.SETTINGS_LEFT_OUT]


def rested(rig, line):
    """Do that line, and rest until the positions are recorded."""
    rig.ask(line)
    rig.run(1_000_000)
    rig.run(RECORDED_US)
    assert "mountfw.position" in rig.port.files
    return rig


def test_positions_of_every_axis_are_known_again_and_forgotten_before_any_of_them_drives():
    rig = rested(Rig(board(4)), b"1DH1;2DH-2;3DH33;4DH-44;3PR2\n")
    again = restart(rig, 4)
    assert again.ask(b"1TP?;2TP?;3TP?;4TP?\n") == b"1; -2; 35; -44\r\n"
    assert [axis.position.certainty for axis in again.axes] == [codes.COUNTED] * 4
    again.port.edges.clear()
    again.port.file_log.clear()
    again.ask(b"4MV+\n")
    removed_us = [us for us, what, _ in again.port.file_log if what == "remove"]
    driven_us = [us for us, pin, duty in again.port.edges if duty and pin == EN[3]]
    assert len(removed_us) == 1 and removed_us[0] <= driven_us[0]
    assert [axis.position.certainty for axis in restart(again, 4).axes] == [codes.UNKNOWN] * 4


def test_a_record_of_two_axes_leaves_a_third_unknown():
    rig = rested(Rig(), b"1DH1;2DH-2\n")
    three = restart(rig, 3)
    assert [axis.position.certainty for axis in three.axes] == [codes.COUNTED, codes.COUNTED, codes.UNKNOWN]
    assert three.ask(b"1TP?;2TP?;3TP?\n") == b"1; -2; 0\r\n"
    assert three.errors() == []
    three.ask(b"3MV+\n")  # and what it says is gone before the third drives
    assert three.drives() == (0, 0, 255)
    assert "mountfw.position" not in three.port.files


# ---- memory


def test_the_loop_allocates_nothing_with_four_axes():
    rig = Rig(board(4, True))
    rig.port.switches[EMERGENCY_STOP] = 0
    rig.ask(b"*RST\n")
    rig.port.switches[19] = rig.port.switches[20] = 0
    rig.port.locked = True
    for line in (
        b"XS?;PH?;3XE?\n",
        b"3XL3;3ZH0\n",
        b"3PR2;4PR-2;1PR1\n",
        b"3MV+;4MV-\n",
        b"02550255",
        b"ST\n",
        b"3OR\n",
        b"4MV+;!\n",
        b"3MV+\n00000000",
        b"SM1;XX1;*RCL2\n",
    ):
        rig.send(line)
        rig.settle()
        rig.run(300_000)
    rig.port.switches[EMERGENCY_STOP] = 1
    rig.run(100_000)
    rig.port.locked = False
    assert rig.drives() == (0, 0, 0, 0)
