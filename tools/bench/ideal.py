"""What the mechanics leave to a loop that knows the truth: .venv/bin/python tools/bench/ideal.py [--seeds N]

One axis of the profile `hardware`, and a beam that drifts as on the virtual table. Every 0.4 s, which is the period of
`hold`, a controller that knows the true beam and the state of motor, gap, screw and tip tries each pulse on copies of
the mount, also when the tip will slip next. It does not know what differs from pulse to pulse (friction, speed), so of
each pulse it takes the mean of some draws. The best pulse is then made, if it is better than none. A pulse takes no
time, and a gap is crossed for nothing. So this is a bound for loops that look one correction ahead; none can reach it.
"""

import argparse
import copy
import math
from dataclasses import replace

import _paths  # noqa: F401
import numpy as np

from mirrormount_beam.control.hold import PERIOD_S
from mirrormount_sim.bench import LEVER_X_MM
from mirrormount_sim.mechanics import Drivetrain
from mirrormount_sim.profiles import HARDWARE, Profile
from mirrormount_sim.table import LASER_DRIFT_URAD

LENGTHS_S = np.geomspace(0.001, 0.1, 24)
DRAWS = 4
REST_S = 0.05


def beam_urad(train: Drivetrain) -> float:
    """The angle of the beam, for which that of the mirror counts twice."""
    return 2e6 * math.atan2(train.tip_rev * train.pitch_mm, train.lever_mm)


def pulse(train: Drivetrain, seconds: float, noise: np.random.Generator) -> None:
    """A pulse at full duty, backwards if it is negative, from where the shaft has the screw, and the rest after it."""
    drive = math.copysign(1.0, seconds)
    side = train.ahead if drive > 0 else -train.behind
    train.shaft_rev = train.screw_rev + side * train.gap_rev / 2
    train.begin(drive, noise)
    train.advance(abs(seconds), drive)
    train.advance(REST_S, None)


def held(profile: Profile, seed: int, duration_s: float) -> float:
    """The rms of the beam's angle, urad: of the moments before and after each correction."""
    noise, guess = (np.random.default_rng([seed, which]) for which in (1, 2))
    train = Drivetrain.new(LEVER_X_MM, profile, noise)
    drift_urad, errors = -beam_urad(train), []
    for _ in range(int(duration_s / PERIOD_S)):
        drift_urad += LASER_DRIFT_URAD * math.sqrt(PERIOD_S) * float(noise.standard_normal())
        error = beam_urad(train) + drift_urad
        best, least = 0.0, error**2
        for seconds in (*LENGTHS_S, *-LENGTHS_S):
            total = 0.0
            for _ in range(DRAWS):
                tried = copy.copy(train)
                pulse(tried, float(seconds), guess)
                total += (beam_urad(tried) + drift_urad) ** 2
            if total / DRAWS < least:
                best, least = float(seconds), total / DRAWS
        if best:
            pulse(train, best, noise)
        errors += [error, beam_urad(train) + drift_urad]
    return math.sqrt(float(np.mean(np.square(errors))))


def main() -> None:
    """With stick-slip and without."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--duration", type=float, default=240.0)
    args = parser.parse_args()
    for what, profile in (("hardware", HARDWARE), ("without stick-slip", replace(HARDWARE, stick_um=0.0))):
        found = [held(profile, seed, args.duration) for seed in range(1, args.seeds + 1)]
        print(f"{what}: median {np.median(found):.1f} urad, worst {max(found):.1f}", flush=True)


if __name__ == "__main__":
    main()
