"""How far steps scatter with and without encoders: .venv/bin/python tools/encoder_steps.py [--steps 500] [--seed 1]

Makes single steps in a random order of directions on a virtual mount, at several supplies and both profiles, and reads
off the bench what the motor has truly turned (counts of its disc), and what the screw has (after the third step of a
direction, which is beyond all play). Exits with 1 if a counted step is off by more than 2 counts.
"""

import argparse
import random
import statistics
import sys
from dataclasses import replace

from mirrormount import Mount
from mirrormount.transport.lines import Link
from mirrormount.virtual.board import LockstepPort, Options, make_simulation
from mirrormount.virtual.encoder import COUNTS_A_REV
from mirrormount.virtual.profile import PROFILES

PER_STEP = 280
MOST_OFF = 2  # counts, of a counted step
_MOST_AWAY = 200  # steps from the middle: the screw has ends
_SETTLED_S = 0.15
_BEYOND_PLAY = 3


def measure(profile: str, supply: float, closed: bool, steps: int, seed: int) -> tuple[list[float], list[float]]:
    """What each step's motor and screw turned, in counts, in the step's own direction (the screw: beyond the play)."""
    mechanics = replace(PROFILES[profile], supply=supply)
    simulation = make_simulation(Options(encoder="motor", profile=mechanics, seed=seed))
    train, encoder = simulation.bench.trains["m2"], simulation.bench.encoders["m2"]
    choose = random.Random(seed)
    motor: list[float] = []
    screw: list[float] = []
    at, way, same = 0, 1, 0
    with Mount(Link(LockstepPort(simulation))) as mount:
        if closed:
            mount.apply({"x": {"counts_per_step": PER_STEP, "closed_loop": 1}})
        for _ in range(steps):
            if choose.random() < 0.15 or abs(at + way) > _MOST_AWAY:
                way, same = -way, 0
            at, same = at + way, same + 1
            counts, rev = encoder.count(train), train.screw_rev
            mount.x.step(way)
            mount.sleep(_SETTLED_S)
            motor.append((encoder.count(train) - counts) * way)
            if same > _BEYOND_PLAY:
                screw.append((train.screw_rev - rev) * COUNTS_A_REV["motor"] * way)
    return motor, screw


def main() -> int:
    """Print the table. Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    print(f"| loop, profile, supply | counts of a step | scatter (1 sd) | farthest from {PER_STEP} | screw: scatter |")
    print("|---|--:|--:|--:|--:|")
    worst = 0.0
    for closed in (True, False):
        for profile in PROFILES:
            for supply in (0.8, 1.0, 1.2):
                motor, screw = measure(profile, supply, closed, args.steps, args.seed)
                off = max(abs(counts - PER_STEP) for counts in motor)
                worst = max(worst, off) if closed else worst
                mean, scatter = statistics.mean(motor), statistics.stdev(motor)
                print(
                    f"| {'closed' if closed else 'open'}, {profile}, {supply:.0%} | {mean:.2f} | {scatter:.2f}"
                    f" ({scatter / mean:.2%}) | {off:.0f} | {statistics.stdev(screw):.2f} |",
                    flush=True,
                )
    print(f"counted steps: at most {worst:.0f} counts off; {'ok' if worst <= MOST_OFF else 'NOT OK'}")
    return 0 if worst <= MOST_OFF else 1


if __name__ == "__main__":
    sys.exit(main())
