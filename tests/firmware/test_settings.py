"""Settings over a restart. Runs under CPython and MicroPython."""

from mountfw.settings import SETTINGS
from mountfw.store import seal

from rig import Rig  # isort: skip

FILE = "mountfw.settings"
DAMAGED = 63
LEFT_OUT = 69
NOT_SAVED = 67

# a value that is not the factory's for each setting, axis 1 and axis 2
CHANGED = {
    b"XP": (b"150000", b"90000"),
    b"XD": (b"200", b"100"),
    b"XV": (b"90", b"91"),
    b"XB": (b"120000", b"2000000"),
    b"XJ": (b"70", b"255"),
    b"XQ": (b"25", b"20000"),
    b"XY": (b"1", b"1"),
    b"XI": (b"1", b"1"),
    b"XL": (b"3", b"1"),
    b"XM": (b"9000", b"400000"),
    b"XT": (b"60000", b"1"),
    b"VA": (b"4.25", b"0.01"),
    b"AC": (b"5000", b"1"),
    b"SL": (b"-50", b"-999999"),
    b"SR": (b"60", b"999999"),
    b"ZH": (b"8", b"9"),
    b"QM": (b"0", b"2"),
}
DECLARED = [entry[0] for entry in SETTINGS]
NAMES = [name for name in DECLARED if name in CHANGED]  # in the order in which they are to be set


def restart(rig):
    """Power off and on."""
    return Rig(rig.board, rig.port.files)


def settings(rig):
    """What each setting is, by its query."""
    return [rig.ask(b"1%s?;2%s?\n" % (name, name)) for name in NAMES]


def change(rig):
    for name in NAMES:
        rig.ask(b"1%s%s;2%s%s\n" % (name, CHANGED[name][0], name, CHANGED[name][1]))


def do(rig, line):
    """Send a line that has to do with files, and give it the time that takes."""
    rig.ask(line)
    rig.run(200_000)


def saved():
    """A rig in which every setting was changed and saved, and what its settings are."""
    rig = Rig()
    change(rig)
    do(rig, b"SM\n")
    return rig, settings(rig)


def assert_as_made(rig, error):
    assert rig.errors() == ([error] if error else [])
    assert [getattr(axis, entry[1]) for axis in (rig.axis1, rig.axis2) for entry in SETTINGS] == AS_MADE
    rig.ask(b"02550255\n")
    assert rig.drives() == (255, 255)


_fresh = Rig()
AS_MADE = [getattr(axis, entry[1]) for axis in (_fresh.axis1, _fresh.axis2) for entry in SETTINGS]


def test_every_setting_has_a_value_that_is_not_the_factorys():
    assert set(CHANGED) == set(DECLARED), "add it to CHANGED"


def test_every_setting_that_is_saved_is_there_after_a_restart():
    rig, were = saved()
    assert rig.errors() == []
    for name, answer, made in zip(NAMES, were, settings(Rig())):
        assert answer == b"; ".join(CHANGED[name]) + b"\r\n"
        assert answer != made
    again = restart(rig)
    assert settings(again) == were
    assert again.errors() == []


def test_rst_and_rcl1_bring_the_saved_settings_back():
    for line in (b"*RCL1\n", b"*RST\n"):
        rig, were = saved()
        rig.ask(b"1XP200;2XI0;1VA1;2QM3;1ZH0\n")
        assert settings(rig) != were
        rig.ask(line)
        assert settings(rig) == were
        assert rig.errors() == []


def test_rcl0_brings_those_as_made_and_leaves_the_saved_ones_on_the_flash():
    rig, were = saved()
    rig.ask(b"*RCL0\n")
    assert settings(rig) == settings(Rig())
    assert settings(restart(rig)) == were
    do(rig, b"SM\n")
    assert settings(restart(rig)) == settings(Rig())


def test_settings_that_are_not_saved_are_gone_after_a_restart():
    rig = Rig()
    change(rig)
    assert_as_made(restart(rig), 0)
    rig, were = saved()
    rig.ask(b"1XP1000;2VA3;1XI0\n")
    assert settings(restart(rig)) == were


