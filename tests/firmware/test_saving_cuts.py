"""The power goes at any point of a save: before, after and in each operation on a file, after any byte of it.

What is left is what the next start finds. It has either the old or the new settings, whole, and for each axis
the right position or certainty 0. (The flash of the emulated RP2040 is cut in tests/emulated/test_saving.py.)
"""

import random

from rig import Port, Rig
from rig_cuts import cuttable

FILES = ("mountfw.settings", "mountfw.position")
OLD = b"1XP150000;1XD200;1XV90;1VA5;1XI0;2XP90000;2XB5000;2VA6\n"
NEW = b"1XP50000;1XD100;1XV91;1VA9;1XI1;2XP80000;2XB7000;2VA7\n"
REST_US = 10_700_000


class PowerCut(Exception):
    """The board has lost its power."""


class CutPort(cuttable(Port)):
    """A port whose power goes at the cut_at'th point of its file operations; None: it never does."""

    def __init__(self, files, cut_at=None):
        super().__init__(files)
        self.cut_at = cut_at
        self.points = 0

    def point(self):
        self.points += 1
        if self.points == self.cut_at:
            raise PowerCut


def settings(rig):
    return rig.ask(b"1XP?;1XD?;1XV?;1VA?;1XI?;2XP?;2XB?;2VA?\n")


def where(axis):
    """The position in the bridge's own direction: an inversion changes the number, not the place."""
    return axis.position_now() * (-1 if axis.inverted else 1)


def prepared():
    """Files with the old settings saved and positions recorded, and what the old and the new settings answer."""
    rig = Rig()
    rig.ask(NEW)
    new = settings(rig)
    rig.ask(b"*RCL0\n" + OLD)
    old = settings(rig)
    rig.ask(b"SM;1DH10;2DH-20;1PR2;2PR-2\n")
    rig.run(2_000_000 + REST_US)
    assert set(rig.port.files) == set(FILES)
    assert old != new
    return rig.port.files, (old, new)


def save_settings(rig):
    rig.ask(NEW + b"SM\n")
    rig.run(REST_US)


def record_positions(rig):
    rig.ask(b"1PR3\n")
    rig.run(2_000_000 + REST_US)
    rig.ask(b"2DH7\n")
    rig.run(REST_US)


def cut(action, files, cut_at):
    """Do it with the power cut. Returns the rig as it was then and whether it was cut."""
    rig = Rig(port=CutPort(dict(files), cut_at))
    try:
        action(rig)
    except PowerCut:
        return rig, True
    return rig, False


def start(rig, wholes):
    """Power on after the cut: nothing is damaged. Returns which of the settings it has."""
    again = Rig(files=dict(rig.port.files))
    assert again.errors() == []
    for axis, before in ((again.axis1, rig.axis1), (again.axis2, rig.axis2)):
        if axis.position.certainty:
            assert where(axis) == where(before)
    return wholes.index(settings(again))


def cut_everywhere(action):
    """Cut in every point of an action. Returns for each which settings there were, and each time's certainties."""
    files, wholes = prepared()
    found = []
    known = []
    cut_at = 1
    while True:
        rig, was_cut = cut(action, files, cut_at)
        found.append(start(rig, wholes))
        again = Rig(files=dict(rig.port.files))
        known.append((again.axis1.position.certainty, again.axis2.position.certainty))
        if not was_cut:
            return found, known
        cut_at += 1


def test_a_cut_anywhere_in_saving_leaves_the_old_settings_or_the_new_ones_whole():
    found, known = cut_everywhere(save_settings)
    assert len(found) > 500
    assert sorted(found) == found, "old ones after the new ones were in place"
    assert 500 < sum(1 for new in found if not new) < len(found)
    assert known[0] == (1, 1)
    assert known[-1] == (3, 3)  # steps of another length
    assert (0, 0) in known


def test_a_cut_anywhere_in_recording_leaves_the_right_position_or_none():
    found, known = cut_everywhere(record_positions)
    assert set(found) == {0}
    assert len(found) > 150
    assert known[0] == known[-1] == (1, 1)
    assert known.count((0, 0)) > 150


def test_cuts_that_follow_cuts_leave_the_settings_whole_and_the_position_right_or_unknown():
    places = random.Random(11)
    original, wholes = prepared()
    files = original
    states = set()
    for _ in range(400):
        action = places.choice((save_settings, record_positions))
        rig, _ = cut(action, files, places.randint(1, 700 if action is save_settings else 250))
        which = start(rig, wholes)
        states.add((which, frozenset(rig.port.files)))
        files = original if places.random() < 0.2 else rig.port.files
    assert len(states) > 6
