"""The virtual board in lockstep with its caller: as fast as the processor allows, and repeatable.

Virtual time passes only inside run(). A demo of one minute takes a second of the wall clock and gives the same
result on every computer.
"""

from collections.abc import Callable

from mirrormount.virtual.simulation import Simulation

_QUANTUM_US = 1000  # the longest interval granted at once
_BOOT_US = 8_000_000
_BUFFER = 512  # bytes in the board's input before the host has to wait


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
        room = _BUFFER - simulation.waiting_in
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
