"""A mount with encoders on the bench, its loop closed, and what its screws truly did."""

from dataclasses import replace
from pathlib import Path

from mirrormount.device.mount import Mount
from mirrormount.transport.link import Link
from mirrormount_sim.board import LockstepPort, Options, make_simulation
from mirrormount_sim.machines import THIS, board_text, new_files
from mirrormount_sim.mechanics import COUNTS_A_REV
from mirrormount_sim.profiles import PROFILES

PER_STEP = 280
SETTLED_S = 0.15


class ClosedLoop:
    """A virtual mount of one profile at a supply, in lockstep."""

    def __init__(self, profile: str = "smooth", supply: float = 1.0, *, closed: bool = True, **options) -> None:
        mechanics = replace(PROFILES[profile], supply=supply)
        self.options = Options(encoder=options.pop("encoder", "motor"), profile=mechanics, **options)
        self.simulation = make_simulation(self.options)
        self.bench = self.simulation.bench
        self.mount = Mount(Link(LockstepPort(self.simulation)))
        if closed:
            self.close_loop()

    def close_loop(self, per_step: int = PER_STEP) -> None:
        """Both axes count from here on, from zero."""
        self.mount.apply({name: {"counts_per_step": per_step, "closed_loop": 1} for name in ("x", "y")})
        for axis in self.mount.axes:
            axis.zero()

    def switch_off_and_on(self) -> None:
        """Cut the power now, and start the board again on the same bench and the same files."""
        self.simulation.close()
        self.simulation = make_simulation(self.options, self.bench)
        self.mount = Mount(Link(LockstepPort(self.simulation)))

    def counts(self, motor: str = "m2") -> int:
        """What the motor has truly turned, in counts of its disc."""
        return self.bench.encoders[motor].count(self.bench.trains[motor])

    def screw(self, motor: str = "m2") -> float:
        """Where the screw truly is, in counts."""
        return self.bench.trains[motor].screw_rev * COUNTS_A_REV[self.options.encoder or "motor"]

    def step(self, n: int) -> tuple[int, float]:
        """Make steps of x, wait until nothing moves. Returns what motor and screw have turned, in counts."""
        counts, screw = self.counts(), self.screw()
        self.mount.x.step(n)
        self.mount.sleep(SETTLED_S)
        return self.counts() - counts, self.screw() - screw

    def off_us(self, pin: str = "m2_en") -> int:
        """When that enable went off last, on the bench's clock."""
        from mirrormount_sim.simulation import START_US

        return next(us for us, name, duty in reversed(self.simulation.edges) if name == pin and not duty) + START_US

    def close(self) -> None:
        """Power off."""
        self.mount.close()


def with_files(folder: Path, **options) -> ClosedLoop:
    """One whose board keeps what it saves; MicroPython has the firmware there, too."""
    if options.get("machine") == "micropython":
        board = board_text("pico", 2, options.get("encoder", "motor"))
        (new_files(folder) / THIS).write_text(board, encoding="utf-8")
    return ClosedLoop(files=folder, **options)
