"""What a board tells of itself: the hash of its files, and its health. Runs under CPython and MicroPython."""

from rig import Rig


def test_the_hash_of_the_firmware_is_what_the_port_finds():
    rig = Rig()
    assert rig.ask(b"XF?;1PR?;XF?\n") == b"5a" * 32 + b"; 0; " + b"5a" * 32 + b"\r\n"


def test_the_firmwares_files_are_not_read_while_a_motor_turns():
    rig = Rig()
    assert rig.ask(b"2MV+;XF?\n") == b"ERROR 214\r\n"
    assert rig.errors() == [214]
    rig.send(b"!")
    assert rig.ask(b"XF?\n") == b"5a" * 32 + b"\r\n"
    assert rig.ask(b"2MV+;XF?\n") == b"5a" * 32 + b"\r\n"  # they have been read


def test_a_stop_between_two_parts_of_the_files_is_obeyed_and_the_hash_is_whole():
    rig = Rig()
    assert rig.ask(b"XF?\n!") == b"5a" * 32 + b"\r\n"


def test_files_that_cannot_be_read_have_no_hash():
    rig = Rig()
    rig.port.full = True
    assert rig.ask(b"XF?\n") == b"unreadable\r\n"


def health(rig):
    return [int(n) for n in rig.ask(b"XH?\n").strip().split(b",")]


def test_health_is_memory_longest_pass_passes_and_cause_of_the_reset():
    rig = Rig()
    rig.run(100_000)
    free, longest_us, passes, cause, _gate = health(rig)
    assert (free, cause) == (100_000, 1)
    assert 0 < longest_us < 10_000
    rig.run(1_000_000)
    assert health(rig)[2] > passes


def test_the_longest_pass_is_of_the_time_since_one_asked_and_does_not_count_waiting():
    rig = Rig()
    health(rig)
    rig.send(b"1XP800;1PR1\n")  # it is waited for where it begins: that makes a pass long
    rig.run(1_000_000)
    with_pulse = health(rig)[1]
    rig.run(1_000_000)
    assert health(rig)[1] < with_pulse < 1_000


def test_memory_is_not_counted_while_a_motor_has_drive():
    rig = Rig()
    counted = []

    def free_memory():
        counted.append(1)
        return 77

    rig.about.free_memory = free_memory
    rig.send(b"1MV+\n")
    rig.run(50_000)
    assert health(rig)[0] == 0 and not counted  # not known yet
    rig.send(b"!\n")
    rig.run(50_000)
    assert health(rig)[0] == 77 and len(counted) == 1
    rig.send(b"1MV+\n")
    rig.run(50_000)
    assert health(rig)[0] == 77 and len(counted) == 1


def test_passes_wrap_before_they_would_need_memory():
    rig = Rig()
    rig.about.passes = (1 << 30) - 1
    rig.step()
    assert rig.about.passes == 0
