"""A board whose cable is pulled while the loop drives, and plugged in again: at the pins of both boards.

The boards have a supply of their own here, so that nothing but their keep-alive ends what moves.
"""

import queue
import threading
import time
from contextlib import contextmanager

import pytest
from board_rig import BoardTable
from fast_table import FastCamera
from loop_rig import Rig
from served import wait_for

from mirrormount.errors import CannotOpen, ConnectionLost
from mirrormount.supervise.supervisor import Supervisor
from mirrormount.values import KEEP_ALIVE_MS
from mirrormount_beam.control import events
from mirrormount_beam.control.backlash import Gap
from mirrormount_beam.control.hold import Hold
from mirrormount_beam.control.interlocks import BOARD
from mirrormount_beam.control.response import belongs_to
from mirrormount_beam.table import SharedTable
from mirrormount_sim.profiles import PROFILES
from mirrormount_sim.table import Kind, VirtualTable

OFF_S = KEEP_ALIVE_MS / 1000 + 0.002  # the board looks at its clock once a millisecond
FAR_UM = 4000.0  # some steps of each axis: longer than the keep-alive
DEADLOCK_S = 120.0  # then the test fails
PATIENCE_S = 60.0  # nobody hangs here


def driven(simulation):
    """When motors of a board were on, by its pins: [from, to] in its seconds; to is None where one still is."""
    found, on = [], {}
    for us, pin, duty in list(simulation.edges):
        if pin.endswith("_en") and duty:
            on[pin] = [us * 1e-6, None]
            found.append(on[pin])
        elif pin in on:
            on[pin][1] = us * 1e-6
    return found


def moving(simulation):
    return any(to_s is None for _, to_s in driven(simulation))


@pytest.mark.parametrize("n", [1, 5, 12])
@pytest.mark.parametrize("number", [0, 1])
def test_a_cable_pulled_while_the_loop_holds_has_both_boards_off(number, n):
    with BoardTable() as table:
        told = []

        def pull(_port, _data):
            table.sent[number].pulled = True

        table.be_off(FAR_UM)
        gaps = [Gap(widths) for widths in table.response.widths]
        table.at(n, pull, only_moving=True)
        Hold(table, table.response, gaps, told.append).run(30)
        (gate,) = [event for event in told if isinstance(event, events.InterlockTripped)]
        assert gate.number == BOARD.number and gate.cause.count("the cable was pulled") == 1
        table.virtual.sleep(1.0)
        assert all(to_s <= table.sent[number].heard_s + OFF_S for _, to_s in table.on(number))
        assert all(to_s <= gate.time_s for _, to_s in table.on(1 - number))
        pulsed_s = max(event.time_s for event in told if isinstance(event, events.Pulsed))
        assert pulsed_s < gate.time_s


class Cable:
    """A board's port in real time, with a cable. armed: it is pulled by the first byte while all of these boards drive.

    pulled_us: when, by the board's time.
    """

    def __init__(self, port, armed=()):
        self._port, self._armed = port, list(armed)
        self.pulled_us = None

    def __getattr__(self, name):
        return getattr(self._port, name)

    def _check(self):
        if self.pulled_us is not None:
            raise ConnectionLost("the cable was pulled")

    def write(self, data):
        self._check()
        self._port.write(data)
        if self._armed and all(moving(simulation) for simulation in self._armed):
            self.pulled_us = self._port.simulation.us

    def read(self, timeout_s):
        self._check()
        return self._port.read(timeout_s)

    def close(self):
        """The board goes on."""


class LiveTable:
    """The virtual table in real time, with supervised mounts, eyes that need no pictures, and a loop in a thread."""

    def __init__(self, pulled):
        self.virtual = VirtualTable(Kind(profile=PROFILES["smooth"], seed=1, realtime=True))
        self.truth, calibrated = self.virtual.truth, Rig("smooth", 1)
        self.noise, self.response = calibrated.table.noise, calibrated.response
        armed = [self.virtual.simulations, ()] if pulled == 0 else [(), self.virtual.simulations]
        self.cables = [Cable(port, each) for port, each in zip(self.virtual.ports, armed, strict=True)]
        self._first = list(self.cables)
        self.events = queue.SimpleQueue()
        self.cameras = [FastCamera(self, number, 0.0, (319.5, 239.5)) for number in (0, 1)]
        for eye, spot, part in zip(self.cameras, self.spots_mm(), (0.45, 1.0), strict=True):
            x, y = eye.px((spot[0], spot[1]))
            eye.target_px = x - part * FAR_UM / eye.um_per_px[0], y + part * FAR_UM / 2 / eye.um_per_px[1]

    def now_s(self):
        return time.monotonic()

    def sleep(self, seconds):
        time.sleep(max(0.0, seconds))

    def spots_mm(self):
        return self.truth.spots_mm(self.virtual.now_s())

    def open(self, number):
        """What a supervisor opens: the first cable, and again once that is plugged in."""
        if self._first[number]:
            cable, self._first[number] = self._first[number], None
            return cable
        if self.cables[number].pulled_us is not None:
            raise CannotOpen("not plugged in")
        return self.cables[number]

    def plug_in(self, number):
        self.cables[number] = Cable(self.virtual.ports[number])

    def until(self, kind, true=lambda _event: True):
        """Wait for an event."""
        while True:
            event = self.events.get(timeout=DEADLOCK_S)
            if isinstance(event, kind) and true(event):
                return event

    @contextmanager
    def hold(self):
        with (
            self.virtual,
            Supervisor(lambda: self.open(0), patience_s=PATIENCE_S) as first,
            Supervisor(lambda: self.open(1), patience_s=PATIENCE_S) as second,
            SharedTable("hold", [("first", first, ("x", "y")), ("second", second, ("x", "y"))], self.cameras) as loop,
        ):
            loop.take_control()
            self.response.belongs = belongs_to(loop)
            hold = Hold(loop, self.response, [Gap(widths) for widths in self.response.widths], self.events.put)
            thread = threading.Thread(target=hold.run)
            thread.start()
            try:
                yield hold, (first, second)
            finally:
                hold.stop()
                thread.join()


@pytest.mark.parametrize("number", [0, 1])
def test_a_lost_board_is_told_as_such_and_back_again_it_moves_nothing_before_the_beam_was_seen(number):
    table = LiveTable(number)
    with table.hold() as (hold, supervisors):
        pulled, other = table.virtual.simulations[number], table.virtual.simulations[1 - number]
        gate = table.until(events.InterlockTripped)
        assert gate.number == BOARD.number and gate.cause.startswith("the cable was pulled")
        assert not moving(other)
        wait_for(lambda: pulled.us > table.cables[number].pulled_us + 1_000_000, "a second of the board's time")
        assert not moving(pulled)  # nobody told it
        hold.go_on()  # too early: the board is not there
        table.until(events.StateChanged, lambda event: "not plugged in" in event.why)
        table.truth.laser.blocked = True
        table.plug_in(number)
        wait_for(lambda: supervisors[number].status is not None, "the board to be opened")
        before = [len(driven(simulation)) for simulation in table.virtual.simulations]
        hold.go_on()
        table.until(events.Observed, lambda event: not event.complete)
        assert [len(driven(simulation)) for simulation in table.virtual.simulations] == before
        table.truth.laser.blocked = False
        hold.go_on()
        table.until(events.Pulsed)
