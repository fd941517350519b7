"""No integer of the loop leaves the small integers of a 32-bit MicroPython, -2**30 … 2**30-1.

Beyond that arithmetic allocates. A 64-bit VM cannot see it, so a tracer on CPython looks at every
local, every attribute and every value returned, after every line of the core.
"""

import sys
from pathlib import Path
from types import FrameType

from test_memory import SESSION

import mountfw

from rig import Rig  # isort: skip
from rig_encoder import encoded  # isort: skip

LIMIT = 1 << 30
CORE = str(Path(mountfw.__file__).parent)


class Watch:
    """A trace function that notes the first integer out of range, and how much it has seen."""

    def __init__(self) -> None:
        self.bad: list[str] = []
        self.lines = 0

    def check(self, frame: FrameType, name: str, value: object) -> None:
        if type(value) is int and not -LIMIT <= value < LIMIT:
            self.bad.append(f"{frame.f_code.co_qualname}, line {frame.f_lineno}: {name} = {value}")

    def __call__(self, frame: FrameType, event: str, arg: object):
        if not frame.f_code.co_filename.startswith(CORE):
            return None
        self.lines += 1
        for name, value in frame.f_locals.items():
            self.check(frame, name, value)
        this = frame.f_locals.get("self")
        for name, value in vars(this).items() if this is not None else ():
            self.check(frame, f"self.{name}", value)
        if event == "return":
            self.check(frame, "returned", arg)
        return self


def watched(action) -> Watch:
    watch = Watch()
    sys.settrace(watch)
    try:
        action()
    finally:
        sys.settrace(None)
    return watch


def test_integers_stay_small_in_a_session_of_everything_over_a_wrap_of_the_clock():
    rig = Rig()

    def session():
        for data in SESSION:
            rig.send(data)
            rig.settle()
            rig.run(100_000)

    watch = watched(session)
    assert watch.lines > 10_000
    assert watch.bad == []


def test_integers_stay_small_at_the_extremes_of_every_setting():
    extremes = (
        b"1XP2000000;1XD255;1XV255;1XM400000;1XT400000;1DH999999.5;XK60000\n",
        b"1XP200;1XD1;1XV255;1XM400000;1XT400000;1DH-999999;XK60000\n",
        b"1XP2000000;1XD255;1XV1;1VA0.01;1DH0\n",
    )
    for settings in extremes:
        for motion in (b"1MV+\n", b"1MV-\n", b"1PR1\n", b"1PA999999\n", b"02550255"):
            rig = Rig()
            rig.ask(settings)

            def move(rig=rig, motion=motion):
                rig.send(motion)
                rig.settle()
                rig.run(2_100_000)
                rig.send(b"1XE?;XS?\n!")
                rig.settle()

            watch = watched(move)
            assert watch.bad == [], (settings, motion)


def test_the_pure_clock_arithmetic_is_right_across_the_wrap_and_stays_small():
    # the functions that CPython uses; a board has MicroPython's own
    from mountfw.wire import ticks

    times = (0, 1, 2, (1 << 29) - 1, 1 << 29, LIMIT - 2, LIMIT - 1)

    def all_pairs():
        for a in times:
            for d in (0, 1, 1000, (1 << 29) - 1):
                later = ticks.add(a, d)
                assert later == (a + d) % LIMIT
                assert ticks.diff(later, a) == d
                assert ticks.diff(a, later) == -d

    assert watched(all_pairs).bad == []


def test_integers_stay_small_with_an_encoder_at_the_extremes_of_its_settings():
    extremes = (
        b"1XN10000;1MM1;1XP2000000;1XB2000000;1XT400000;1FE10000;1DH999999\n",
        b"1XN-10000;1MM1;1XP200;1XB2000000;1DB10000;1CL10;1DH-999999\n",
        b"1XN1;1MM1;1XP2000000;1XD1;1XB2000000;1CL0;1XG1000;1DH0\n",
        b"1XN280;1MM1;1XA255;1DH999999\n",
    )
    for settings in extremes:
        for motion in (b"1MV+\n", b"1PR-1\n", b"1PA5\n", b"1XU-2000000\n", b"02550255", b"1OR\n"):
            rig = encoded(settings=b"")
            rig.ask(settings)

            def session(rig=rig, motion=motion):
                rig.send(motion)
                rig.settle()
                rig.run(120_000)
                rig.ask(b"1TP?;1PA?;1PR?;XS?;1XC?;1XE?\n")
                rig.send(b"!\n")
                rig.settle()

            assert watched(session).bad == [], (settings, motion)
