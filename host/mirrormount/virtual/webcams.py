"""The virtual table's cameras: what they see and how they fail, for each profile. All numbers are assumed."""

import numpy as np

from mirrormount.virtual.profile import ROUGH, Profile
from mirrormount.virtual.sensor import Sensor
from mirrormount.virtual.table_camera import FRAMES_S, Timing

_MOST_ROTATION_DEG = 3.0  # of a camera that was put up by hand
_MOST_OFF_PX = 25.0  # of its middle from the beam


def new_webcam(profile: Profile, noise: np.random.Generator) -> tuple[Sensor, Timing]:
    """A camera of the table of this profile, as it stands there."""
    seed, phase_s = int(noise.integers(1 << 31)), float(noise.uniform(0, 1 / FRAMES_S))
    if profile.name != ROUGH.name:
        return Sensor(seed=seed), Timing(phase_s=phase_s)
    sensor = Sensor(seed=seed, ambient_wave=4.0, lamp=10.0, ghost=0.04, hot_pixels=12)
    sensor.rotation_deg = float(noise.uniform(-_MOST_ROTATION_DEG, _MOST_ROTATION_DEG))
    (x, y), (off_x, off_y) = sensor.centre_px, noise.uniform(-_MOST_OFF_PX, _MOST_OFF_PX, 2)
    sensor.centre_px = x + float(off_x), y + float(off_y)
    return sensor, Timing(phase_s=phase_s, latency_spread_s=0.008, dropped=0.01, repeated=0.005)
