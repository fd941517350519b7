"""Errors over time: the one definition of what `hold` ends with, its page shows and its report tells. Pure.

What the loop takes for the errors after a look (tracker.py: that look and those before it, weighted by their noise)
counts from then until the next look. Behind a gate nothing counts. So neither the noise of a single look counts as an
error of the beam, nor do many looks in a short while count more.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from mirrormount.beam.control.events import Estimated, Pair


@dataclass
class Sums:
    """Of the errors of one camera, or of the beam's angle: sums over time of x and y. looks: how many there were."""

    looks: int = 0
    seconds: float = 0.0
    x: float = 0.0
    y: float = 0.0
    xx: float = 0.0
    yy: float = 0.0
    most: float = 0.0  # largest magnitude along x or y

    def see(self, pair: Pair) -> None:
        """One look."""
        self.looks += 1
        self.most = max(self.most, *map(abs, pair))

    def last(self, pair: Pair, seconds: float) -> None:
        """It counts for so long."""
        x, y = pair
        self.seconds += seconds
        self.x += x * seconds
        self.y += y * seconds
        self.xx += x * x * seconds
        self.yy += y * y * seconds

    def join(self, other: "Sums") -> None:
        """Add another time."""
        self.looks += other.looks
        self.seconds += other.seconds
        self.x += other.x
        self.y += other.y
        self.xx += other.xx
        self.yy += other.yy
        self.most = max(self.most, other.most)

    @property
    def rms(self) -> Pair:
        """Root of the mean square along x and y, about the target. nan without any time."""
        if not self.seconds:
            return math.nan, math.nan
        return math.sqrt(self.xx / self.seconds), math.sqrt(self.yy / self.seconds)

    @property
    def mean(self) -> Pair:
        """Mean along x and y. nan without any time."""
        return (self.x / self.seconds, self.y / self.seconds) if self.seconds else (math.nan, math.nan)


@dataclass
class OverTime:
    """Of each camera's errors (um) and of the beam's angle (urad). before: the estimate that counts since its time."""

    errors_um: dict[str, Sums] = field(default_factory=dict)
    angle_urad: Sums = field(default_factory=Sums)
    before: Estimated | None = None

    def take(self, estimate: Estimated) -> None:
        """The one before has counted until now."""
        if self.before is not None:
            seconds = max(0.0, estimate.time_s - self.before.time_s)
            for sums, pair in self._each(self.before):
                sums.last(pair, seconds)
        for sums, pair in self._each(estimate):
            sums.see(pair)
        self.before = estimate

    def pause(self) -> None:
        """A gate is closed: nothing counts until the next estimate."""
        self.before = None

    def _each(self, estimate: Estimated) -> list[tuple[Sums, Pair]]:
        found = [(self.errors_um.setdefault(name, Sums()), pair) for name, pair in estimate.errors_um.items()]
        return [*found, (self.angle_urad, estimate.angle_urad)] if estimate.angle_urad else found


def joined(all_sums: "list[Mapping[str, Sums]]") -> dict[str, Sums]:
    """The sums of several times, by camera."""
    found: dict[str, Sums] = {}
    for by_camera in all_sums:
        for camera, sums in by_camera.items():
            found.setdefault(camera, Sums()).join(sums)
    return found
