"""How evenly an actuator follows small steps in one direction, of `hardware` beside six real ones.

.venv/bin/python tools/bench/increments.py

MEASURED has what L. Kies (Leibniz University Hannover, github.com/lkies/motorized-mounts, MIT licence, 2024) recorded
of six actuators on kinematic mirror mounts: figures made of these records, not the records. Of each run the part behind
the backlash counts: 55 % of a run of several cycles there and back. An increment is the change of the mirror's angle
for one commanded step, by the run's mean gain. Stuck: an increment of less than a quarter of the step. Double: of more
than twice the step. Residual: the span of 95 % of what a straight line leaves of one run.

`hardware` is driven by the motor's shaft as these actuators were: so far for each step, however the motor does that.
"""

import argparse
from dataclasses import dataclass, replace

import numpy as np

from mirrormount_sim.mechanics import Drivetrain
from mirrormount_sim.profiles import HARDWARE, Profile

READING_URAD = 0.25  # of the mirror: what the records tremble by at rest; chosen from them
STEPS = 6000
RUN = 44  # steps of a run behind the backlash, as in most of the records
LEVER_MM = 40.0  # of the mount that was measured


@dataclass(frozen=True)
class Increments:
    """Of one actuator: the step and the residual in urad of the mirror, shares of all increments."""

    name: str
    step_urad: float
    stuck: float
    double: float
    residual_urad: float


MEASURED = (
    Increments("pancake, geared", 0.84, 0.62, 0.23, 5.9),
    Increments("Newport TRA6CC, DC motor", 1.25, 0.47, 0.24, 5.7),
    Increments("Newport TRA6PPD, stepper", 1.25, 0.46, 0.23, 3.8),
    Increments("cheap, geared", 1.64, 0.36, 0.21, 7.2),
    Increments("cheap, direct", 2.46, 0.38, 0.20, 7.2),
    Increments("pancake, direct", 2.52, 0.49, 0.23, 7.0),
)


def increments(step_urad: float, stick_um: float = HARDWARE.stick_um, profile: Profile = HARDWARE) -> Increments:
    """What the records would show of the screw of this profile, with this sticking."""
    train = Drivetrain(LEVER_MM, profile=replace(profile, stick_um=stick_um, creep=0.0, periodic=0.0), travel_rev=1e6)
    noise = np.random.default_rng(1)
    places = np.empty(STEPS)
    for k in range(STEPS):
        train.turn(step_urad * 1e-6 * LEVER_MM / train.pitch_mm)
        places[k] = train.mirror_rad * 1e6
    places = places[STEPS // 10 :] + noise.normal(0, READING_URAD, STEPS - STEPS // 10)
    ways = np.diff(places) / np.diff(places).mean()
    runs = places[: len(places) // RUN * RUN].reshape(-1, RUN)
    left = runs - np.array([np.polyval(np.polyfit(range(RUN), run, 1), range(RUN)) for run in runs])
    span = float(np.subtract(*np.quantile(left, (0.975, 0.025))))
    return Increments("hardware", step_urad, float((ways < 0.25).mean()), float((ways > 2).mean()), span)


def main() -> None:
    """The table, as docs/mechanics.md has it."""
    argparse.ArgumentParser(description=str(__doc__).partition("\n")[0]).parse_args()
    print("| actuator | step, µrad | stuck: measured, bench | double | residual, µrad |\n|---|--:|--:|--:|--:|")
    for real in MEASURED:
        ours = increments(real.step_urad)
        shares = (
            f"{100 * a:.0f} %, {100 * b:.0f} %" for a, b in ((real.stuck, ours.stuck), (real.double, ours.double))
        )
        residual = f"{real.residual_urad:.1f}, {ours.residual_urad:.1f}"
        print(f"| {real.name} | {real.step_urad:.2f} | {' | '.join(shares)} | {residual} |")


if __name__ == "__main__":
    main()
