"""Frames, lines and stops as a client sees them. Runs under CPython and MicroPython."""

from rig import Rig

FRAME_GAP_US = 50_000
LINE_GAP_US = 1_000_000


def test_a_frame_drives_both_motors_and_echoes_as_the_papers_sketch_does():
    rig = Rig()
    assert rig.ask(b"0255-100") == b"#\r\n0255-100\r\n255\r\n-100\r\n255\r\n100\r\n"
    assert rig.drives() == (255, -100)


def test_every_sign_of_a_frame():
    for text, drives in ((b"+255+001", (255, 1)), (b"-255-001", (-255, -1)), (b"0000-255", (0, -255))):
        rig = Rig()
        numbers = drives + (abs(drives[0]), abs(drives[1]))
        assert rig.ask(text).split() == [b"#", text] + [b"%d" % n for n in numbers]
        assert rig.drives() == drives, text


def test_frames_in_one_burst_are_obeyed_in_order():
    rig = Rig()
    assert rig.ask(b"000000000255025501000000").count(b"\r\n") == 1 + 15
    assert rig.drives() == (100, 0)


def test_both_motors_change_in_one_pass():
    rig = Rig()
    rig.send(b"02550255")
    rig.settle()
    enables = [us for us, pin, duty in rig.port.edges if pin in (2, 5) and duty]
    assert len(enables) == 2
    assert enables[1] - enables[0] < 200


def test_the_papers_three_mistakes_are_refused_and_stop():
    # typed without padding; garbage before a frame; a byte lost
    for text in (b"255255", b"#02550000", b"xyz02550000", b"2550000", b"02560256", b"0999-999", b" 255-100"):
        rig = Rig()
        rig.ask(b"01000100")
        rig.ask(text)
        assert rig.drives() == (0, 0), text
        rig.run(LINE_GAP_US + FRAME_GAP_US)
        assert rig.errors() == [60], text
        rig.ask(b"00500000")
        assert rig.drives() == (50, 0), text  # the next good message is obeyed


def test_a_lone_line_end_changes_nothing():
    rig = Rig()
    rig.ask(b"01000000")
    for blank in (b"\n", b"\r", b"\r\n", b" ", b"\0"):
        rig.ask(blank)
        assert rig.drives() == (100, 0)
    assert rig.errors() == []


def test_a_pause_inside_a_frame_shorter_than_the_gap_is_waited_for():
    for cut in range(1, 8):
        rig = Rig()
        rig.send(b"02550100"[:cut])
        rig.settle()
        rig.run(20_000)
        rig.send(b"02550100"[cut:])
        rig.settle()
        assert rig.drives() == (255, 100), cut


def test_a_pause_longer_than_the_gap_refuses_the_frame():
    for cut in range(1, 8):
        rig = Rig()
        rig.ask(b"01000000")
        rig.ask(b"02550100"[:cut])
        rig.run(FRAME_GAP_US)
        assert rig.drives() == (0, 0), cut
        assert rig.errors() == [60], cut


def test_a_byte_that_ends_a_pause_does_not_undo_it():
    # it comes while the loop sleeps: the pause was there before it
    for pause_us in (52_000, 55_000, 60_000, 63_000):
        rig = Rig()
        rig.ask(b"00000100")
        rig.send(b"0255")
        rig.send(b"0000", after_us=pause_us)
        rig.take_in()
        assert rig.drives() == (0, 0), pause_us
        rig.run(FRAME_GAP_US)
        rig.send(b"0!")
        rig.send(b"02550000", after_us=pause_us)
        rig.settle()
        assert rig.drives() == (255, 0), pause_us


def test_a_line_end_inside_a_frame_refuses_it_and_resynchronises_at_once():
    rig = Rig()
    rig.ask(b"0255\n01000000")
    assert rig.drives() == (100, 0)
    assert rig.errors() == [60]


