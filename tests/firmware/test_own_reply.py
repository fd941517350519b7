"""A terminal driver that returns the board's output: no reply may drive. Runs under CPython and MicroPython."""

from rig import Rig

M1 = 2  # the enables' pins on the Pico
M2 = 5
CRLF = b"\r\n"
# what a terminal driver makes of \r and of \n, mode by mode
MODES = {
    "stty sane": (b"\r\n", b"\r\n"),
    "-onlcr": (b"\n", b"\n"),
    "igncr": (b"", b"\r\n"),
    "igncr -onlcr": (b"", b"\n"),
    "-icrnl": (b"^M", b"\r\n"),
    "-icrnl -echoctl": (b"\r", b"\r\n"),
    "-icrnl -echoctl -onlcr": (b"\r", b"\n"),
    "inlcr": (b"^M", b"^M"),
    "inlcr -echoctl": (b"\r", b"\r"),
    "inlcr icrnl": (b"\r\n", b"^M"),
}


class EchoingTty:
    """Returns what the board sends, transformed, delay_us later, in pieces of `size` bytes that are apart_us apart."""

    def __init__(self, rig, mode="stty sane", delay_us=1_000, size=64, apart_us=1_000):
        self.rig = rig
        self.cr, self.lf = MODES[mode]
        self.delay_us, self.size, self.apart_us = delay_us, size, apart_us
        self.seen = len(rig.port.sent)
        self.waiting = b""
        self.due_us = None

    def turn(self):
        """Take what was sent, and return what is due."""
        port = self.rig.port
        fresh = bytes(port.sent[self.seen :])
        self.seen += len(fresh)
        for c in fresh:
            self.waiting += self.cr if c == 13 else self.lf if c == 10 else bytes([c])
        if self.waiting and self.due_us is None:
            self.due_us = port.us + self.delay_us
        if self.due_us is not None and port.us >= self.due_us and port.taken == len(port.inbox):
            self.rig.send(self.waiting[: self.size])
            self.waiting = self.waiting[self.size :]
            self.due_us = port.us + self.apart_us if self.waiting else None

    def run(self, us):
        """As Rig.run()."""
        until = self.rig.port.us + us
        while self.rig.port.us < until:
            self.rig.port.horizon_us = min(until, self.rig.port.us + 300)
            self.turn()
            self.rig.step()


def rises(rig, pin):
    """When this pin rose from low, in microseconds since the start."""
    times, level = [], 0
    for us, number, duty in rig.port.edges:
        if number == pin:
            if duty and not level:
                times.append(us)
            level = duty
    return times


def numbers(rig):
    codes = []
    while rig.controller.errors.waiting:
        codes.append(rig.controller.errors.pop())
    return codes


def test_a_frame_on_an_echoing_port_drives_once_and_is_stopped_with_an_error_of_its_own():
    for mode in MODES:
        for frame in (b"02550000", b"00000255", b"-100-001", b"+0010255\n", b"0010-010\r\n", b"-0000007\n"):
            rig = Rig()
            tty = EchoingTty(rig, mode)
            rig.send(frame)
            tty.run(3_000_000)
            assert rig.drives() == (0, 0), (mode, frame)
            for pin, speed in ((M1, int(frame[:4])), (M2, int(frame[4:8]))):
                assert len(rises(rig, pin)) == (1 if speed else 0), (mode, frame)
            found = numbers(rig)
            assert found and set(found) == {68}, (mode, frame, found)


def test_nothing_drives_after_a_stop_however_the_reply_is_cut_and_delayed():
    for mode in ("stty sane", "-icrnl", "igncr -onlcr"):
        for size in (1, 2, 5, 7, 8, 9, 10, 11, 12, 13, 15, 64):
            for delay_us in (300, 40_000, 90_000):
                rig = Rig()
                tty = EchoingTty(rig, mode, delay_us, size, 500)
                rig.send(b"02550100\n")
                tty.run(2_000)
                rig.send(b"!\n")
                tty.run(1_500)
                before = len(rises(rig, M1)), len(rises(rig, M2))
                assert rig.drives() == (0, 0) and before == (1, 1), (mode, size, delay_us)
                tty.run(800_000)
                assert (len(rises(rig, M1)), len(rises(rig, M2))) == before, (mode, size, delay_us)
                assert 68 in numbers(rig), (mode, size, delay_us)


