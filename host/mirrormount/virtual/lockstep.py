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
        simulation.on_sent = self.received.append
        self._wants_us = simulation.next_wait()

    def boot(self) -> None:
        """Run until the LED shows that the firmware is ready, for _BOOT_US at most."""
        self.run(_BOOT_US, lambda: self.simulation.lit)

    def send(self, data: bytes) -> None:
        """Queue bytes for the board; it gets them while run() runs."""
        self._outbox += data

    def run(self, us: int, until: Callable[[], bool] = lambda: False) -> bool:
        """Let us microseconds pass, or fewer if until() comes true; then True.

        Raises BoardGone when the firmware's process has ended.
        """
        simulation = self.simulation
        end_us = simulation.now_us + us
        while not until():
            room = _BUFFER - simulation.waiting_in
            if self._outbox and room > 0:
                data, self._outbox = self._outbox[:room], self._outbox[room:]
                t = simulation.now_us
            elif simulation.now_us >= end_us:
                return False
            else:
                data = b""
                t = simulation.now_us + simulation.next_event_us(min(self._wants_us, end_us - simulation.now_us))
            simulation.go(t, max(1, min(_QUANTUM_US, end_us - t)), data)
            self._wants_us = simulation.next_wait()
        return True
