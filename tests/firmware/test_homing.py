"""Homing: what the axis does at which switch. Runs under CPython and MicroPython."""

from rig import Rig

POSITIVE, NEGATIVE = 10, 11  # inputs of axis 1 on the Pico


class Track(Rig):
    """An axis 1 whose drive turns a screw (in microseconds of full drive), with a switch at each end.

    A switch that is open closes slack_us before the place where it opened.
    """

    def __init__(self, at_us, ends=(-1_000_000, 1_000_000), setup=b"", slack_us=0):
        super().__init__()
        self.at_us = at_us
        self.ends = ends
        self.slack_us = slack_us
        self.stuck = ()
        self._since = self.port.us
        self._press()
        self.ask(b"1XL3;1DH0;1VA4\n" + setup)

    def step(self):
        drive = self.drives()[0]
        super().step()
        self.at_us += drive * (self.port.us - self._since) // 255
        self._since = self.port.us
        self._press()

    def _press(self):
        for pin, beyond_us in ((NEGATIVE, self.ends[0] - self.at_us), (POSITIVE, self.at_us - self.ends[1])):
            if pin not in self.stuck:
                slack_us = self.slack_us if self.port.switches.get(pin) else 0
                self.port.switches[pin] = 1 if beyond_us + slack_us >= 0 else 0

    def until_done(self, line, most_us=60_000_000):
        self.ask(line)
        until = self.port.us + most_us
        while self.axis1.moving() and self.port.us < until:
            self.run(10_000)
        assert not self.axis1.moving()
        assert self.drives() == (0, 0)
        return self.axis1.reason


def test_home_is_the_negative_switch_found_slowly_and_then_position_0():
    rig = Track(300_000)
    assert rig.until_done(b"1OR\n") == 1
    assert rig.ask(b"1TP?;1OR?\n") == b"0; 0,0\r\n"
    assert rig.axis1.position.certainty == 2
    assert -30_000 < rig.at_us + 1_000_000 <= 0
    assert rig.errors() == []
    last = rig.on_times(2)[-1]
    assert last <= 26_000  # the last approach was in short pulses


def test_home_is_found_at_the_same_place_from_everywhere():
    found = []
    for at_us in (-1_000_000, -990_000, 0, 700_000, 1_000_000):
        rig = Track(at_us)
        assert rig.until_done(b"1OR\n") == 1, at_us
        found.append(rig.at_us)
    assert max(found) - min(found) < 26_000, found  # one slow pulse


def test_homing_again_tells_how_far_the_count_was_off():
    rig = Track(300_000)
    rig.until_done(b"1OR\n")
    rig.until_done(b"1PR4\n")
    rig.at_us += 100_000  # half a step slipped
    rig.until_done(b"1OR\n")
    known, offset = rig.ask(b"1OR?\n").strip().split(b",")
    assert known == b"1"
    assert -650 < int(offset) < -350


def test_finding_an_end_stop_leaves_the_position_counted_on():
    rig = Track(300_000)
    assert rig.until_done(b"1MT+\n") == 1
    assert rig.at_us >= 1_000_000
    assert 3000 < rig.axis1.position.millisteps < 4500
    assert rig.axis1.position.certainty == 3


def test_a_switch_that_is_not_there_is_not_found_within_the_search_limit():
    rig = Track(0, ends=(-90_000_000, 90_000_000), setup=b"1XT2000\n")
    assert rig.until_done(b"1OR\n") == 12
    assert rig.errors() == [145]
    assert rig.axis1.ended_on_us <= 2_010_000
    assert rig.axis1.position.certainty == 3


def test_a_switch_that_stays_open_is_not_released():
    rig = Track(0)
    rig.port.switches[NEGATIVE] = 1
    rig.stuck = (NEGATIVE,)
    rig.ends = (-90_000_000, 90_000_000)
    assert rig.until_done(b"1OR\n") == 12
    assert rig.errors() == [146]
    assert rig.axis1.ended_on_us <= 20 * 200_000 + 10_000


def test_swapped_switches_end_it_at_the_wrong_one():
    rig = Track(0)
    rig.stuck = (POSITIVE, NEGATIVE)
    rig.port.switches[POSITIVE] = rig.port.switches[NEGATIVE] = 0
    rig.ask(b"1OR\n")
    rig.run(500_000)
    assert rig.axis1.moving()
    rig.port.switches[POSITIVE] = 1
    rig.run(10_000)
    assert not rig.axis1.moving() and rig.drives() == (0, 0)
    assert rig.axis1.reason == 12
    assert rig.errors() == [104]


def test_a_bump_on_the_way_is_not_the_switch():
    rig = Track(300_000)
    rig.ask(b"1OR\n")
    rig.run(200_000)
    rig.stuck = (NEGATIVE,)
    rig.port.switches[NEGATIVE] = 1
    rig.run(5_000)
    assert rig.drives() == (0, 0)
    rig.stuck = ()
    assert rig.until_done(b"\n") == 1
    assert rig.at_us <= -1_000_000 + 1000


def test_without_that_switch_nothing_moves():
    for setup in (b"1XL0\n", b"1ZH1\n"):
        rig = Track(0, setup=setup)
        assert rig.until_done(b"1OR\n") == 0
        assert rig.errors() == [135]
        assert rig.on_times(2) == []
    rig = Track(0, setup=b"1XL2\n")
    rig.until_done(b"1MT+\n")
    assert rig.errors() == [135]


def test_the_only_switch_that_is_fitted_is_home():
    rig = Track(0, setup=b"1XL1\n")
    assert rig.until_done(b"1OR\n") == 1
    assert rig.at_us >= 1_000_000
    assert rig.ask(b"1TP?\n") == b"0\r\n"


def test_an_inverted_axis_homes_at_the_other_switch():
    rig = Track(0, setup=b"1XI1\n")
    assert rig.until_done(b"1OR\n") == 1
    assert rig.at_us >= 1_000_000


def test_every_stop_ends_homing_in_every_phase():
    for phase in range(1, 6):  # as in homing.py
        for stop, reason in ((b"!\n", 3), (b"1ST\n", 2), (b"00000000\n", 2), (b"02550000\n!", 3), (b"~\n", 2)):
            rig = Track(-950_000, slack_us=60_000)  # so that each phase lasts
            rig.ask(b"1OR\n")
            while rig.axis1.homing._phase != phase:
                rig.step()
                assert rig.axis1.moving(), phase
            rig.ask(stop)
            assert rig.drives() == (0, 0) and not rig.axis1.moving(), (phase, stop)
            assert rig.axis1.reason == reason, (phase, stop)
            rig.run(1_000_000)
            assert rig.drives() == (0, 0), (phase, stop)


def test_both_switches_open_is_a_fault():
    rig = Track(0)
    rig.stuck = (POSITIVE, NEGATIVE)
    rig.port.switches[POSITIVE] = rig.port.switches[NEGATIVE] = 1
    assert rig.until_done(b"1OR\n") == 9
    assert rig.errors() == [142]


def test_what_is_set_while_it_homes_is_the_next_moves():
    rig = Track(0)
    rig.ask(b"1OR\n")
    rig.run(100_000)
    assert rig.until_done(b"1XV50;1XD60;1XT200\n") == 1
    assert {duty for _, pin, duty in rig.port.edges if pin == 2} == {0, 65535}
    assert rig.errors() == []
