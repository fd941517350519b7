"""What one correction drives and what came of it; how a gap is crossed."""

from dataclasses import dataclass, field

from mirrormount.beam.looking import Vector


@dataclass(frozen=True)
class Creep:
    """How a gap is crossed. Motions of the spots in um (root of the sum of squares).

    mean_um, most_um: by the take-up, on average and hardly ever. least_um, largest_um: by a pulse of the creep.
    jump_steps: a correction by more is made at once, and the next one corrects what the gap's scatter made of it.
    """

    mean_um: float = 5.0
    most_um: float = 45.0
    least_um: float = 15.0
    largest_um: float = 23.0
    jump_steps: float = 0.4


SOFTLY = Creep()  # in a hold: no excursion
QUICKLY = Creep(mean_um=12.0, most_um=100.0, least_um=20.0, largest_um=60.0, jump_steps=0.2)  # in an alignment


@dataclass(eq=False)
class Driven:
    """One actuator in one correction. wished, drove: steps; expected: of the screw, ± sigma. creeps: not sure."""

    i: int
    way: int
    wished: float
    drove: float
    scatter: float
    expected: float
    sigma: float
    creeps: bool
    in_gap: bool


@dataclass(eq=False)
class Outcome:
    """What came of a correction. helped: None if it cannot be told; doubted: actuators
    that are in their gaps after all; stuck: actuators that do not move any more."""

    driven: list[Driven]
    expected_um: Vector
    changed_um: Vector
    met: list[int] = field(default_factory=list)
    stuck: list[int] = field(default_factory=list)
    doubted: list[int] = field(default_factory=list)

    @property
    def helped(self) -> float | None:
        """The part of the expected change that came, if all that moved was in contact."""
        size = float(self.expected_um @ self.expected_um)
        if not size or self.doubted or any(each.in_gap for each in self.driven):
            return None
        return float(self.changed_um @ self.expected_um) / size
