"""What is wrong with a board file, in words. Runs under CPython and MicroPython."""

from rig import Board, Port

from mountfw import board_file, boards, build
from mountfw.boards import (
    adafruit_feather_esp32s3,
    adafruit_feather_rp2040,
    pico,
    pico2,
    pico2_w,
    pico_drv8833,
    pico_w,
    rp2,
    seeed_xiao_rp2040,
)
from mountfw.ports import bridges


def said(**changes):
    """What the Pico's file says, changed."""
    values = board_file.values(pico)
    values.update(changes)
    return values


def pins(**changes):
    return dict(pico.AXIS_1, **changes)


def test_every_board_file_of_ours_is_good():
    for board in (pico, pico_w, pico2, pico2_w, pico_drv8833, rp2, seeed_xiao_rp2040, adafruit_feather_rp2040):
        assert board_file.fault(board_file.values(board)) == "", board
    assert board_file.fault(board_file.values(adafruit_feather_esp32s3), False) == ""


def test_an_axis_may_have_an_encoder():
    both = {"AXIS_1": pins(encoder=(8, 9)), "AXIS_2": dict(pico.AXIS_2, encoder=(26, 27))}
    assert board_file.fault(said(**both)) == ""
    assert board_file.fault(said(AXIS_1=pins(shaft=(8, 9)), AXIS_2=dict(pico.AXIS_2, shaft=(26, 27)))) == ""
    assert board_file.fault(said(AXIS_1=pins(encoder=(9, 8))), False) == ""


def test_a_slip_is_refused_in_words():
    two_pwm = dict(pico_drv8833.AXIS_1)
    for changes, words in (
        ({"BRIDGE": "Enable"}, "BRIDGE is 'Enable', not one of enable, two-pwm"),
        ({"BRIDGE": None}, "BRIDGE is None, not one of enable, two-pwm"),
        ({"BRIGDE": "enable"}, "BRIGDE is no name that a board file may have"),
        ({"emergency_stop": 14}, "emergency_stop is no name that a board file may have"),
        ({"NAME": "Pico"}, "NAME is 'Pico', not bytes"),
        ({"PWM_HZ": 4e3}, "PWM_HZ is 4000.0, not a whole number within 10 ... 200000"),
        ({"DEAD_TIME_US": -1}, "DEAD_TIME_US is -1, not a whole number within 0 ... 10000"),
        ({"ONE_CHANNEL": 1}, "ONE_CHANNEL is neither True nor False"),
        ({"LED": 13.0}, "LED is 13.0, neither a pin's number nor its name nor None"),
        ({"AXIS_1": (2, 3, 4)}, "AXIS_1 is no dictionary of pins"),
        ({"AXIS_1": pins(en=None)}, "AXIS_1: en is None, not a pin's number"),
        ({"AXIS_1": pins(pos="GP3")}, "AXIS_1: pos is 'GP3', not a pin's number"),
        ({"AXIS_1": pins(pos=True)}, "AXIS_1: pos is True, not a pin's number"),
        ({"AXIS_1": pins(stop_pos=1.0)}, "AXIS_1: stop_pos is 1.0, not a pin's number"),
        ({"AXIS_1": pins(enable=2)}, "AXIS_1: 'enable' is not one of en, pos, neg, stop_pos, stop_neg, encoder, shaft"),
        ({"AXIS_1": pins(encoder=8)}, "AXIS_1: encoder is 8, not two pins' numbers"),
        ({"AXIS_1": pins(encoder=(8, 9, 14))}, "AXIS_1: encoder is (8, 9, 14), not two pins' numbers"),
        ({"AXIS_1": pins(shaft=(8, None))}, "AXIS_1: shaft is (8, None), not two pins' numbers"),
        ({"AXIS_1": pins(encoder=(8, 9), shaft=(14, 15))}, "AXIS_1: has both an encoder and a shaft: one of them"),
        ({"AXIS_1": pins(encoder=(9, 8))}, "AXIS_1: encoder: pin 9 must be followed by pin 10"),
        ({"AXIS_1": pins(encoder=(9, 10))}, "pin 10 is used twice, at AXIS_1: stop_pos and at AXIS_1: encoder"),
        (
            {"AXIS_1": pins(shaft=(15, 16))},
            "AXIS_1: shaft: SDA is an even pin, not 15 (data sheet, functions of the pins)",
        ),
        (
            {"AXIS_1": pins(shaft=(8, 9)), "AXIS_2": dict(pico.AXIS_2, shaft=(16, 17))},
            "AXIS_2: shaft: its bus is that of AXIS_1, and both sensors have one address",
        ),
        ({"AXIS_1": {"en": 2, "pos": 3, "neg": 4, "stop_pos": None}}, "AXIS_1: stop_neg is missing"),
        ({"BRIDGE": "two-pwm"}, "AXIS_1: en is 2, but a two-pwm bridge has none: None"),
        ({"AXIS_1": pins(en=5)}, "pin 5 is used twice, at AXIS_1: en and at AXIS_2: en"),
        ({"AXIS_1": pins(stop_pos=2)}, "pin 2 is used twice, at AXIS_1: en and at AXIS_1: stop_pos"),
        ({"POWER": 14}, "POWER is 14, neither an analog input's number, 26 to 29, nor None"),
        ({"POWER": 27, "AXIS_1": pins(encoder=(26, 27))}, "pin 27 is used twice, at POWER and at AXIS_1: encoder"),
        ({"EMERGENCY_STOP": 3}, "pin 3 is used twice, at EMERGENCY_STOP and at AXIS_1: pos"),
        ({"EMERGENCY_STOP": "GP14"}, "EMERGENCY_STOP is 'GP14', neither a pin's number nor None"),
        ({"AXIS_1": pins(en=21)}, "pins 21 and 5 share one PWM output, so both motors would turn"),
        (
            {"BRIDGE": "two-pwm", "AXIS_1": two_pwm, "AXIS_2": dict(two_pwm, pos=19, neg=8, stop_pos=1, stop_neg=0)},
            "pins 3 and 19 share one PWM output, so both motors would turn",
        ),
    ):
        assert board_file.fault(said(**changes)) == words, changes


