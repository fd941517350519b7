"""A port that returns what the board sends: no reply may drive. Runs under CPython and MicroPython."""

from rig import Rig
from rig_encoder import encoded

from mountfw.wire.frame import Frame, pack
from mountfw.wire.receiver import FRAME, Receiver

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
            due_us = self.rig.port.us + 20_000 if self.due_us is None else self.due_us
            self.rig.port.horizon_us = min(until, max(due_us, self.rig.port.us + 300))
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


def test_a_frame_on_a_port_that_returns_bytes_drives_once_and_is_stopped():
    for mode in MODES:
        for frame in (b"02550000", b"00000255", b"-100-001", b"+0010255\n", b"0010-010\r\n", b"-0000007\n"):
            rig = Rig()
            tty = EchoingTty(rig, mode)
            rig.send(frame)
            tty.run(3_000_000)
            assert rig.drives() == (0, 0), (mode, frame)
            for pin, speed in ((M1, int(frame[:4])), (M2, int(frame[4:8]))):
                assert len(rises(rig, pin)) == (1 if speed else 0), (mode, frame)
            assert numbers(rig) == [60], (mode, frame)


def test_nothing_drives_after_a_stop_however_the_reply_is_cut_and_delayed():
    for mode in ("stty sane", "-icrnl", "igncr -onlcr"):
        for size in (1, 2, 5, 8, 9, 10, 12, 64):
            for delay_us in (300, 90_000, 1_000_000):
                rig = Rig()
                tty = EchoingTty(rig, mode, delay_us, size, 500)
                rig.send(b"02550100\n")
                tty.run(2_000)
                rig.send(b"!\n")
                tty.run(1_500)
                before = len(rises(rig, M1)), len(rises(rig, M2))
                assert rig.drives() == (0, 0) and before == (1, 1), (mode, size, delay_us)
                tty.run(800_000 + delay_us)
                assert (len(rises(rig, M1)), len(rises(rig, M2))) == before, (mode, size, delay_us)
                assert numbers(rig) == [60], (mode, size, delay_us)


def test_a_port_that_begins_to_return_bytes_among_frames_goes_quiet_with_everything_off():
    for size in (3, 8, 10, 64):
        for delay_us in (300, 5_000, 60_000, 300_000):
            rig = Rig()
            rig.ask(b"02550000\n")  # nothing returns, so the next one has no probe
            tty = EchoingTty(rig, "stty sane", delay_us, size)
            rig.send(b"02000100\n")
            tty.run(2_000)
            rig.send(b"!")
            tty.run(5_000_000)
            assert rig.drives() == (0, 0), (size, delay_us)
            # the echo's first line drives until its second one stops it, and that is the end of it
            assert len(rises(rig, M2)) <= 3, (size, delay_us, rises(rig, M2))
            assert sum(rig.on_times(M2)[1:]) < 20_000, (size, delay_us, rig.on_times(M2))
            assert not tty.waiting and set(numbers(rig)) == {60}


def names(rig):
    """The mnemonics of all queries of a board."""
    for number, (_, _, query) in rig.app._commands._commands.items():
        if query:
            name = b""
            while number:
                name = (b"*" if number % 28 == 27 else bytes((0x40 + number % 28,))) + name
                number //= 28
            yield name


def frames_in(answer):
    """How many frames a board understands of its own answer, once it comes back."""
    rig = Rig()
    receiver = Receiver(Frame(pack), rig.line, pack)
    found = 0
    for c in answer:
        receiver.receive(c)
        while receiver.waits():
            found += receiver.next() == FRAME
    return found


def test_no_answer_begins_like_a_frame():
    edge = b"%dDH%s;%dSL%s;%dSR%s;%dPA%s\n"
    asked = 0
    for make in (Rig, encoded):
        for steps in (b"0", b"-1", b"-999999", b"999999", b"-100255"):
            rig = make()
            for axis in (1, 2):
                rig.ask(edge % ((axis, steps) * 4))
                rig.axes[axis - 1].last_relative = int(steps)
                if make is encoded:
                    rig.axes[axis - 1].reader.at = int(steps) * 10
            for moving in (False, True):
                if moving:
                    rig.ask(b"1XM400000;2XM400000;1ZH0;2ZH0;1MV+;2MV-\n")
                for name in sorted(names(rig)):
                    for axis in (b"", b"1", b"2", b"3"):
                        answer = rig.ask(axis + name + b"?\n")
                        assert answer.endswith(CRLF) and not frames_in(answer), (name, axis, answer)
                        asked += 1
    assert asked > 3_000


