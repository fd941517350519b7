"""The two clocks of a virtual board: in lockstep with its caller, or in real time for hosts on its ports.

Lockstep: virtual time passes only inside run(). A demo of one minute takes a second of the wall clock and gives the
same result on every computer.

Real time: one client at a time on a pty, on loopback TCP, or in this process. A second client is refused in one line.
Output that a client does not read waits in the board for the next client, as on a USB port.
"""

import select
import time
from collections.abc import Callable, Sequence

from mirrormount.serve import GRACE_S
from mirrormount.transport.link import AT_PROMPT, TAKEN
from mirrormount_sim.ports import BUFFER, Port
from mirrormount_sim.simulation import Simulation

_QUANTUM_US = 1000  # the longest interval granted at once
_BOOT_US = 8_000_000


# ---- lockstep


class Lockstep:
    """Drives a Simulation: send() queues bytes, run() lets time pass, `received` collects the board's output."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.received = bytearray()
        self._outbox = bytearray()
        self._rested_us = simulation.now_us
        simulation.on_sent = self.received.append
        self._wants_us = simulation.next_wait()

    def boot(self) -> None:
        """Run until the LED shows that the firmware is ready, for _BOOT_US at most."""
        self.run(_BOOT_US, lambda: self.simulation.lit)

    @property
    def at_us(self) -> int:
        """The time that the board has reached; it may rest since simulation.now_us."""
        return max(self._rested_us, self.simulation.now_us)

    def send(self, data: bytes) -> None:
        """Queue bytes for the board; it gets them while run() runs."""
        self._outbox += data

    def run(self, us: int, until: Callable[[], bool] = lambda: False) -> bool:
        """Let us microseconds pass, or fewer if until() comes true; then True.

        Raises BoardGone when the firmware's process has ended.
        """
        end_us = self.simulation.now_us + us
        while not until():
            if not self._step(end_us):
                return False
        return True

    def follow(self, end_us: int, until: Callable[[], bool] = lambda: False) -> bool:
        """As run(), up to a time; but a board that only waits at the end is not woken there."""
        while not until():
            if self._rests_until(end_us):
                self._rested_us = max(self._rested_us, end_us)
                self.simulation.bench.advance(end_us)
                return False
            if not self._step(end_us):
                return False
        return True

    def _rests_until(self, us: int) -> bool:
        """True if no pin changes before that time, unless bytes come: the firmware waits, and no byte is queued."""
        now_us = self.simulation.now_us
        return not self._outbox and now_us + self.simulation.next_event_us(self._wants_us) >= us

    def _step(self, end_us: int) -> bool:
        """Let the firmware go on once. False if the time is over."""
        simulation = self.simulation
        room = BUFFER - simulation.waiting_in
        data = b""
        if self._outbox and room > 0:
            data, self._outbox = self._outbox[:room], self._outbox[room:]
            t = self.at_us
        elif simulation.now_us >= end_us:
            return False
        else:
            t = simulation.now_us + simulation.next_event_us(min(self._wants_us, end_us - simulation.now_us))
            t = max(t, self._rested_us)
        simulation.go(t, max(1, min(_QUANTUM_US, end_us - t)), data)
        self._wants_us = simulation.next_wait()
        return True


_UNREAD = 512  # bytes of unread output before the board reports that the host does not read
_HANGUP_S = 0.02  # interval between checks for an opened pty
_LAG_US = 100_000  # virtual time that is later than this is not caught up


# ---- real time


def serve(simulation: Simulation, ports: Sequence[Port], stopped: Callable[[], bool]) -> None:
    """Run the board in real time on these ports until stopped() is true.

    Raises BoardGone when the firmware's process has ended.
    """
    unread = bytearray()
    simulation.on_sent = unread.append
    start_us, start_s = simulation.now_us, time.monotonic()
    choice = _Choice(ports)

    def wall_us() -> int:
        return start_us + int((time.monotonic() - start_s) * 1e6)

    plugged = True
    while not stopped():
        wants_us = simulation.next_event_us(simulation.next_wait())
        now_us = simulation.now_us
        if wall_us() - now_us > _LAG_US:  # a slow computer: virtual time runs slower than the wall clock
            start_us -= wall_us() - now_us
        if simulation.usb != plugged:
            plugged = simulation.usb
            for port in ports:
                port.plug(plugged)
        client = choice.look(simulation.at_prompt)
        simulation.opened(client is not None)
        if client and unread:
            del unread[: client.give(bytes(unread))]
        room = BUFFER - simulation.waiting_in
        wait_s = max(0.0, (now_us + wants_us - wall_us()) * 1e-6)
        if client and client.waits and room > 0:
            wait_s = 0.0
        watched = [fd for port in ports for fd in port.watched()] if room > 0 else []
        _wait(watched, min(wait_s, _HANGUP_S) if client is None or unread else wait_s)
        client = choice.look(simulation.at_prompt)
        simulation.opened(client is not None)  # before the first byte of a new client
        data = client.take(room, at_prompt=simulation.at_prompt) if client and room > 0 else b""
        t = max(now_us, min(now_us + wants_us, wall_us()))
        simulation.collects(len(unread) < _UNREAD)
        simulation.go(t, max(0, wall_us() - t) + _QUANTUM_US, data)


class _Choice:
    """The port whose client is served: the present one until it disconnects, then the next.

    A client of another port is refused after GRACE_S only: the present one may have disconnected unnoticed.
    """

    def __init__(self, ports: Sequence[Port]) -> None:
        self._ports = ports
        self._waiting: dict[Port, float] = {}
        self.client: Port | None = None

    def look(self, at_prompt: bool) -> Port | None:
        if at_prompt:
            for port in self._ports:
                if not port.prompt and port.connected():
                    port.refuse(AT_PROMPT)
        if self.client is None or not self.client.connected():
            self.client = next((port for port in self._ports if port.connected()), None)
        for port in self._ports:
            if self.client and port is not self.client:
                port.waits_in_vain()
            if port is self.client or not port.connected():
                self._waiting.pop(port, None)
            elif time.monotonic() - self._waiting.setdefault(port, time.monotonic()) > GRACE_S:
                port.refuse(TAKEN)
        return self.client


def _wait(watched: list[int], seconds: float) -> None:
    if watched:
        select.select(watched, [], [], seconds)
    else:
        time.sleep(seconds)
