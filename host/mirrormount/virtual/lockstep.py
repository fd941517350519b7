"""The virtual board in lockstep with its user: as fast as it goes, and exact.

Virtual time passes only while somebody waits for the board, in run(). So a test or a demo of a
minute takes a second, and comes out the same on every machine.
"""

from collections.abc import Callable

from mirrormount.virtual.simulation import World

_QUANTUM_US = 1000  # how far the firmware runs before it is asked for news
_BOOT_US = 8_000_000
_BUFFER = 512  # bytes that a board takes in before its host has to wait


class Stepped:
    """Drives a World. send() bytes, run() for a while, take what came in `received`."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.received = bytearray()
        self._outbox = bytearray()
        world.on_sent = self.received.append
        self._wants_us = world.next_wait()

    def boot(self) -> None:
        """Let the board start: until its LED says that the firmware is ready, or for as long as that may take."""
        self.run(_BOOT_US, lambda: self.world.lit)

    def send(self, data: bytes) -> None:
        """Queue bytes for the board; it gets them while run() runs."""
        self._outbox += data

    def run(self, us: int, until: Callable[[], bool] = lambda: False) -> bool:
        """Let us microseconds pass, or fewer if until() comes true; then True.

        Raises BoardGone when the firmware's process has ended.
        """
        world = self.world
        end_us = world.now_us + us
        while not until():
            room = _BUFFER - world.waiting_in
            if self._outbox and room > 0:
                data, self._outbox = self._outbox[:room], self._outbox[room:]
                t = world.now_us
            elif world.now_us >= end_us:
                return False
            else:
                data = b""
                t = world.now_us + world.next_event_us(min(self._wants_us, end_us - world.now_us))
            world.go(t, max(1, min(_QUANTUM_US, end_us - t)), data)
            self._wants_us = world.next_wait()
        return True