def test_axes_are_numbered_without_a_gap_and_a_third_and_fourth_are_checked_as_the_first():
    third = {"en": 16, "pos": 17, "neg": 18, "stop_pos": 19, "stop_neg": 20}
    fourth = {"en": 22, "pos": 26, "neg": 27, "stop_pos": None, "stop_neg": None}
    assert board_file.fault(said(AXIS_3=third)) == ""
    assert board_file.fault(said(AXIS_3=third, AXIS_4=fourth)) == ""
    for changes, words in (
        ({"AXIS_4": fourth}, "AXIS_4 is there, but AXIS_3 is missing: axes are numbered without a gap"),
        ({"AXIS_3": third, "AXIS_5": fourth}, "AXIS_5 is no name that a board file may have"),
        ({"AXIS_3": None}, "AXIS_3 is no dictionary of pins"),
        ({"AXIS_3": dict(third, en=None)}, "AXIS_3: en is None, not a pin's number"),
        ({"AXIS_3": dict(third, neg=4)}, "pin 4 is used twice, at AXIS_1: neg and at AXIS_3: neg"),
        ({"AXIS_3": third, "AXIS_4": dict(fourth, pos=17)}, "pin 17 is used twice, at AXIS_3: pos and at AXIS_4: pos"),
        ({"AXIS_3": third, "EMERGENCY_STOP": 20}, "pin 20 is used twice, at EMERGENCY_STOP and at AXIS_3: stop_neg"),
        ({"AXIS_3": dict(third, en=21)}, "pins 5 and 21 share one PWM output, so both motors would turn"),
        (
            {"AXIS_3": third, "AXIS_4": dict(fourth, en=0)},
            "pins 16 and 0 share one PWM output, so both motors would turn",
        ),
    ):
        assert board_file.fault(said(**changes)) == words, changes


def test_an_app_has_the_axes_that_the_board_file_has():
    board = Board()
    assert [axis.number for axis in build.build(Port(), board).controller.axes] == [1, 2]
    board.AXIS_3 = {"en": 16, "pos": 17, "neg": 18, "stop_pos": None, "stop_neg": None}
    assert [axis.number for axis in build.build(Port(), board).controller.axes] == [1, 2, 3]
    assert boards.axes(board) == [board.AXIS_1, board.AXIS_2, board.AXIS_3]


def test_build_knows_the_bridges_that_a_board_file_may_name_and_refuses_others():
    for kind, _, _ in board_file.BRIDGES.values():
        assert hasattr(bridges, kind)
    board = Board()
    board.BRIDGE = "three-pwm"
    port = Port()
    try:
        build.build(port, board)
    except ValueError as e:
        assert str(e) == "BRIDGE is 'three-pwm', not one of enable, two-pwm"
    else:
        raise AssertionError("was made")
    assert port.pins == {}


def test_every_required_name_is_missed():
    for name in board_file.REQUIRED:
        values = said()
        del values[name]
        assert board_file.fault(values) == name + " is missing"


def test_pins_that_carry_no_duty_may_share_a_pwm_output_and_other_chips_have_their_own():
    assert board_file.fault(said(AXIS_1=pins(pos=21))) == ""
    assert board_file.fault(said(AXIS_1=pins(en=21)), False) == ""


def test_the_firmware_is_not_built_on_a_bad_board_file():
    board = Board()
    board.BRIDGE = "enabel"
    port = Port()
    try:
        build.build(port, board)
    except ValueError as e:
        assert "enabel" in str(e)
    else:
        raise AssertionError("was built")
    assert port.pins == {}
