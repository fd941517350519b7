"""A bench whose pins are pulsed as a board would, without a board."""

from mirrormount_sim.bench import Bench

STEP_US = 200_000


class Driver:
    """Pulses pins as a board would, without a board."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.us = 0
        for train in (bench.vertical, bench.horizontal):
            train.noise = 0.0

    def step(self, motor: str, way: str, count: int = 1, on_us: int = STEP_US) -> None:
        for _ in range(count):
            self.bench.edge(self.us, f"{motor}_{way}", 65535)
            self.bench.edge(self.us, f"{motor}_en", 65535)
            self.us += on_us
            self.bench.edge(self.us, f"{motor}_en", 0)
            self.bench.edge(self.us, f"{motor}_{way}", 0)
            self.us += 500_000
            self.bench.advance(self.us)