def test_a_line_left_unfinished_is_refused_after_a_second():
    rig = Rig()
    rig.ask(b"01000000")
    rig.ask(b"1PR")
    rig.run(LINE_GAP_US // 2)
    assert rig.drives() == (100, 0)
    rig.run(LINE_GAP_US // 2)
    assert rig.drives() == (0, 0)
    assert rig.errors() == [60]


def test_a_gap_counts_from_when_a_byte_was_read_not_from_our_own_stalls():
    rig = Rig()
    rig.send(b"0255")
    rig.settle()
    rig.send(b"0000")
    rig.port.us += 10 * FRAME_GAP_US  # we were away, the bytes were there
    rig.settle()
    assert rig.drives() == (255, 0)


def test_malformed_lines_stop_and_execute_nothing_of_themselves():
    for text in (
        b"255-\n",
        b"123PR1\n",
        b"1PR5x\n",
        b"1PR1;255-\n",
        b"1PR+\x0b\n",
        b"1PR1..5\n",
        b"1PR12345678901\n",
        b"1PR01234567\n",
        b"1PR1;\n",
        b"1\n",
        b"*\n",
        b"1>\n",
        b"1>2>PR1\n",
        b"1PR 5 5\n",
        b"\x80\n",
        b"\x7f\n",
        b"1 2PR1\n",
    ):
        rig = Rig()
        rig.ask(b"00000100")
        rig.ask(text)
        assert rig.drives() == (0, 0), text
        assert rig.errors() == [60], text
        assert rig.axis1.reason == 0, text  # axis 1 never moved


def test_a_line_may_have_128_characters_and_no_more():
    rig = Rig()
    line = b"TE?;" * 31 + b"1TP?"
    assert len(line) == 128
    assert rig.ask(line + b"\n").count(b"; ") == 31
    rig.ask(b"00000100")
    rig.ask(line + b" \n")
    assert rig.drives() == (0, 0)
    assert rig.errors() == [61]


def test_a_command_that_cannot_be_done_stops_nothing_and_the_rest_goes_on():
    rig = Rig()
    rig.ask(b"00000100")
    assert rig.ask(b"AT;9PR1;PR1;1PR;1XP5;1VA1000;3PR1;1TP?\r") == b"0\r\n"
    assert rig.drives() == (0, 100)
    assert rig.errors() == [6, 9, 37, 38, 7, 110, 308]


def test_spaces_case_and_decimals_of_the_dialect():
    for text in (
        b"1PA3\n",
        b"1 PA 3\r\n",
        b"1pa3.000000\n",
        b"1>1PA+3\n",
        b"01> 1 PA 3 \n",
        b"1>1PA3;1TP?\n",
    ):
        rig = Rig()
        rig.ask(text)
        assert rig.drives() == (255, 0), text
        assert rig.axis1.position.target == 3, text


def test_halves_round_away_from_zero():
    for text, target in ((b"2.5", 3), (b"-2.5", -3), (b"2.499999", 2), (b"-0.5", -1)):
        rig = Rig()
        rig.ask(b"1PA" + text + b"\n")
        assert rig.axis1.position.target == target, text


def test_answers_of_a_line_are_joined_and_the_address_is_echoed():
    rig = Rig()
    assert rig.ask(b"1>1TP?;2TP?;TB?\r\n") == b"1>0; 0; 0, NO ERROR DETECTED\r\n"
    assert rig.ask(b"01>VE?\n") == b"01>MM2 Version 0.3.0 mirrormount\r\n"


def test_axes_that_the_dialect_has_and_this_mount_has_not_answer_as_unconnected():
    rig = Rig()
    assert rig.ask(b"3TP?;4MD?;3XP?\n") == b"0; 1; 0\r\n"
    rig.ask(b"3MV+\n")
    assert rig.drives() == (0, 0)
    assert rig.errors() == [308]


def test_a_stop_of_an_axis_that_is_not_there_is_no_error_and_stops_no_other():
    rig = Rig()
    rig.ask(b"1MV+;3ST;4ST\n")
    assert rig.drives() == (255, 0)
    assert rig.errors() == []
    rig.ask(b"3ST1\n")
    assert rig.errors() == [7]


def test_what_mpremote_knocks_with_is_ignored():
    rig = Rig()
    rig.ask(b"01000000")
    rig.ask(b"\x01\x02\x04\x05\x18")
    assert rig.drives() == (100, 0)
    assert rig.errors() == []


def test_what_modemmanager_probes_with_moves_nothing():
    rig = Rig()
    assert rig.ask(b"AT\r") == b""
    assert rig.drives() == (0, 0)
    assert rig.errors() == [6]
    rig.ask(b"AT+GCAP\r")
    assert rig.errors() == [60]


def test_a_host_that_never_reads_loses_echoes_whole_and_nothing_else():
    rig = Rig()
    rig.port.reading = False
    for _ in range(100):
        rig.send(b"02550100\n00500050\n")
        rig.settle()
    assert rig.drives() == (50, 50)
    rig.send(b"!")
    rig.settle()
    assert rig.drives() == (0, 0)
    rig.port.reading = True
    rig.run(2_000_000)
    probe, *lines = bytes(rig.port.sent).split(b"\r\n")
    assert probe == b"#"
    assert len(lines) % 5 == 1  # whole echoes only,
    assert len(lines) < 5 * 200  # and not all of them
    assert lines[-6:] in (
        [b"02550100", b"255", b"100", b"255", b"100", b""],
        [b"00500050", b"50", b"50", b"50", b"50", b""],
    )
    assert rig.errors() == []


def test_a_dropped_answer_is_told_once():
    rig = Rig()
    rig.port.reading = False
    for _ in range(30):
        rig.send(b"*IDN?\n" * 10)
        rig.settle()
    rig.port.reading = True
    rig.run(2_000_000)
    assert rig.errors() == [65]
    rig.port.reading = False
    for _ in range(30):
        rig.send(b"*IDN?\n" * 10)
        rig.settle()
    rig.port.reading = True
    rig.run(2_000_000)
    assert rig.errors() == [65]


def test_the_error_queue_keeps_the_ten_oldest():
    rig = Rig()
    rig.ask(b"AT\n" * 4 + b"PR1\n" * 12)
    assert rig.errors() == [6] * 4 + [37] * 6


def test_an_idle_loop_sleeps_to_the_end_of_a_slot_of_the_led():
    rig = Rig()
    rig.ask(b"*IDN?\n")
    for line in (b"", b"1MV+\n"):  # at rest, and in a run
        rig.send(line)
        rig.run(600_000)
        before = rig.app.queries.about.passes
        rig.run(10_240_000)
        assert 20 <= rig.app.queries.about.passes - before <= 50, line  # 20 slots; a run is counted, too


def test_the_led_says_ready_driving_and_error():
    rig = Rig()
    rig.run(1_100_000)
    assert rig.port.shown[-1][1] and len(rig.port.shown) == 1  # on, for good
    rig.ask(b"1MV+\n")
    before = len(rig.port.shown)
    rig.run(4_096_000)
    assert 7 <= len(rig.port.shown) - before <= 9  # blinking
    rig.ask(b"!\nAT\n")
    rig.run(3_072_000)
    before = len(rig.port.shown)
    rig.run(4_096_000)
    (_, first), *_ = shown = rig.port.shown[before:]
    lasted = [later - sooner for (sooner, _), (later, _) in zip(shown, shown[1:])]
    flashes = lasted[0 if first else 1 :: 2]
    assert len(shown) == 4 and max(flashes) < 600_000 and sum(lasted) > 2_500_000  # a flash each 2 s


def test_the_text_after_a_long_name_moves_nothing_and_hides_nothing():
    rig = Rig()
    rig.ask(b"2MV+\n")
    for line in (b"HOSTNAME a>1MV+\n", b"ST;HOSTNAME a>b\n"):  # `>` is no text, so it stops
        rig.ask(b"2MV+\n")
        rig.ask(line)
        assert rig.drives() == (0, 0), line
        assert rig.errors()[-1] == 60
    for line in (b"1MV+;IPADDR00000000\n", b"1MV+;MACADDR 000000000000\n"):
        rig.ask(line)
        assert rig.drives() == (0, 0), line
        assert rig.errors()[-1] == 60
    assert rig.ask(b"HOSTNAME?;IPADDR 192.168.0.1;VE?\n") == b"mirrormount; MM2 Version 0.3.0 mirrormount\r\n"


def test_whenever_a_line_comes_in_an_idle_pass_it_is_answered_at_once():
    rig = Rig()
    rig.ask(b"1TP?\n")
    for after_us in range(0, 70_000, 23):
        sent = len(rig.port.sent)
        rig.send(b"1TP?\n", after_us=after_us)
        rig.run(after_us + 12_000)
        assert bytes(rig.port.sent[sent:]) == b"0\r\n", after_us
        rig.run(64_000)
