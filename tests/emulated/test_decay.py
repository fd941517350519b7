"""PWM frequency and decay on a real image: the native code of the fast lane, the PWM's registers, the gate."""

import pytest

LEGS = ("m1_pos", "m1_neg")
PERIOD_US = 40_000  # at 25 Hz


def levels(edges) -> dict[str, int]:
    return {pin: duty for _, pin, duty in edges}


def on_us(board, pin: str, since_us: int, until_us: int) -> int:
    """How long a pin was high between two times."""
    on, high_since = 0, None
    for us, name, duty in board.simulation.edges:
        if name == pin:
            if high_since is not None:
                on += max(0, min(us, until_us) - max(high_since, since_us))
            high_since = us if duty else None
    return on if high_since is None else on + max(0, until_us - max(high_since, since_us))


@pytest.fixture
def slow(make_board):
    """A board with both axes at 25 Hz and slow decay. It has driven: no record has to come off the flash."""
    board = make_board()
    board.send(b"1XQ25;2XQ25;1XY1;2XY1\n02550255")
    board.run(100_000)
    board.send(b"!\n")
    board.run(100_000)
    assert board.ask(b"TB?;1XQ?;1XY?\n") == b"0, NO ERROR DETECTED; 25; 1\r\n" and board.off()
    return board


@pytest.mark.parametrize(("frame", "leg"), [(b"00640000", "m1_pos"), (b"-0640000", "m1_neg")])
def test_a_duty_at_25_hz_begins_at_once_and_its_pauses_brake(slow, frame, leg):
    since_us = slow.simulation.us
    slow.send(frame)
    slow.run(5 * PERIOD_US)
    edges = slow.edges_after(since_us)
    begun_us = next(us for us, pin, duty in edges if pin == "m1_en" and duty)
    assert begun_us - since_us < 2_000
    until_us = begun_us + 4 * PERIOD_US
    assert on_us(slow, "m1_en", begun_us, until_us) == 4 * PERIOD_US  # the enable is on in the pauses, too
    # the motor has drive while the legs differ: `neg` stays, `pos` carries the duty
    high_us = on_us(slow, "m1_pos", begun_us, until_us)
    driven_us = high_us if leg == "m1_pos" else 4 * PERIOD_US - high_us
    assert abs(driven_us - 4 * PERIOD_US * 64 / 255) < 300
    slow.send(b"!\n")
    slow.run(20_000)
    assert slow.off()


def test_a_stream_of_frames_at_25_hz_has_the_duty_that_it_says(slow):
    # frames that come faster than the periods must not begin one each: their pauses would go
    since_us = slow.simulation.us
    for _ in range(20):
        slow.send(b"00640000")
        slow.run(10_000)
    until_us = slow.simulation.us
    slow.send(b"!\n")
    slow.run(20_000)
    share = on_us(slow, "m1_pos", since_us, until_us) / (until_us - since_us)
    assert abs(share - 64 / 255) < 0.02


def test_a_stop_is_cut_within_microseconds_with_slow_decay_too(slow):
    for frame in (b"0064-200", b"-0640200", b"02550255"):
        slow.send(frame)
        slow.run(30_000 + len(frame))
        slow.simulation.edges.clear()
        since_us = slow.simulation.us
        slow.send(b"!\n")
        slow.run(20_000)
        off_us = max(us for us, pin, duty in slow.simulation.edges if pin in ("m1_en", "m2_en") and not duty)
        assert off_us - since_us < 60 and slow.off(), (frame, off_us - since_us)
        assert slow.ask(b"TB?\n").startswith(b"0,")


def test_a_step_stays_a_pulse_of_full_duty_and_its_length(slow):
    since_us = slow.simulation.us
    slow.send(b"1PR2\n")
    slow.run(1_500_000)
    ons = [us for us, pin, duty in slow.edges_after(since_us) if pin == "m1_en" and duty]
    offs = [us for us, pin, duty in slow.edges_after(since_us) if pin == "m1_en" and not duty]
    assert all(abs(off - on - 200_000) <= 5 for on, off in zip(ons, offs, strict=True)) and len(ons) == 2
    assert on_us(slow, "m1_pos", ons[0], offs[0]) == offs[0] - ons[0]
