"""Records that are damaged, gone, or cannot be removed. Runs under CPython and MicroPython."""

from rig import START_US, Port, Rig

from mountfw import codes
from mountfw.store import seal

from rig_recorded import FILE, MOTIONS, RECORDED_US, REST_US, certainty, known, recorded, restart, rises  # isort: skip

DAMAGED = 63
NOT_SAVED = 67


def assert_unknown(rig):
    assert certainty(rig) == (codes.UNKNOWN, codes.UNKNOWN)
    assert rig.errors() == [DAMAGED]
    rig.ask(b"02550255\n")
    rig.run(60_000)
    assert rig.drives() == (255, 255)
    assert FILE not in rig.port.files


def test_a_record_with_any_byte_changed_leaves_the_position_unknown_and_error_63():
    data = recorded().port.files[FILE]
    for i in range(len(data)):
        for flip in (1, 0x80, 0xFF):
            assert_unknown(Rig(files={FILE: data[:i] + bytes([data[i] ^ flip]) + data[i + 1 :]}))


def test_a_record_cut_at_any_length_leaves_the_position_unknown_and_error_63():
    data = recorded().port.files[FILE]
    for length in range(len(data)):
        assert_unknown(Rig(files={FILE: data[:length]}))


def test_a_right_checksum_over_wrong_lines_leaves_the_position_unknown_and_error_63():
    good = "1 0 51000000 0 0 0 13000 1 13 10 0 0\n"
    other = "2 0 51000000 0 0 0 -5000 1 -5 -3 0 0\n"
    assert certainty(Rig(files={FILE: seal(good + other)})) == (codes.COUNTED, codes.COUNTED)
    for bad in (
        "",
        good,
        good + other + other,
        good + "2 0 51000000 0 0 0 -5000 1 -5 -3 0\n",
        good + other.replace(" 1 ", " one "),
        good + other.replace(" 1 ", " 4 "),
        good + other.replace(" 1 ", " -1 "),
        good + other.replace("-5000", str(1 << 30)),
        good + other.replace("-3", str(-1 << 40)),
        good + other.replace(" 0 0 0 -5", " 7 1 8 -5"),  # 8 inside a gap of 7
    ):
        assert_unknown(Rig(files={FILE: seal(bad)}))


def test_a_record_that_somebody_else_has_removed_does_not_hinder():
    rig = recorded()
    del rig.port.files[FILE]
    rig.ask(b"02550000\n")
    rig.run(60_000)
    assert rig.drives() == (255, 0)
    assert rig.errors() == []


def test_while_the_record_cannot_be_removed_nothing_moves():
    for motion in MOTIONS[:-1]:
        rig = recorded()
        rig.port.full = True
        rig.port.edges.clear()
        rig.ask(motion)
        rig.run(400_000)
        assert rises(rig) == []
        assert codes.FAULT in (rig.axis1.reason, rig.axis2.reason)
        assert NOT_SAVED in rig.errors()
        assert known(restart(rig)) == known(restart(recorded()))
        rig.port.full = False
        rig.ask(b"1MV+\n")
        rig.run(60_000)
        assert rig.drives() == (255, 0)


def test_while_the_record_cannot_be_removed_no_position_is_defined_and_nothing_saved():
    rig = recorded()
    knew = known(rig)
    rig.port.full = True
    rig.ask(b"1DH5\n")
    rig.ask(b"SM\n")
    assert rig.errors() == [NOT_SAVED, NOT_SAVED]
    assert known(rig) == knew
    assert known(restart(rig)) == knew


def test_a_position_that_could_not_be_recorded_is_recorded_after_the_next_motion():
    rig = Rig()
    rig.ask(b"1DH0\n")
    rig.port.full = True
    rig.run(3 * REST_US)
    assert rig.errors() == [NOT_SAVED]  # once
    assert certainty(restart(rig)) == (codes.UNKNOWN, codes.UNKNOWN)
    rig.port.full = False
    rig.ask(b"1PR1\n")
    rig.run(1_000_000 + RECORDED_US)
    assert rig.errors() == []
    assert known(restart(rig)) == known(rig)


def test_a_ctrl_c_right_after_the_record_came_or_went_does_not_hide_it():
    # the prompt drives the axes themselves, without the loop
    rig = Rig()
    rig.ask(b"1DH0\n")
    verbs = {"rename": rig.port.rename, "remove": rig.port.remove}

    def interrupted(name):
        def verb(*arguments):
            verbs[name](*arguments)
            raise KeyboardInterrupt

        return verb

    rig.port.rename = interrupted("rename")
    try:
        rig.run(RECORDED_US)
        raise AssertionError
    except KeyboardInterrupt:
        pass
    assert FILE in rig.port.files
    rig.port.remove = interrupted("remove")
    try:
        rig.axis1.steps(1)
        raise AssertionError
    except KeyboardInterrupt:
        pass
    rig.port.remove = verbs["remove"]
    assert FILE not in rig.port.files
    rig.controller.shutdown(codes.ABORTED)
    assert rig.drives() == (0, 0)
    assert rig.axis1.steps(1)
    assert rig.drives() == (255, 0)


class FedPort(Port):
    """A port that notes how often it slept long with the watchdog not fed since the last file operation."""

    unfed = slept = 0

    def any(self, wait_ms):
        if wait_ms > 100 and self.file_log:
            self.slept += 1
            if self.fed_at - START_US < self.file_log[-1][0]:
                self.unfed += 1
        return super().any(wait_ms)


def test_after_a_slow_file_operation_the_watchdog_is_fed_before_the_loop_sleeps():
    rig = Rig(port=FedPort())  # an operation takes 45 ms there; 400 and a sleep of 512 nearly are what a watchdog waits
    rig.app._feed = rig.port.start_watchdog()
    rig.ask(b"1DH0;1PR1\n")
    for full in (False, True):
        rig.port.full = full
        rig.run(2 * RECORDED_US)
        rig.send(b"1PR1\n")
    assert rig.port.slept > 20
    assert not rig.port.unfed
