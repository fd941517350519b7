"""What a run comes to: the residuals as the cameras saw them, and what was done. Imports looking.

Means are those of over_time.py.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mirrormount.beam.events import Estimated, GateClosed
from mirrormount.beam.looking import Vector, angle_urad, in_pairs
from mirrormount.beam.loop_table import Eye
from mirrormount.beam.over_time import OverTime


@dataclass
class Summary:
    """Of one run of a loop. Lengths in um on the cameras' planes, angles in urad of the beam."""

    eyes: Sequence[Eye]
    corrections: int = 0
    actions: int = 0
    reversals: int = 0
    motor_s: float = 0.0
    seconds: float = 0.0
    gates: list[GateClosed] = field(default_factory=list)
    reached: bool = False
    last_um: Vector | None = None
    max_um: float = 0.0
    held: OverTime = field(default_factory=OverTime)

    def add(self, time_s: float, errors_um: Vector) -> Estimated:
        """The errors from now on."""
        errors = {eye.name: pair for eye, pair in zip(self.eyes, in_pairs(errors_um), strict=True)}
        estimate = Estimated(time_s, errors, angle_urad(self.eyes, errors_um))
        self.held.take(estimate)
        self.last_um = errors_um.copy()
        self.max_um = max(self.max_um, float(np.max(np.abs(errors_um))))
        return estimate

    def pause(self) -> None:
        """Nothing is known of the spots until the next add()."""
        self.held.pause()

    @property
    def rms_um(self) -> Vector | None:
        """Root mean square of each error over time; the last errors of a run too short for that."""
        rms = [um for sums in self.held.errors_um.values() for um in sums.rms]
        return np.array(rms) if np.isfinite(rms).all() and rms else self.last_um

    @property
    def rms_urad(self) -> float | None:
        """Root mean square of the beam's angle, of x or y, whichever is larger; None where no distance is known."""
        worst = max(self.held.angle_urad.rms)
        return self.last_urad if math.isnan(worst) else worst

    @property
    def last_urad(self) -> float | None:
        """The beam's angle at the end, of x or y, whichever is larger; None where no distance is known."""
        angle = None if self.last_um is None else angle_urad(self.eyes, self.last_um)
        return None if angle is None else max(map(abs, angle))

    def to_json(self, *, final: bool) -> dict[str, Any]:
        """Plain data. final: what is left at the end (an alignment), else over time (a hold)."""
        residual = self.last_um if final else self.rms_um
        urad = self.last_urad if final else self.rms_urad
        rounded = None if urad is None else round(urad, 3)
        return {
            "reached": self.reached,
            "corrections": self.corrections,
            "residual_um": {} if residual is None else _by_camera(self.eyes, residual),
            "rms_urad": rounded,
            "max_um": round(
                float(np.max(np.abs(self.last_um))) if final and self.last_um is not None else self.max_um, 2
            ),
            "actions": self.actions,
            "reversals": self.reversals,
            "motor_s": round(self.motor_s, 3),
            "seconds": round(self.seconds, 3),
            "gates": [
                {"time_s": round(g.time_s, 3), "number": g.number, "name": g.name, "cause": g.cause} for g in self.gates
            ],
        }


def _by_camera(eyes: Sequence[Eye], errors_um: Vector) -> dict[str, dict[str, float]]:
    pairs = in_pairs(errors_um)
    return {eye.name: {"x": round(x, 2), "y": round(y, 2)} for eye, (x, y) in zip(eyes, pairs, strict=True)}
