"""What programs written for New Focus 8742/8743-CL controllers count on. Runs under CPython and MicroPython."""

from mountfw import codes
from mountfw.dialect.line import HUGE
from mountfw.motion.position import MAX_STEPS
from mountfw.settings import SETTINGS

from rig import Rig  # isort: skip

JOG = b"2MV+\n"


def test_every_error_is_told_with_exactly_one_comma():
    numbers = list(codes.MESSAGES)
    numbers += [axis * 100 + code for code in codes.AXIS_MESSAGES for axis in (1, 2, 3, 4)]
    assert len(numbers) > 60
    for code in numbers:
        rig = Rig()
        if code:
            rig.controller.errors.push(code)
        number, message = rig.ask(b"TB?\n").split(b",")
        assert int(number) == code
        assert message.strip()


def test_the_version_is_four_words_of_which_the_first_has_at_most_eight_letters():
    words = Rig().ask(b"VE?\n").split()
    assert len(words) == 4
    assert words[:2] == [b"MM2", b"Version"] and words[3] == b"mirrormount"
    assert words[2] == Rig().ask(b"*IDN?\n").strip().split(b",")[-1]


def test_the_version_is_told_without_a_question_mark_as_well():
    rig = Rig()
    assert rig.ask(b"VE\r\n") == rig.ask(b"VE?\r\n")
    assert rig.ask(b"1>1MD?;VE;1TP?\n") == b"1>1; " + rig.ask(b"VE?\n").strip() + b"; 0\r\n"
    assert rig.ask(b"VE1\n") == b""
    assert rig.errors() == [7]


# ---- numbers


def test_a_number_out_of_range_is_refused_and_stops_nothing():
    for command, error in (
        (b"1PA12345678", 101),
        (b"1PR-2147483648", 101),
        (b"1PA2147483647", 101),
        (b"1PA9999999999", 101),
        (b"1DH-9999999999.999999", 101),
        (b"1 SR 123456789.000000", 7),
        (b"1 SL -10000000.000000", 7),
        (b"1VA1234567890", 7),
        (b"XK4294967295", 7),
    ):
        rig = Rig()
        rig.ask(JOG)
        rig.ask(command + b"\n")
        assert rig.errors() == [error], command
        assert rig.drives() == (0, 255), command


def test_no_range_takes_the_number_that_stands_for_all_larger_ones():
    for name, _, least, most, _, _ in SETTINGS:
        assert least > -HUGE and most < HUGE
        if name == b"VA":
            assert most < HUGE * 100
        for number in (b"10000000", b"1000100001", b"2147483647", b"-10000000", b"-9999999999"):
            rig = Rig()
            before = rig.ask(b"1%s?\n" % name)
            rig.ask(b"1%s%s\n" % (name, number))
            assert rig.errors() == [7], (name, number)
            assert rig.ask(b"1%s?\n" % name) == before
    assert MAX_STEPS < HUGE - MAX_STEPS  # from any position


def test_all_decimals_are_taken_and_none_is_lost():
    for number, target in (
        (b"2.4999999999999999", 2),
        (b"2.5000000100000001", 3),
        (b"-2.50000000", -3),
        (b"0000002.0000000", 2),
        (b"999998.49999999", 999_998),
    ):
        rig = Rig()
        rig.ask(b"1PA" + number + b"\n")
        assert rig.errors() == [], number
        assert rig.axis1.position.target == target, number
    rig = Rig()
    rig.ask(b"1XP300.0000000;1XP400.00000001\n")  # the second is no whole number
    assert rig.errors() == [7]
    assert rig.axis1.pulse_us == 300


def test_a_frame_behind_garbage_is_no_number():
    for text in (b"x02550000", b"xyz02550255\n", b"M 02550000\n", b"PR01234567\n"):
        rig = Rig()
        rig.ask(b"01000100")
        rig.ask(text)
        assert rig.drives() == (0, 0), text
        rig.run(1_100_000)
        assert rig.errors() == [60], text


def test_a_line_of_128_characters_may_be_one_number():
    line = b"1PA1." + b"9" * 123
    assert len(line) == 128
    rig = Rig()
    rig.ask(JOG)
    rig.ask(line + b"\n")
    assert rig.axis1.position.target == 2
    assert rig.drives() == (255, 255)
    rig.ask(line + b"9\n")
    assert rig.drives() == (0, 0)
    assert rig.errors() == [61]