def test_saving_and_recalling_are_refused_while_any_axis_moves():
    for line in (b"SM\n", b"*RCL0\n", b"*RCL1\n"):
        for motion, code in ((b"1MV+\n", 114), (b"2MV-\n", 214), (b"02550255\n", 114), (b"2PR2\n", 214)):
            rig, were = saved()
            rig.ask(b"1QM3;2QM3;1ZH1;2ZH1;2XT1000\n")
            now = settings(rig)
            log = len(rig.port.file_log)
            rig.ask(motion)
            drives = rig.drives()
            assert drives != (0, 0)
            rig.ask(line)
            assert rig.errors() == [code]
            assert rig.drives() == drives
            assert settings(rig) == now
            assert [entry[2] for entry in rig.port.file_log[log:] if entry[2] != "mountfw.position"] == []
            assert settings(restart(rig)) == were


def test_a_value_where_none_belongs_saves_and_recalls_nothing():
    rig, were = saved()
    rig.ask(b"1XP1000\n")
    rig.ask(b"SM1\n*RCL\n*RCL2\n*RCL-1\n")
    assert rig.errors() == [7, 38, 7, 7]
    assert rig.axis1.pulse_us == 1000
    assert settings(restart(rig)) == were


def test_a_line_may_save_and_go_on_with_motion():
    rig = Rig()
    do(rig, b"1XP1000;SM;1XP2000;1MV+;1XP?\n")
    assert rig.drives() == (255, 0)
    assert rig.errors() == []
    assert restart(rig).axis1.pulse_us == 1000


def test_a_file_with_any_byte_changed_gives_the_settings_as_made_and_error_63():
    data = saved()[0].port.files[FILE]
    assert len(data) > 400
    for i in range(len(data)):
        for flip in (1, 0x80, 0xFF):
            damaged = data[:i] + bytes([data[i] ^ flip]) + data[i + 1 :]
            assert_as_made(Rig(files={FILE: damaged}), DAMAGED)


def test_a_file_cut_at_any_length_gives_the_settings_as_made_and_error_63():
    data = saved()[0].port.files[FILE]
    for length in range(len(data)):
        assert_as_made(Rig(files={FILE: data[:length]}), DAMAGED)


def test_a_foreign_file_gives_the_settings_as_made_and_error_63():
    foreign = (bytes(range(256)) * 16, b"\xff" * 4096, b"\n" * 9, b"{}\n", b"1 pulse_us 1000\n")
    for data in foreign:
        assert_as_made(Rig(files={FILE: data}), DAMAGED)


def sealed_bytes(data):
    """Bytes that are no text, with the right checksum."""
    from binascii import crc32

    return data + b"%08x\n" % (crc32(data) & 0xFFFFFFFF)


def test_a_right_checksum_over_wrong_lines_gives_the_settings_as_made_and_error_63():
    good = "1 run_duty 7\n"
    for bad in ("", "1 run_duty", "run_duty 7", "1 run_duty 7 7", "0 run_duty 7", "-1 run_duty 7"):
        assert_as_made(Rig(files={FILE: seal(good + bad + "\n")}), DAMAGED)
    for bad in ("1 run_duty seven", "1 run_duty 7.5", "1 run_duty "):
        assert_as_made(Rig(files={FILE: seal(good + bad + "\n")}), DAMAGED)
    assert_as_made(Rig(files={FILE: sealed_bytes(b"1 run_duty \xff\xfe\n")}), DAMAGED)
    assert Rig(files={FILE: seal(good)}).axis1.run_duty == 7


def test_settings_that_no_axis_has_are_left_out_with_error_69_and_the_others_are_in_use():
    # of a newer firmware; of an axis and an encoder that the board file does not have any more
    for other in ("1 no_such 7", "1 state 3", "1 __class__ 1", "3 run_duty 7", "1 counts_per_step 280"):
        rig = Rig(files={FILE: seal("1 switches 3\n%s\n2 soft_maximum 9\n" % other)})
        assert rig.errors() == [LEFT_OUT]
        assert (rig.axis1.switches, rig.axis2.soft_maximum, rig.axis1.state) == (3, 9, 0)
        do(rig, b"SM\n")
        again = restart(rig)
        assert again.errors() == []
        assert (again.axis1.switches, again.axis2.soft_maximum) == (3, 9)


def test_a_right_checksum_over_a_value_out_of_range_gives_the_settings_as_made_and_error_63():
    for _, name, least, most, _, _ in SETTINGS:
        beyond = 2 if name.startswith("soft_") else 1  # an older firmware allowed a step more
        for value in (least - beyond, most + beyond, 1 << 40, -(1 << 40)):
            for number in (1, 2):
                assert_as_made(Rig(files={FILE: seal("%d %s %d\n" % (number, name, value))}), DAMAGED)
    assert_as_made(Rig(files={FILE: seal("1 checking 4\n")}), DAMAGED)
    assert_as_made(Rig(files={FILE: seal("1 switches 4\n")}), DAMAGED)  # a Pico's board file has no home switch


