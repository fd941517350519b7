"""A board in lockstep: virtual time, exact, and as fast as the machine goes."""

from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.clocks import Lockstep


class Board(Lockstep):
    """A board that was switched on and has had its time to start."""

    def __init__(self, options: Options) -> None:
        super().__init__(make_simulation(options))
        self.options = options
        self.boot()

    def drives(self) -> dict[str, float]:
        """What every drive pin shows now, 0 ... 1."""
        return dict(self.simulation.bench.duties())

    def off(self) -> bool:
        return not any(self.drives().values())

    def edges_after(self, us: int) -> list[tuple[int, str, int]]:
        return [edge for edge in self.simulation.edges if edge[0] >= us]

    def ask(self, data: bytes, us: int = 100_000) -> bytes:
        """Send, wait for a line to come back (at most us), return it."""
        self.received.clear()
        self.send(data)
        self.run(us, lambda: b"\n" in self.received)
        return bytes(self.received)

    def until(self, text: bytes, us: int = 20_000_000) -> bytes:
        """Let time pass until the board has sent text; returns all it sent, and forgets it."""
        assert self.run(us, lambda: text in self.received), f"{text!r} did not come: {bytes(self.received[-200:])!r}"
        said = bytes(self.received)
        self.received.clear()
        return said
