"""Frames booked in a lump against the core, which executes each when it comes: same pins, positions and reasons.

Time stands still while either works, so that both see every frame at the very same microsecond.
"""

import os
import random
from concurrent.futures import ProcessPoolExecutor

import pytest
from lane_rig import LanePort, LaneRig
from rig import WRAP, Port, Rig

pytestmark = pytest.mark.slow

SESSIONS = 5_000
LUMPS = 3  # of frames, in each
POSITION = ("millisteps", "part", "made", "certainty", "gap_known", "inside", "_way", "_one_way")
AXIS = ("state", "reason", "ended_steps", "ended_on_us", "has_moved")
DRIVE = ("direction", "duty", "on_us", "on_at", "ends_at", "measuring", "counted_at", "has_begun")
RUNS = 6  # the first of the states whose drive is counted as it goes


class Still:
    """Mixed into a port: its clock shows `still_us`, whatever the core does."""

    still_us: int | None = None

    def ticks_us(self):
        return super().ticks_us() if self.still_us is None else self.still_us & (WRAP - 1)  # type: ignore[misc]


class StillPort(Still, Port):
    pass


class StillLanePort(Still, LanePort):
    pass


def told(rig: Rig) -> list[tuple]:
    """All that a frame changes."""
    found: list[tuple] = [rig.drives()]
    for axis in rig.axes:
        moving = axis.state >= RUNS
        found += [tuple((name, getattr(axis.position, name)) for name in POSITION)]
        found += [tuple((name, getattr(axis, name)) for name in AXIS), moving and axis.ends_as]
        found += [tuple((name, getattr(axis.drive, name)) for name in DRIVE if moving or name == "has_begun")]
    return found


def obey(rig: LaneRig, m1: int, m2: int) -> bool:
    """Let the lane obey a frame now."""
    receiver = rig.app._receiver
    start = receiver.write
    for c in b"%c%03d%c%03d" % (b"0-"[m1 < 0], abs(m1), b"0-"[m2 < 0], abs(m2)):
        receiver.ring[receiver.write] = c
        receiver.write = receiver.write + 1 & receiver.mask
    return rig.looks.obeyed(start)


def session(seed: int) -> None:
    chance = random.Random(seed)
    rigs = Rig(port=StillPort()), LaneRig(port=StillLanePort())
    step_us, duty, gap_us = (
        chance.choice((200, 5_000, 200_000)),
        chance.choice((1, 128, 255)),
        chance.choice((0, 0, 900)),
    )
    start = b"%d" % chance.choice((0, 3, -70))
    before = chance.choice((b"", b"1PR3;2PR-2\n", b"1MV+;2MV-\n", b"02550255", b"0100-003"))
    for rig in rigs:
        words = b"XP%d" % step_us, b"XD%d" % duty, b"XB%d" % gap_us, b"XI%d" % (seed & 1), b"DH" + start
        for axis in (b"1", b"2"):
            rig.ask(b";".join([axis + word for word in words]) + b"\n")
        rig.ask(b"0100-100!\n")
        rig.run(300_000)
        rig.send(before)
        rig.take_in()
        rig.run(2_000)
    now = max(rig.port.us for rig in rigs) + 10
    core, lane = rigs
    for rig in rigs:  # both saw the start at about the same time: from here on, the very same
        for axis in rig.axes:
            axis.drive.counted_at = axis.drive.on_at = now & WRAP - 1
            axis.drive.ends_at = now + 9_000_000 & WRAP - 1
            axis.position.millisteps = axis.position.millisteps // 1000 * 1000
            axis.position.part = 0
            axis.drive.on_us = 0
            axis.next_at = now + 500_000 & WRAP - 1
        assert not rig.controller.errors.waiting
    for _ in range(LUMPS):
        for _ in range(chance.choice((1, 1, 2, 3, 8))):
            now += chance.choice((0, 60, 350, 1_000, 20_000))
            speeds = [chance.choice((0, 1, 100, 255, -1, -100, -255)) for _ in "12"]
            if speeds == [0, 0]:
                continue
            for rig in rigs:
                rig.port.still_us = now
            core.controller.frame(*speeds)
            assert obey(lane, *speeds), seed
            assert lane.drives() == core.drives(), seed
        if not lane.app._input.log[0]:
            continue
        for rig in rigs:
            rig.port.still_us = now + 500
        lane.app._input.book()
        a, b = told(core), told(lane)
        assert a == b, f"seed {seed}:\n core {a}\n lane {b}"
        assert not core.controller.errors.waiting and not lane.controller.errors.waiting
        now += 700
    for rig in rigs:
        rig.port.still_us = now + 30_000
        rig.controller.stop_all(1)
    a, b = told(core), told(lane)
    assert a == b, f"seed {seed}, stopped:\n core {a}\n lane {b}"


def test_frames_booked_in_a_lump_are_counted_as_the_core_counts_each():
    first = int(os.environ.get("MIRRORMOUNT_FUZZ_SEED", "1")) * 1_000_000
    sessions = int(os.environ.get("MIRRORMOUNT_FUZZ_LANE_SESSIONS", str(SESSIONS)))
    with ProcessPoolExecutor() as pool:
        for _ in pool.map(session, range(first, first + sessions), chunksize=500):
            pass
