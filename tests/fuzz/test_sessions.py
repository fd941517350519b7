"""Random sessions against the model, and against one invariant: after a stop, everything is off."""

import os
import random
from concurrent.futures import ProcessPoolExecutor

import pytest
from lane_rig import EACH, FIRST, WAITING, LaneRig
from model import parse
from rig import WRAP, Rig

pytestmark = pytest.mark.slow

SESSIONS = 5_000
PIECES = (
    b"02550255", b"-255-100", b"+0010-01", b"00000000", b"0000", b"0255", b"0", b"-", b"+", b"05", b"05>", b"0>1MV+\n",
    b"!", b"!\n", b"\n", b"\r\n", b" ", b"\0", b"1PR5\n", b"2PR-3;1MV+\n", b"1MV-\n", b"XK500;2MV+\n", b"1PA7.5\n",
    b"*IDN?\n", b"1TP?;2TP?\n", b"TB?", b"ST\n", b"AB\n", b"AT\r", b"255255", b"#", b"\x03", b"\x01\x02\x04", b"\xff",
    b"1PR", b";", b"?", b".", b"1", b"9", b"A", b"zz", b"PR12345678", b"XS?" * 20, b"1XP1000;1PR9\n", b"1DH0\n", b">",
    b"1PA9876543210\n", b"1.234567890123", b"2>1PR1\n",
)  # fmt: skip
SILENCES_US = (0, 0, 0, 0, 20, 300, 2_000, 30_000, 49_000, 55_000, 200_000, 1_050_000)


def session(random_: random.Random) -> list[tuple[int, int]]:
    data = b"".join(random_.choice(PIECES) for _ in range(random_.randint(1, 5)))
    if random_.random() < 0.3:
        data = bytearray(data)
        data[random_.randrange(len(data))] = random_.randrange(256)
    pauses = random_.random() < 0.5
    return [(c, random_.choice(SILENCES_US) if pauses and random_.random() < 0.2 else 0) for c in data]


def note_events(rig: Rig, events: list[tuple]) -> None:
    """Write down what the app hands to the controller, and what the lane has obeyed."""
    controller, dispatch, book = rig.controller, rig.app._dispatch, rig.app._input.book
    words = {1: "stop", 2: "zeros", 5: "bad", 6: "long", 7: "returned"}

    def noted(message: int) -> None:
        if message == 3:
            events.append(("frame", rig.app._frame.m1, rig.app._frame.m2))
        elif message == 4:
            events.append(("line", bytes(rig.line.text[: rig.line.length]).decode()))
        elif message:
            events.append((words[message],))
        dispatch(message)
        if not rig.app._receiver.stops_ahead:
            assert not controller.axes[0].drive.inhibited

    def booked() -> bool:
        log = getattr(rig.app._input, "log", [0])
        for i in range(log[WAITING]):
            rig.app._frame.unpack(log[FIRST + EACH * i])
            events.append(("frame", rig.app._frame.m1, rig.app._frame.m2))
        return book()

    rig.app._dispatch = noted
    rig.app._input.book = booked


def play(rig: Rig, data: list[tuple[int, int]]) -> None:
    for c, silence_us in data:
        if silence_us:
            rig.take_in()
        # it comes while the loop sleeps, as in life; the silence began when the byte before it came
        silent_us = rig.port.ticks_us() - rig.app._receiver.received_at & WRAP - 1
        rig.send(bytes([c]), after_us=max(0, silence_us - silent_us))
    rig.take_in()
    while rig.app._receiver.waits():
        rig.step()


