"""A fast table that is calibrated and aligned, with what its loop told."""

import copy
import functools

from fast_table import FastTable

from mirrormount_beam.control.calibrate import Calibration
from mirrormount_beam.control.events import InterlockTripped, Pulsed, StateChanged
from mirrormount_beam.control.hold import Hold, align


@functools.cache
def _measured(profile, seed):
    table = FastTable(profile, seed)
    measuring = Calibration(table)
    response = measuring.run()
    assert align(table, response, measuring.gaps).reached
    return table, response, measuring.gaps


class Rig:
    """table, response, hold; told: all events."""

    def __init__(self, profile="smooth", seed=1):
        self.table, self.response, self.gaps = copy.deepcopy(_measured(profile, seed))
        self.told = []
        self.hold = Hold(self.table, self.response, self.gaps, self.told.append)

    def trips(self):
        return [event.name for event in self.told if isinstance(event, InterlockTripped)]

    def pulses(self, begin_s, end_s):
        return [event for event in self.told if isinstance(event, Pulsed) and begin_s < event.time_s <= end_s]

    def states(self):
        return [event.state for event in self.told if isinstance(event, StateChanged)]

    def run(self, seconds):
        """Hold, with nobody who would open a gate."""
        return self.hold.run(seconds)