def test_a_reply_that_returns_whole_does_not_drive_up_to_a_second_later():
    for delay_us in (150_000, 300_000, 600_000, 1_000_000):
        for mode in MODES:
            rig = Rig()
            tty = EchoingTty(rig, mode, delay_us, 256)
            rig.send(b"02550100\n")
            tty.run(2_000)
            rig.send(b"!\n")
            tty.run(3_000_000)
            assert len(rises(rig, M1)) == 1, (mode, delay_us)
            assert 68 in numbers(rig), (mode, delay_us)


def test_a_slow_reply_that_is_cut_behind_the_frame_stops_with_its_next_line():
    rig = Rig()
    tty = EchoingTty(rig, "stty sane", 400_000, 10, 1_000)
    rig.send(b"02550100\n")
    tty.run(2_000)
    rig.send(b"!\n")
    tty.run(3_000_000)
    assert sum(rig.on_times(M1)[1:]) < 3_000
    assert rig.drives() == (0, 0)
    assert numbers(rig)[-1] == 68


def test_an_answer_that_is_a_frame_does_not_drive():
    for ask in (b"1SL?\n", b"1SL?;2SL?\n", b"1DH-1000000;1TP?;1TP?\n", b"1PA?\n"):
        for size in (3, 8, 64):
            rig = Rig()
            rig.axis1.position.target = -1_000_000
            tty = EchoingTty(rig, "stty sane", 1_000, size)
            rig.send(ask)
            tty.run(2_000_000)
            assert rig.port.edges == [(us, pin, 0) for us, pin, _ in rig.port.edges], (ask, size)
            assert 68 in numbers(rig), (ask, size)


def test_every_other_answer_that_returns_stops_with_the_same_error():
    for ask in (b"*IDN?", b"VE?", b"1TP?", b"1VA?", b"XS?", b"TB?", b"XE?;1XE?", b"2XP?", b"XF?", b"HOSTNAME?", b"PH?"):
        rig = Rig()
        rig.ask(b"1MV+\n")
        tty = EchoingTty(rig)
        rig.send(ask + b"\n")
        tty.run(1_000_000)
        assert rig.drives() == (0, 0), ask
        assert numbers(rig)[-1] == 68, ask


def test_the_zeros_of_a_stop_do_not_go_round_for_ever():
    rig = Rig()
    tty = EchoingTty(rig)
    rig.send(b"00000000")
    tty.run(1_000_000)
    assert len(rig.port.sent) <= 3 * 25
    assert 68 in numbers(rig)


def stream(rig, frames, end, period_us):
    """Send frames, and return when each drove first (None: not within 3 ms)."""
    when = []
    for frame in frames:
        at = rig.now()
        rig.send(frame + end)
        wanted = (int(frame[:4]), int(frame[4:]))
        seen = None
        while rig.now() < at + period_us:
            rig.port.horizon_us = rig.port.us + 200
            rig.step()
            if seen is None and rig.drives() == wanted:
                seen = rig.now() - at
        when.append(seen)
    return when


