"""A virtual CircuitPython board in lockstep, as tests ask it. conftest.py makes and closes such boards."""

from mirrormount_sim.clocks import Lockstep
from mirrormount_sim.simulation import Simulation

STEP_US = 977  # of CircuitPython's clock
PERIOD_US = 50  # of the PWM


class Board(Lockstep):
    """A board that was switched on and has had its time to start."""

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(simulation)
        self.boot()

    def ask(self, data: bytes, us: int = 100_000) -> bytes:
        """Send, wait for a line to come back, return it."""
        self.received.clear()
        self.send(data)
        self.run(us, lambda: b"\n" in self.received)
        return bytes(self.received)

    def off(self) -> bool:
        return not any(self.simulation.bench.duties().values())

    def edges(self, pin: str, up: bool) -> list[int]:
        return [us for us, name, duty in self.simulation.edges if name == pin and (duty > 0) == up]