def test_every_setting_at_either_end_of_its_range_can_be_saved():
    for _, name, least, most, _, _ in SETTINGS:
        for value in (least, 3 if name == "switches" else most):
            rig = Rig()
            rig.axis2.set(name, value)
            do(rig, b"SM\n")
            again = restart(rig)
            assert again.errors() == []
            assert getattr(again.axis2, name) == value


def test_settings_of_an_older_firmware_that_knew_fewer_are_taken():
    rig = Rig(files={FILE: seal("1 run_duty 7\n2 pulse_us 1000\n")})
    assert rig.errors() == []
    assert rig.axis1.run_duty == 7
    assert rig.axis2.pulse_us == 1000
    assert rig.axis1.pulse_us == 200_000


def test_a_search_limit_that_was_saved_by_its_older_name_is_taken():
    rig = Rig(files={FILE: seal("1 move_limit_ms 777\n2 run_duty 7\n")})
    assert rig.errors() == []
    assert (rig.axis1.search_limit_ms, rig.axis2.run_duty) == (777, 7)


def test_a_purge_leaves_the_settings_as_made_in_use_and_on_the_flash():
    rig, _ = saved()
    do(rig, b"XX\n")
    assert settings(rig) == settings(Rig())
    assert rig.errors() == []
    assert_as_made(restart(rig), 0)


def test_a_purge_with_a_value_or_while_an_axis_moves_changes_nothing():
    rig, were = saved()
    rig.ask(b"1QM3;2QM3\n")
    now = settings(rig)
    rig.ask(b"XX1\n")
    assert rig.errors() == [7]
    rig.ask(b"2PR2\n")
    do(rig, b"XX\n")
    assert rig.errors() == [214]
    assert settings(rig) == now
    assert settings(restart(rig)) == were


def test_a_damaged_file_is_told_by_rcl1_too_and_mended_by_saving():
    rig = Rig(files={FILE: b"junk"})
    assert rig.errors() == [DAMAGED]
    rig.ask(b"1XP1000;*RCL1\n")
    assert rig.errors() == [DAMAGED]
    assert rig.axis1.pulse_us == 200_000
    do(rig, b"1XP1000;SM\n")
    again = restart(rig)
    assert again.errors() == []
    assert again.axis1.pulse_us == 1000


def test_a_full_file_system_keeps_the_old_settings_whole():
    rig, _ = saved()
    old = rig.port.files[FILE]
    rig.ask(b"1XP1000\n")
    rig.port.full = True
    do(rig, b"SM\n")
    assert rig.errors() == [NOT_SAVED]
    assert rig.port.files[FILE] == old
    assert rig.axis1.pulse_us == 1000  # what was set stays in use
    rig.port.full = False
    do(rig, b"SM\n")
    assert rig.errors() == []
    assert restart(rig).axis1.pulse_us == 1000


def test_settings_that_cannot_be_put_in_place_leave_the_old_ones():
    rig, were = saved()
    rig.ask(b"1XP1000\n")
    store = rig.port.store

    def then_full(name, data):
        store(name, data)
        rig.port.full = True

    rig.port.store = then_full
    do(rig, b"SM\n")
    assert rig.errors() == [NOT_SAVED]
    assert settings(restart(rig)) == were


def test_a_stop_between_the_two_halves_of_saving_stops_and_the_settings_are_whole():
    for us in range(0, 140_000, 5_000):
        rig, _ = saved()
        rig.ask(b"1XP1000\n")
        rig.send(b"SM\n")
        rig.send(b"!\n", after_us=us)
        rig.run(400_000)
        again = restart(rig)
        assert again.errors() == []
        assert again.axis1.pulse_us == 1000


def test_soft_limits_that_an_older_firmware_has_saved_are_read_as_the_farthest_ones():
    files = {"mountfw.settings": seal("1 soft_minimum -1000000\n1 soft_maximum 1000000\n1 pulse_us 1000\n")}
    rig = Rig(files=files)
    assert rig.ask(b"1SL?;1SR?;1XP?;TE?\n") == b"-999999; 999999; 1000; 0\r\n"
