"""What a run comes to: the residuals as the cameras saw them, and what was done. Imports looking.

A value is of the tracker's errors: the last look and those before it, weighted by their noise (tracker.py). Means are
over time, so that many looks in a short while do not count more.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mirrormount.beam.events import GateClosed
from mirrormount.beam.looking import Vector, lever_m
from mirrormount.beam.loop_table import Eye


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
    _time_s: float | None = None
    _weight_s: float = 0.0
    _squares: Vector | None = None
    _angles: Vector | None = None

    def add(self, time_s: float, errors_um: Vector) -> None:
        """The errors from now on."""
        if self._squares is None or self._angles is None:
            self._squares, self._angles = np.zeros_like(errors_um), np.zeros(2)
        if self._time_s is not None and self.last_um is not None:
            dt = time_s - self._time_s
            self._weight_s += dt
            self._squares += dt * self.last_um**2
            self._angles += dt * self._angle(self.last_um) ** 2
        self._time_s, self.last_um = time_s, errors_um.copy()
        self.max_um = max(self.max_um, float(np.max(np.abs(errors_um))))

    def pause(self) -> None:
        """Nothing is known of the spots until the next add()."""
        self._time_s = None

    def _angle(self, errors_um: Vector) -> Vector:
        lever = lever_m(self.eyes)
        if not lever:
            return np.full(2, np.nan)
        return (errors_um[-2:] - errors_um[:2] if len(self.eyes) > 1 else errors_um[:2]) / lever

    @property
    def rms_um(self) -> Vector | None:
        """Root mean square of each error over time; the last errors of a run too short for that."""
        if self._squares is None or not self._weight_s:
            return self.last_um
        return np.sqrt(self._squares / self._weight_s)

    @property
    def rms_urad(self) -> float | None:
        """Root mean square of the beam's angle, of x or y, whichever is larger; None where no distance is known."""
        if self._angles is None or lever_m(self.eyes) is None or self.last_um is None:
            return None
        worst = self._angles.max() / self._weight_s if self._weight_s else (self._angle(self.last_um) ** 2).max()
        return float(np.sqrt(worst))

    @property
    def last_urad(self) -> float | None:
        """The beam's angle at the end, of x or y, whichever is larger; None where no distance is known."""
        if self.last_um is None or not lever_m(self.eyes):
            return None
        return float(np.max(np.abs(self._angle(self.last_um))))

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
    pairs = errors_um.reshape(-1, 2)
    return {
        eye.name: {"x": round(float(x), 2), "y": round(float(y), 2)} for eye, (x, y) in zip(eyes, pairs, strict=True)
    }
