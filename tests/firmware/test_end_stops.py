"""End-stops: what they end, what they block, whose they are. Runs under CPython and MicroPython."""

from rig import Rig

from mountfw.wire.ticks import diff


def with_switches(bits=3, pressed=()):
    rig = Rig()
    for pin in (10, 11, 12, 13):
        rig.port.switches[pin] = 1 if pin in pressed else 0
    rig.ask(b"1XL%d;2XL%d\n" % (bits, bits))
    return rig


def test_switches_that_are_not_fitted_are_not_read():
    rig = Rig()  # nothing connected: every input is pulled up
    rig.ask(b"02550255")
    assert rig.drives() == (255, 255)
    assert rig.ask(b"PH?;1XL?\n") == b"0; 0\r\n"


def test_an_end_stop_ends_the_move_into_it_and_is_told():
    for move, pin, error, bit in (
        (b"1MV+\n", 10, 104, 1),
        (b"1PR-5\n", 11, 105, 2),
        (b"02550000", 10, 104, 1),
    ):
        rig = with_switches()
        rig.ask(move)
        rig.run(50_000)
        assert rig.drives()[0]
        rig.port.switches[pin] = 1
        rig.run(500)
        assert rig.drives() == (0, 0), move
        assert rig.ask(b"1XE?\n").split(b",")[0] == b"4"
        assert rig.ask(b"PH?\n") == b"%d\r\n" % bit
        assert rig.errors() == [error]


def test_a_burst_of_input_does_not_hold_up_an_end_stop():
    rig = with_switches()
    rig.ask(b"1MV+\n")
    rig.send(b" " * 256)
    rig.port.switches[10] = 1
    opened = rig.now()
    rig.take_in()
    off = [us for us, pin, duty in rig.port.edges if pin == 2 and not duty][-1]
    assert off - opened < 2_000  # polled; with an interrupt it does not wait for the burst


def test_at_an_end_stop_only_the_way_into_it_is_blocked():
    rig = with_switches(pressed=(10,))
    rig.ask(b"1MV+\n")
    assert rig.drives() == (0, 0)
    assert rig.errors() == [104]
    rig.ask(b"1MV-\n")
    assert rig.drives() == (-255, 0)


def test_end_stops_belong_to_the_electrical_direction_and_their_names_swap():
    rig = with_switches(pressed=(10,))
    rig.ask(b"1XI1\n")
    assert rig.ask(b"PH?\n") == b"2\r\n"
    rig.ask(b"1MV-\n")
    assert rig.drives() == (0, 0)
    assert rig.errors() == [105]
    rig.ask(b"1MV+\n")
    assert rig.drives() == (-255, 0)


def test_one_axis_at_its_end_stop_does_not_hold_the_other():
    rig = with_switches(pressed=(13,))
    rig.ask(b"0255-255")
    assert rig.drives() == (255, 0)


def test_both_end_stops_active_is_a_fault_until_checking_is_off():
    rig = with_switches(pressed=(10, 11))
    for move in (b"1MV+\n", b"1MV-\n", b"1PR1\n"):
        rig.ask(move)
        assert rig.drives() == (0, 0)
        assert rig.errors() == [142]
        assert rig.ask(b"1XE?\n").split(b",")[0] == b"9"
    rig.ask(b"1ZH1;1MV+\n")
    assert rig.drives() == (255, 0)


def test_a_switch_that_the_board_has_not_cannot_be_fitted():
    rig = Rig()
    rig.ask(b"1XL4\n")
    assert rig.errors() == [135]
    assert rig.ask(b"1XL?\n") == b"0\r\n"


def test_a_single_noisy_reading_is_not_a_stop():
    rig = with_switches()
    rig.ask(b"1MV+\n")
    readings = [0]
    stop = rig.axis1.positive_stop
    quiet = stop._read

    def noisy():
        readings[0] += 1
        return 1 if readings[0] % 5 == 0 else quiet()

    stop._read = noisy
    rig.run(100_000)
    assert readings[0] > 100
    assert rig.drives() == (255, 0)


def test_a_switch_that_opens_shortly_before_a_pulse_ends_cuts_it_without_an_interrupt():
    rig = with_switches()
    rig.ask(b"1PR1\n")
    began = [us for us, pin, duty in rig.port.edges if pin == 2 and duty][-1]
    rig.axis1.positive_stop._read = lambda: 1 if rig.now() > began + 198_500 else 0
    rig.run(250_000)
    on_us = rig.on_times(2)[-1]
    assert 198_490 < on_us < 198_700, on_us
    assert abs(rig.axis1.ended_on_us - on_us) < 50
    assert rig.errors() == [104]


def test_an_end_stop_that_opens_after_a_drive_was_cut_adds_nothing_to_its_time():
    rig = Rig()
    rig.port.switches[10] = 0
    rig.ask(b"1XL1\n")
    drive = rig.controller.axes[0].drive
    drive.aim(255)
    assert drive.on(100_000) == 0
    rig.port.us += 300
    drive.cut()
    cut_at = drive.cut_at
    rig.port.us += 275
    rig.port.switches[10] = 1
    drive.guard(None)
    assert drive.tripped
    assert rig.drives() == (0, 0)
    assert drive.cut_at == cut_at
    assert drive.measured_us(True) == diff(cut_at, drive.on_at)


def test_checking_is_not_switched_off_in_a_move():
    rig = with_switches()
    rig.ask(b"1MV+;1ZH1\n")
    assert rig.errors() == [114]
    assert rig.ask(b"1ZH?\n") == b"0\r\n"
