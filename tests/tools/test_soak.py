"""Facts about tools/bench/soak.py: what it says to the board, and what it tells. No board is started here."""

import random
from collections import Counter

import episode
import pytest
import soak
from episode import Move, Tally, Violation

from mountfw.dialect.line import END, MAX_LINE, Line
from mountfw.wire.frame import DONE, Frame


def fits(parser, data: bytes, good: int) -> bool:
    parser.start()
    return [parser.feed(c) for c in data][-1] == good


def test_the_soak_says_good_frames_and_good_lines():
    r = random.Random(3)
    for _ in range(1000):
        assert fits(Frame(), episode.frame(r).rstrip(b"\r\n"), DONE)
        line = episode.line(r)
        assert len(line) < MAX_LINE
        assert fits(Line(), line[: -1 if line[-2:] != b"\r\n" else -2] + b"\n", END), line


def test_the_soak_never_says_ctrl_c():
    r = random.Random(4)
    assert not any(3 in episode.any_message(r) for _ in range(3000))


@pytest.mark.parametrize(
    ("memory", "sinks"),
    [
        ([], False),
        ([9000] * 20, False),
        ([9000, 8000] * 10, False),
        ([9000] + [8990] * 19, False),
        ([9000 - i for i in range(20)], True),
    ],
)
def test_memory_sinks_when_all_of_the_second_half_is_below_all_of_the_first(memory, sinks):
    assert Tally(memory=memory).memory_sinks() is sinks


def test_the_soak_report_tells_a_violation_with_its_bytes():
    tally = Tally(episodes=2, stops=Counter({"!": 3, "zeros": 1}), memory=[9000, 9000, 8000])
    tally.violations.append(Violation(1, 1234, "b'!' took 5000 us, 1040 us allowed", ["0 b'0255'", "1000 b'!'"]))
    text = soak.report(tally, {"seed": 7})
    assert "| seed | 7 |" in text
    assert "| stops | 4: 3 !, 1 zeros |" in text
    assert "| free memory at rest, first, last, least | 9000, 8000, 8000 bytes |" in text
    told = text.partition("## Episode 1\n")[2].splitlines()
    assert "- at 1234 µs: b'!' took 5000 us, 1040 us allowed" in told
    assert "1000 b'!'" in told


def a_move(seed: int, name: str, steps: bool) -> Move:
    """A move of several steps, or a run, with that end."""
    r = random.Random(seed)
    while True:
        move = Move.chosen(r)
        if move.end.name == name and (move.steps > 2) == steps and (move.steps == 0) != steps and move.on_us >= 5_000:
            return move


def test_steps_that_were_all_done_are_in_order():
    move = a_move(1, "none", steps=True)
    pulses, n = [move.on_us + 30] * move.steps, move.way * move.steps
    assert move.complaints(1, n, move.steps * move.on_us, n * 1000, pulses) == []
    assert move.complaints(1, n, move.steps * move.on_us, n * 1000, pulses[1:]) == [
        "the reason",
        "the steps",
        "the time",
    ]
    assert move.complaints(3, n, move.steps * move.on_us, n * 1000, pulses) == ["the reason"]
    assert move.complaints(1, n, move.steps * move.on_us, 0, pulses) == ["the position"]


def test_steps_that_were_cut_short_count_whole_pulses_only():
    move = a_move(2, "!", steps=True)
    pulses = [move.on_us, 2_000]
    assert move.complaints(3, move.way, move.on_us + 2_000, 0, pulses) == []
    assert move.complaints(3, move.way * 2, move.on_us + 2_000, 0, pulses) == ["the steps"]
    assert move.complaints(1, move.way, move.on_us + 2_000, 0, pulses) == ["the reason", "the position"]


def test_a_run_ends_with_its_limit_or_with_what_cut_it():
    move = a_move(3, "zeros", steps=False)
    limit_us = move.limit_ms * 1000
    assert move.complaints(2, 0, limit_us // 2, 0, [limit_us // 2]) == []
    assert move.complaints(6, 0, limit_us, 0, [limit_us]) == []
    assert move.complaints(6, 0, limit_us // 2, 0, [limit_us // 2]) == ["the reason"]
    assert move.errors() == {move.axis * 100 + 40}
