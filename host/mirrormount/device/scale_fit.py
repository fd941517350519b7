"""From marks on a screen to a scale and a backlash: the arithmetic of `mirrormount setup`.

Angles are the mirror's. A beam that a mirror reflects turns by twice the mirror's angle when the mirror
turns about an axis that is perpendicular to the plane of the beam, and by 2 cos(incidence) when it tips
about an axis in that plane (both follow from r = d - 2 (d·n) n).
"""

import math
from dataclasses import dataclass

from mirrormount.device.settings import SETTINGS


def beam_per_mirror(name: str, incidence_deg: float) -> float:
    """By how much the beam turns when the mirror turns by 1, for axis x or y and a beam in a horizontal plane."""
    return 2.0 if name == "x" else 2.0 * math.cos(math.radians(incidence_deg))


def take_up(lost_us: float) -> tuple[int, str]:
    """The setting take_up_us for what a turn loses, in us of drive; and words where that is beyond its range, or ""."""
    most = int(SETTINGS["take_up_us"].most)
    if lost_us <= most:
        return max(0, round(lost_us)), ""
    return most, f"a turn loses {lost_us * 1e-6:.3g} s of drive, and the board takes up {most * 1e-6:g} s at most"


@dataclass(frozen=True)
class Marks:
    """Where the spot was, in mm along the axis's positive direction, at rest after each of these moves.

    start: after an approach in the positive direction; then n steps forward, n back (the backlash is in
    these), n more back, and n forward again (with the backlash of the other turn).
    """

    start: float
    forward: float
    turned: float
    back: float
    again: float


@dataclass(frozen=True)
class Measured:
    """mrad of the mirror a step, and the steps that were lost in each turn (to negative, to positive)."""

    positive: float
    negative: float
    lost: tuple[float, float]

    @property
    def backlash(self) -> float:
        """Steps that a turn loses, the mean of both; not less than 0."""
        return max(0.0, sum(self.lost) / 2)


def measure(marks: Marks, n: int, distance_mm: float, factor: float) -> Measured | None:
    """The scale from marks that are n steps apart, on a screen at distance_mm across the beam.

    factor is beam_per_mirror(). None if the marks do not go the way that the axis went.
    """

    def mrad(mm: float) -> float:
        return math.atan(mm / distance_mm) / factor * 1e3

    positive = mrad(marks.forward - marks.start) / n
    negative = mrad(marks.turned - marks.back) / n
    if positive <= 0 or negative <= 0:
        return None
    lost = (
        n - mrad(marks.forward - marks.turned) / negative,
        n - mrad(marks.again - marks.back) / positive,
    )
    return Measured(positive, negative, lost)