def test_a_run_over_the_edge_of_counting_tells_no_position_that_is_a_frame():
    rig = Rig()
    rig.ask(b"1XP200;1XD1;1XV255;1DH-999999;1MV-\n")
    for _ in range(20):
        rig.ask(b"-2550000")
        answer = rig.ask(b"1TP?\n")
        assert int(answer.split(CRLF)[-2]) == -999_999, answer
    assert 101 in numbers(rig)


def test_every_other_answer_that_returns_drives_nothing():
    for ask in (b"*IDN?", b"VE?", b"1TP?", b"1VA?", b"XS?", b"TB?", b"XE?;1XE?", b"2XP?", b"XF?", b"HOSTNAME?", b"PH?"):
        rig = Rig()
        tty = EchoingTty(rig)
        rig.send(ask + b"\n")
        tty.run(1_000_000)
        assert rig.drives() == (0, 0), ask
        assert rig.port.edges == [(us, pin, 0) for us, pin, _ in rig.port.edges], ask
        assert set(numbers(rig)) <= {60, 6, 37}, ask  # refused, or as the command of a line that there is not


def test_the_zeros_of_a_stop_do_not_go_round_for_ever():
    rig = Rig()
    tty = EchoingTty(rig)
    rig.send(b"00000000")
    tty.run(1_000_000)
    assert len(rig.port.sent) <= 3 * 25
    assert numbers(rig) == [60]


ECHO = b"00500000\r\n50\r\n0\r\n50\r\n0\r\n"
PROBE = b"#\r\n"


def test_the_probe_goes_before_the_first_echo_after_a_start_a_silence_and_malformed_input():
    rig = Rig()
    assert rig.ask(b"00500000\n") == PROBE + ECHO
    assert rig.ask(b"00500000\n") == ECHO
    rig.run(1_000_000)
    assert rig.ask(b"00500000\n") == ECHO
    rig.run(3_000_000)
    assert rig.ask(b"00500000\n") == PROBE + ECHO
    rig.ask(b"255255\n")
    assert rig.ask(b"00500000\n") == PROBE + ECHO
    assert rig.ask(b"!\n1TP?\n00500000\n").endswith(CRLF + ECHO)


def test_after_the_probe_has_returned_frames_drive_and_are_echoed_after_a_silence_only():
    rig = Rig()
    tty = EchoingTty(rig)
    rig.send(b"02550000\n")
    tty.run(300_000)
    assert rig.drives() == (0, 0)
    rig.run(60_000)  # another program has opened it raw
    assert rig.ask(b"00700000\n") == b""
    assert rig.drives() == (70, 0)
    rig.ask(b"!")
    rig.run(3_000_000)
    assert rig.ask(b"00500000\n") == PROBE + ECHO
    assert numbers(rig) == [60]


def test_a_stop_is_obeyed_while_what_has_returned_is_dropped():
    for stop in (b"!", b"00000000"):
        rig = Rig()
        rig.send(b"#\r\n02550000\r\n255")
        rig.take_in()
        assert rig.drives() == (0, 0)
        rig.ask(b"\n01000100" + stop + b"01000100")
        assert rig.drives() == (0, 0)
        rig.run(60_000)
        rig.ask(b"01000100")
        assert rig.drives() == (100, 100)


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


def test_a_stream_of_frames_is_obeyed_frame_by_frame_from_the_first_on():
    for frames in ((b"0200-100",), (b"0200-100", b"-200-100"), (b"00000100", b"0000-100")):
        for end in (b"\n", b"\r\n", b""):
            for period_us in (2_000, 10_000, 60_000):
                rig = Rig()
                when = stream(rig, frames * (300_000 // period_us // len(frames)), end, period_us)
                assert [us for us in when if us is None or us > 1_500] == [], (frames, end, period_us, when)
                assert numbers(rig) == []


def test_what_returns_allocates_nothing():
    rig = Rig()
    rig.port.locked = True
    for data in (b"02550000\n", b"#\r\n02550000\r\n\r\n255\r\n\r\n", b"1SL?\n", b"-1000000\n", b"2550000\n"):
        rig.send(data)
        rig.run(100_000)
    rig.port.locked = False
    assert set(numbers(rig)) == {60}