def test_a_stream_of_frames_is_obeyed_frame_by_frame():
    for frames in ((b"0200-100",), (b"0200-100", b"-200-100"), (b"00000100", b"0000-100")):
        for end in (b"\n", b"\r\n", b""):
            for period_us in (2_000, 10_000, 60_000):
                rig = Rig()
                when = stream(rig, frames * (300_000 // period_us // len(frames)), end, period_us)
                # a repeated frame may wait for the next one, until it is known that nothing returns
                late = [us for us in when[140_000 // period_us + 1 :] if us is None or us > 1_500]
                assert late == [], (frames, end, period_us, when)
                assert numbers(rig) == []


def test_pulses_by_hand_keep_their_length():
    for end in (b"\n", b"\r\n", b""):
        for rest_us in (200_000, 1_500_000, 4_000_000):
            rig = Rig()
            for _ in range(4):
                for frame, us in ((b"02550000", 200_000), (b"00000000", rest_us)):
                    rig.send(frame + end)
                    rig.run(us)
            times = rig.on_times(M1)
            assert len(times) == 4 and all(abs(us - 200_000) < 1_000 for us in times), (end, rest_us, times)
            assert numbers(rig) == []


def test_a_frame_again_at_once_waits_twenty_milliseconds_at_most():
    for end in (b"\n", b"\r\n", b""):
        rig = Rig()
        rig.ask(b"02550000" + end)
        rig.ask(b"!")
        rig.send(b"02550000" + end)
        rig.run(10_000)
        assert rig.drives() == (0, 0)
        rig.run(12_000)
        assert rig.drives() == (255, 0), end
        assert numbers(rig) == []


def test_a_frame_that_waited_ends_at_the_run_limit_though_nobody_reads():
    for us in range(0, 260_000, 20_000):  # when the loop would sleep for long
        rig = Rig()
        rig.ask(b"1XM20\n")
        rig.run(us)
        rig.ask(b"02550000")
        rig.ask(b"!")
        rig.port.reading = False
        rig.port.edges.clear()
        rig.send(b"02550000")  # as the reply that was sent: it waits for the bytes after it
        rig.take_in()
        rig.run(400_000)
        assert 19_500 < rig.on_times(2)[0] < 20_500, us


def test_what_a_waiting_frame_turns_off_goes_off_at_once():
    rig = Rig()
    rig.ask(b"02550000\n")
    rig.ask(b"02550100\n")
    rig.send(b"02550000\n")
    rig.run(3_000)
    assert rig.drives() == (255, 0)


def test_a_stop_behind_a_waiting_frame_is_off_at_once_and_the_frame_does_not_drive():
    for stop in (b"!", b"00000000", b"\n!", b"\r\n2!", b"\n00000000"):
        rig = Rig()
        rig.ask(b"02550000\n")
        rig.ask(b"!\n")
        before = len(rises(rig, M1))
        rig.send(b"02550000" + stop)
        rig.run(3_000)
        assert rig.drives() == (0, 0), stop
        rig.run(1_500_000)
        assert len(rises(rig, M1)) == before, stop


def test_a_command_behind_a_waiting_frame_is_obeyed():
    rig = Rig()
    rig.ask(b"01000000\n")
    assert rig.ask(b"01000000\n1XP?;TE?\n").endswith(b"200000; 0\r\n")
    assert rig.drives() == (100, 0)


def test_a_frame_typed_without_padding_after_the_same_frame_is_malformed_and_not_our_own():
    rig = Rig()
    rig.ask(b"02550000\n")
    rig.ask(b"255255\n")
    assert rig.drives() == (0, 0)
    assert rig.errors() == [60]


def test_after_our_own_reply_the_port_is_obeyed_again_when_it_is_quiet():
    rig = Rig()
    tty = EchoingTty(rig)
    rig.send(b"02550000\n")
    tty.run(300_000)
    assert rig.drives() == (0, 0)
    rig.run(60_000)  # another program has opened it raw
    rig.send(b"00700000\n")
    rig.run(30_000)
    assert rig.drives() == (70, 0)
    rig.send(b"!")
    rig.run(1_100_000)
    assert rig.ask(b"00500000\n") == b"00500000\r\n50\r\n0\r\n50\r\n0\r\n"


def test_deciding_allocates_nothing():
    rig = Rig()
    rig.port.locked = True
    for data in (b"02550000\n", b"02550000\r\n\r\n255\r\n\r\n", b"1SL?\n", b"-1000000\n", b"02550000\n2550000\n"):
        rig.send(data)
        rig.run(100_000)
    rig.port.locked = False
    assert 68 in numbers(rig)


def test_an_answer_that_returns_is_one_error_though_its_beginning_was_malformed():
    rig = Rig()
    answer = rig.ask(b"XS?\n")
    assert answer[:3].isdigit()  # no line begins so: refused before the rest says what it is
    rig.send(answer)
    rig.settle()
    assert numbers(rig) == [68]
