"""One clock for several virtual boards and for what happens on the table: in lockstep with the caller, or real.

In lockstep all boards have reached the same time whenever an event happens or a call returns, to the few microseconds
that a board's processor needs for one instruction more.
"""

import heapq
import itertools
import threading
import time
from collections.abc import Callable
from typing import Protocol

from mirrormount.virtual.lockstep import Lockstep
from mirrormount.virtual.simulation import START_US, BoardGone, Simulation

Event = Callable[[], None]
_MOST_S = 3600.0  # of one wait of the thread


class Clock(Protocol):
    """The table's time in seconds, from 0 on."""

    def now_s(self) -> float: ...

    def sleep(self, seconds: float) -> None:
        """Let the table's time pass."""
        ...

    def at(self, time_s: float, event: Event) -> None:
        """Call event() at a time; it must not let time pass. One that is in the past comes at once."""
        ...

    def close(self) -> None: ...


class _Agenda:
    """Events in the order of their times (in whole microseconds), and of their coming where the times are equal."""

    def __init__(self) -> None:
        self._events: list[tuple[int, int, Event]] = []
        self._count = itertools.count()

    def add(self, time_s: float, event: Event) -> None:
        heapq.heappush(self._events, (round(time_s * 1e6), next(self._count), event))

    def next_us(self) -> int | None:
        return self._events[0][0] if self._events else None

    def due(self, us: int) -> Event | None:
        return heapq.heappop(self._events)[2] if self._events and self._events[0][0] <= us else None


class LockstepClock:
    """Time passes in sleep() and run() only, for all boards alike."""

    def __init__(self, simulations: list[Simulation]) -> None:
        self._boards = {simulation: Lockstep(simulation) for simulation in simulations}
        self._gone: list[Simulation] = []
        self._agenda = _Agenda()
        self.now_us = START_US
        self.run(max((simulation.now_us for simulation in simulations), default=START_US) - START_US)

    def board(self, simulation: Simulation) -> Lockstep:
        """What sends to a board and receives from it; its time passes by run() of this clock."""
        return self._boards[simulation]

    def now_s(self) -> float:
        """Seconds since power-up."""
        return (self.now_us - START_US) * 1e-6

    def sleep(self, seconds: float) -> None:
        """Let the table's time pass."""
        self.run(round(seconds * 1e6))

    def at(self, time_s: float, event: Event) -> None:
        """As Clock.at()."""
        self._agenda.add(time_s, event)

    def run(self, us: int, simulation: Simulation | None = None, until: Callable[[], bool] = lambda: False) -> bool:
        """Let microseconds pass, or fewer if until(), which a byte from that board may change, comes true; then True.

        Raises BoardGone if that board has ended. Another one that ends is powered off, and the others go on.
        """
        if simulation is not None and simulation not in self._boards:
            raise BoardGone
        end_us = self.now_us + us
        while True:
            event_us = self._agenda.next_us()
            stop_us = end_us if event_us is None else min(end_us, START_US + event_us)
            came, reached_us = False, max(self.now_us, stop_us)
            if simulation is not None:
                came = self._boards[simulation].follow(reached_us, until)
                if came:
                    reached_us = max(self.now_us, self._boards[simulation].at_us)
            for other, board in list(self._boards.items()):
                if other is not simulation:
                    try:
                        board.follow(reached_us)
                    except BoardGone:
                        self.power_off(other)
            self._happen(reached_us)
            if came or self.now_us >= end_us:
                return came

    def _happen(self, reached_us: int) -> None:
        """The table has reached a time: what is due happens."""
        self.now_us = reached_us
        for simulation in self._gone:
            simulation.bench.advance(reached_us)
        while event := self._agenda.due(self.now_us - START_US):
            event()

    def power_off(self, simulation: Simulation) -> None:
        """End a board: its pins go off, and its mount stays as it is."""
        if board := self._boards.pop(simulation, None):
            simulation.now_us = board.at_us
            simulation.close()
            self._gone.append(simulation)

    def power_on(self, simulation: Simulation, before: Simulation) -> None:
        """A board that was switched on again, on the bench of the one before."""
        self._gone.remove(before)
        self._boards[simulation] = Lockstep(simulation)
        self.run(0)

    def close(self) -> None:
        """Power all boards off."""
        for simulation in list(self._boards):
            self.power_off(simulation)


class RealtimeClock:
    """The wall clock from now on. Events happen in a thread."""

    def __init__(self) -> None:
        self._start_s = time.monotonic()
        self._agenda = _Agenda()
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="optical table", daemon=True)
        self._thread.start()

    def now_s(self) -> float:
        """Seconds since the table was opened."""
        return time.monotonic() - self._start_s

    def sleep(self, seconds: float) -> None:
        """Wait: here the wall's time is the table's."""
        time.sleep(max(0.0, seconds))

    def at(self, time_s: float, event: Event) -> None:
        """As Clock.at(); events come late by what the computer is busy."""
        with self._changed:
            self._agenda.add(time_s, event)
            self._changed.notify()

    def _work(self) -> None:
        while not self._closed:
            with self._changed:
                event = self._agenda.due(round(self.now_s() * 1e6))
                if event is None and not self._closed:
                    next_us = self._agenda.next_us()
                    self._changed.wait(_MOST_S if next_us is None else max(0.0, next_us * 1e-6 - self.now_s()))
            if event:
                event()

    def close(self) -> None:
        """No event happens any more."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(5)