def test_eight_zeros_in_a_row_stop_also_in_a_number_and_in_text():
    for line in (b"1PA100000000\n", b"1SR1.00000000\n", b"HOSTNAME 8742-00000000\n"):
        rig = Rig()
        rig.ask(JOG)
        rig.ask(line)
        assert rig.drives() == (0, 0), line
        assert rig.errors() == [60], line


# ---- queries


def test_a_query_that_cannot_be_answered_has_its_error_where_the_answer_would_be():
    for query, error in (
        (b"SN?", 37),
        (b"TP?", 37),
        (b"ID?", 6),
        (b"1ID?", 6),
        (b"ST?", 6),
        (b"9TP?", 9),
        (b"10MD?", 9),
    ):
        rig = Rig()
        assert rig.ask(query + b"\n") == b"ERROR %d\r\n" % error, query
        assert rig.errors() == [error]
        assert rig.ask(b"1TP?;%s;2MD?;TE?\r\n" % query) == b"0; ERROR %d; 1; %d\r\n" % (error, error), query


def test_an_error_in_the_place_of_an_answer_drives_nothing_if_it_comes_back():
    rig = Rig()
    rig.ask(rig.ask(b"ID?;1ID?;9TP?\n"))
    assert rig.drives() == (0, 0)


# ---- addresses


def test_a_line_for_another_controller_does_nothing_and_is_not_answered():
    for address in (b"2>", b"31>", b"11>", b"10>", b"02>", b"99>"):
        rig = Rig()
        assert rig.ask(address + b"1PR2;1MV+;1XP1000;1DH5;SM;1TP?;ID?;*IDN?\n") == b""
        rig.run(100_000)
        assert rig.port.edges == [edge for edge in rig.port.edges if edge[2] == 0], address
        assert rig.axis1.pulse_us == 200_000
        assert rig.port.files == {}
        assert rig.errors() == [48], address


def test_a_line_for_this_controller_is_executed_and_its_address_echoed():
    for address in (b"1>", b"01>", b"0>", b"00>"):
        rig = Rig()
        assert rig.ask(address + b"1MV+;SA?\n") == address + b"1\r\n"
        assert rig.drives() == (255, 0)
        assert rig.errors() == []


def test_a_stop_for_another_controller_stops():
    for stop in (b"2>ST\n", b"2>1ST\n", b"7>AB\n", b"2>1PR1;AB\n", b"2>!\n"):
        rig = Rig()
        rig.ask(b"1MV+\n")
        rig.ask(stop)
        assert rig.drives() == (0, 0), stop
    rig = Rig()
    rig.ask(b"1MV+;2MV+\n")
    rig.ask(b"2>1ST\n")
    assert rig.drives() == (0, 255)


# ---- an open loop


def test_an_open_loop_is_accepted_where_it_is_set_and_a_closed_one_refused():
    rig = Rig()
    rig.ask(b"1SN0;1ZH3;1MM0;1CL0;1CL0.0;1DB0;1FE0;2SN0\n")
    assert rig.errors() == []
    assert rig.ask(b"1SN?;1ZH?;1MM?\n") == b"0; 3; 0\r\n"
    rig.ask(b"1SN1;1ZH0;1MM1;1CL0.1;1DB5;1SN;1MM+\n")
    assert rig.errors() == [135, 135, 135, 135, 38, 7]
    assert rig.ask(b"1SN?;1ZH?;1MM?\n") == b"0; 0; 0\r\n"


def test_the_hardware_configuration_takes_the_bits_that_are_known():
    for value in range(17):
        rig = Rig()
        rig.ask(b"1ZH%d\n" % value)
        known = value & ~11 == 0
        assert rig.errors() == ([] if known else [7]), value
        assert rig.ask(b"1ZH?\n") == b"%d\r\n" % (value if known else 0)


def test_a_search_for_a_switch_that_is_not_fitted_is_refused_at_once():
    rig = Rig()
    rig.ask(b"1 MT +\n1 MT -\n1OR\n")
    assert rig.drives() == (0, 0)
    assert rig.ask(b"1MD?\n") == b"1\r\n"
    assert rig.errors() == [135, 135, 135]


# ---- typed by hand


def test_a_backspace_is_malformed_like_any_byte_that_the_grammar_has_not():
    for key in (b"\x08", b"\x7f"):
        for typed in (b"1PR5" + key + b"3\n", key + b"\n", b"1" + key):
            rig = Rig()
            rig.ask(JOG)
            rig.ask(typed)
            assert rig.drives() == (0, 0), typed
            rig.run(100_000)
            assert rig.errors() == [60], typed
            assert rig.axis1.reason == 0
