"""The keep-alive: a client that falls silent. Runs under CPython and MicroPython."""

from rig import Port, Rig


class SlowLooks(Port):
    """A port whose looks at the input take longer."""

    more_us = 0

    def any(self, wait_ms):
        self.us += self.more_us
        return super().any(wait_ms)


def test_motion_stops_when_the_client_falls_silent_and_says_why():
    for motion in (b"XK500;1MV+\n", b"XK500;1PR20\n", b"XK500\n02550000"):
        rig = Rig()
        rig.ask(motion)
        rig.run(400_000)
        assert rig.controller.moving()
        rig.run(100_000)
        assert rig.drives() == (0, 0), motion
        assert rig.errors() == [62]
        assert rig.ask(b"1XE?;XK?\n").split(b",")[0] == b"7"


def test_a_short_keep_alive_is_kept_to():
    rig = Rig()
    rig.send(b"XK5;1MV+\n")
    for i in range(1, 10):
        rig.send(b"\n", after_us=i * 18_000)
    rig.take_in()
    assert 4_500 < rig.on_times(2)[0] < 5_100  # counted from the byte, not from the motion's beginning
    rig = Rig()
    rig.send(b"XK20;1MV+\n")
    for i in range(1, 10):
        rig.send(b"\n", after_us=i * 18_000)
    rig.run(9 * 18_000)
    assert rig.drives() == (255, 0)


def test_a_keep_alive_is_kept_to_while_the_host_does_not_read():
    for ms in (60, 250):
        rig = Rig(port=SlowLooks())
        rig.run(300_000)
        rig.port.more_us = 165  # as an emulated Pico's
        rig.port.reading = False
        rig.send(b"TE?;XK%d;1MV+\n" % ms)
        rig.take_in()
        heard_us = rig.now()
        rig.run(600_000)
        assert rig.drives() == (0, 0)
        off_us = [us for us, pin, duty in rig.port.edges if pin == 2 and not duty][-1]
        assert -5_000 < off_us - heard_us - 1000 * ms < 2_000, ms


def test_any_byte_keeps_a_motion_alive():
    rig = Rig()
    rig.ask(b"XK500;1MV+\n")
    for _ in range(20):
        rig.run(100_000)
        rig.ask(b"\n")
    assert rig.drives() == (255, 0)


def test_a_byte_that_comes_just_before_the_end_keeps_a_motion_alive():
    for before_us in range(50, 5000, 50):
        rig = Rig()
        rig.ask(b"XK100;1MV+\n")
        left_us = rig.controller.silence(rig.port.ticks_us(), rig.app._receiver.received_at)
        rig.send(b"\n", after_us=left_us - before_us)
        rig.run(left_us + 50_000)
        assert rig.drives() == (255, 0), before_us
        rig.run(60_000)
        assert rig.drives() == (0, 0)


def test_a_dead_clients_keep_alive_does_not_cut_the_next_one():
    rig = Rig()
    rig.ask(b"XK300;1PR1\n")
    rig.run(1_000_000)  # its move is done, it is silent: nothing to stop, nothing to tell
    assert rig.errors() == []
    assert rig.ask(b"XK?\n") == b"0\r\n"
    rig.ask(b"1MV+\n")
    rig.run(2_000_000)
    assert rig.drives() == (255, 0)
    rig = Rig()
    rig.ask(b"XK300;1MV+\n")
    rig.run(1_000_000)
    rig.ask(b"1MV+\n")
    rig.run(2_000_000)
    assert rig.drives() == (255, 0)
