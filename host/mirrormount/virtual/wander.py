"""Angles that wander: a random walk and a jitter, drawn on a grid of time, so that they do not depend on who looks."""

import math

import numpy as np

GRID_S = 0.01  # the walk's step; a jitter stays as long
_MOST = 100_000  # steps drawn at once


class Wander:
    """Two angles (right and up, or yaw and pitch) in radians, as functions of time.

    drift_urad: standard deviation of the walk after one second. jitter_urad: standard deviation about it.
    """

    def __init__(self, noise: np.random.Generator, drift_urad: float, jitter_urad: float) -> None:
        self._noise = noise
        self.drift_urad = drift_urad
        self.jitter_urad = jitter_urad
        self._steps = 0
        self._walk = np.zeros(2)
        self._jitter = np.zeros(2)

    def at(self, time_s: float) -> tuple[float, float]:
        """The angles at a time that is not before the last one asked for."""
        missing = int(time_s / GRID_S) - self._steps
        while missing > 0:
            drawn = self._noise.standard_normal((min(missing, _MOST), 4))
            self._walk += drawn[:, :2].sum(axis=0) * (self.drift_urad * math.sqrt(GRID_S) * 1e-6)
            self._jitter = drawn[-1, 2:] * (self.jitter_urad * 1e-6)
            self._steps += len(drawn)
            missing -= len(drawn)
        return float(self._walk[0] + self._jitter[0]), float(self._walk[1] + self._jitter[1])