def run_sessions(seed: int, count: int, make: type[Rig] = Rig) -> list[str]:
    """Play `count` sessions on a rig. Returns what was wrong, at most ten."""
    random_ = random.Random(seed)
    wrong: list[str] = []
    events: list[tuple] = []
    rig = make()
    note_events(rig, events)
    for _ in range(count):
        data = session(random_)
        events.clear()
        play(rig, data)
        rig.run(1_100_000 if random_.random() < 0.1 else 0)
        shown = f"seed {seed}: {data!r}"
        expected = parse(data)
        if expected != events[: len(expected)] or set(events[len(expected) :]) - {("bad",)}:
            wrong.append(f"{shown}\n  expected {expected}\n  got      {events}")
        rig.send(random_.choice((b"!", b"00000000")))
        rig.take_in()
        rig.run(1_000)
        if rig.drives() != (0, 0) or rig.controller.moving():
            wrong.append(f"{shown}: driving after a stop: {rig.drives()}")
        # whatever it was, after a pause the next good message is obeyed
        rig.run(1_100_000)
        rig.ask(b"0077-033")
        if rig.drives() != (77, -33):
            wrong.append(f"{shown}: the next frame was not obeyed: {rig.drives()}")
        rig.ask(b"!\n1DH0;2DH0;XK0;1XP200000\n")
        rig.port.edges.clear()
        rig.port.sent.clear()
        rig.port.shown.clear()
        while rig.controller.errors.pop():
            pass
        if len(wrong) >= 10:
            break
    return wrong


def test_random_sessions_are_understood_as_the_model_says_and_end_with_everything_off():
    seed = int(os.environ.get("MIRRORMOUNT_FUZZ_SEED", "1"))
    jobs = 8
    sessions = int(os.environ.get("MIRRORMOUNT_FUZZ_SESSIONS", str(SESSIONS)))
    with ProcessPoolExecutor() as pool:
        results = pool.map(run_sessions, range(seed, seed + jobs), [sessions // jobs] * jobs)
        wrong = [line for result in results for line in result]
    assert not wrong, "\n".join(wrong[:10])


@pytest.mark.full
def test_random_sessions_are_understood_so_with_a_fast_lane_too():
    seed = int(os.environ.get("MIRRORMOUNT_FUZZ_SEED", "1"))
    jobs = 8
    sessions = int(os.environ.get("MIRRORMOUNT_FUZZ_LANE_SESSIONS", str(2 * SESSIONS)))
    with ProcessPoolExecutor() as pool:
        results = pool.map(run_sessions, range(seed, seed + jobs), [sessions // jobs] * jobs, [LaneRig] * jobs)
        wrong = [line for result in results for line in result]
    assert not wrong, "\n".join(wrong[:10])


LEGAL = (
    b"02550000", b"0000-255", b"01000100", b"00000000", b"-1000000", b"00000001", b"!", b"!\n", b"\n", b"1PR3\n",
    b"2PR-2\r\n", b"1PA5\n", b"1MV+\n", b"2MV-\n", b"ST\n", b"1ST\n", b"AB\n", b"1DH0\n", b"0>1PR1\n", b"05>2MV+\n",
    b"*IDN?\n", b"1TP?;2TP?\n", b"XK500;1MV-\n", b"1XP100000;1PR2\n", b"AT\n", b"2XI1;2PR1\n", b"1DH999999\n",
)  # fmt: skip


def outcome(first: bytes, second: bytes, apart_us: int) -> tuple:
    rig = Rig()
    rig.send(first)
    if apart_us:
        rig.take_in()
        while rig.app._receiver.unparsed:
            rig.step()
        rig.run(apart_us)
    rig.send(second)
    rig.take_in()
    rig.run(1_000)
    drives = rig.drives()
    rig.run(700_000)
    positions = tuple(axis.position.millisteps for axis in rig.controller.axes)
    targets = tuple(axis.position.target for axis in rig.controller.axes)
    return drives, targets, positions


def test_every_pair_of_legal_messages_glued_does_what_it_does_apart():
    for first in LEGAL:
        for second in LEGAL:
            glued, apart = outcome(first, second, 0), outcome(first, second, 400)
            assert glued[:2] == apart[:2], (first, second)
            # millisteps; the first message acts for half a millisecond longer when apart
            assert all(abs(a - b) <= 20 for a, b in zip(glued[2], apart[2], strict=True)), (
                first,
                second,
                glued,
                apart,
            )
