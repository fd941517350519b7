"""A rig of two virtual drivetrains without boards and pictures: hundreds of experiments in seconds.

The spot's place follows from the shafts, a drifting beam and the reading's noise, each with its own known size.
"""

import math
from dataclasses import replace

import numpy as np

from mirrormount_beam.experiments.rig import Vector
from mirrormount_beam.observe import FRAMES, Sighting
from mirrormount_sim.mechanics import Drivetrain
from mirrormount_sim.profiles import Profile

PX_PER_RAD = 16_000.0  # of the mirror: 0.4 m, 0.05 mm a pixel, the beam turning twice as far
STEP_US = 200_000
READING_PX = 0.02
DRIFT_PX = 0.05  # in one second, either way
_REST_S = 0.05
_LOOK_S = 0.6


class DrivetrainRig:
    """Axes x and y; rotated by rotation_rad in the picture."""

    def __init__(self, profile: Profile, seed: int, *, rotation_rad: float = 0.0, quiet: bool = False) -> None:
        self.axes = ("x", "y")
        self.picture_px = (640, 480)
        self.noise = np.random.default_rng(seed)
        self.trains = {axis: Drivetrain.new(23.0, profile, self.noise) for axis in self.axes}
        self.rotation_rad = rotation_rad
        self.quiet = quiet
        self.time_s = 0.0
        self.drift = np.zeros(2)
        self.seen: list[tuple[float, Vector]] = []  # of each look: when, and where the spot is without drift and noise
        self.ways: dict[str, float] = {}

    def step_us(self, _axis: str) -> int:
        return STEP_US

    def step(self, axis: str, n: int) -> None:
        for _ in range(abs(n)):
            self.pulse(axis, int(math.copysign(STEP_US, n)))

    def pulse(self, axis: str, us: int) -> None:
        train = self.trains[axis]
        drive = self.ways[axis] = math.copysign(1.0, us)
        train.begin(drive, self.noise)
        train.advance(abs(us) * 1e-6, drive)
        self._drift(abs(us) * 1e-6)
        self._pass(_REST_S)

    def take_up_us(self, _axis: str) -> int:
        return 0

    def step_taken_up(self, axis: str, n: int, take_up_us: int) -> None:
        way = math.copysign(1.0, n)
        if self.ways.get(axis) == -way and take_up_us:
            self.pulse(axis, int(way * take_up_us))
        self.step(axis, n)

    def sleep(self, seconds: float) -> None:
        self._pass(seconds)

    def observe(self, frames: int = FRAMES) -> Sighting:
        self._pass(_LOOK_S)
        x, y = (PX_PER_RAD * self.trains[axis].mirror_rad for axis in self.axes)
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        read = 0.0 if self.quiet else READING_PX * self.noise.standard_normal(2)
        true = np.array([320 + c * x - s * y, 240 - s * x - c * y])
        self.seen.append((self.time_s, true))
        place = true + self.drift + read
        return Sighting(float(place[0]), float(place[1]), READING_PX, READING_PX, self.time_s, frames)

    def _pass(self, seconds: float) -> None:
        """Time at rest: a mount creeps on."""
        for train in self.trains.values():
            train.advance(seconds, 0.0)
        self._drift(seconds)

    def _drift(self, seconds: float) -> None:
        self.time_s += seconds
        if not self.quiet:
            self.drift = self.drift + DRIFT_PX * math.sqrt(seconds) * self.noise.standard_normal(2)


def true_pulse_px(profile: Profile, us: int, count: int = 4000) -> float:
    """The mean way of a pulse over many turns of the screw, by the drivetrain alone."""
    rig = DrivetrainRig(profile, 1, quiet=True)
    train = rig.trains["x"]
    train.travel_rev = math.inf
    rig.step("x", int(math.copysign(5, us)))
    start = train.mirror_rad
    for _ in range(count):
        rig.pulse("x", us)
    return abs(train.mirror_rad - start) * PX_PER_RAD / count


def step_scatter(profile: Profile, count: int = 4000) -> float:
    """The standard deviation of a step in parts of its mean, by a drivetrain whose screw is straight."""
    rig = DrivetrainRig(replace(profile, periodic=0.0), 1, quiet=True)
    train = rig.trains["x"]
    train.travel_rev = math.inf
    rig.step("x", 5)
    places = [train.mirror_rad]
    for _ in range(count):
        rig.pulse("x", STEP_US)
        places.append(train.mirror_rad)
    ways = np.diff(places)
    return float(ways.std() / ways.mean())
