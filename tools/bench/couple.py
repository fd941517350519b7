"""How well `align --signal` couples the virtual fibre, beside a plain simplex and a raster, over seeds.

.venv/bin/python tools/bench/couple.py [--mounts 1|2] [--seeds N] [--method sweeps|simplex|raster]

Each seed is another virtual table of `hardware`: boards, firmware, motors, and a fibre with 1 % of the light, read with
a noise of 2 %. Coupled: at the end, after at most ten minutes of the mounts' time, the fibre has 95 % of the light that
these mounts can bring into it then. docs/signal.md has a run. Simplex (J. A. Nelder and R. Mead, 1965) and raster
believe that a step is a step: they know of no gap. A raster of four axes takes those of the last mount first.
"""

import argparse
import contextlib
import itertools
from collections.abc import Callable, Iterator

import numpy as np

from mirrormount.device.mount import Mount
from mirrormount.transport.link import Link
from mirrormount_beam.control.interfaces import LoopTable
from mirrormount_beam.control.maximise import maximise
from mirrormount_beam.table import LocalTable
from mirrormount_sim.table import open_table

MOST_S = 600.0
READINGS = 16  # of a mean, for simplex and raster: 0.5 %
FIRST_STEPS = 0.5  # of the simplex: what brings the light from 1/e to its maximum, nearly
PITCH, HALF = 0.25, 6  # of the raster, in steps, and points either way
SHORTEST_US = 5000


class _OutOfTime(Exception):
    pass


class Stepper:
    """Axes that are driven to counted positions, in steps; and the mean of some readings there."""

    def __init__(self, table: LoopTable, read: Callable[[], float]) -> None:
        self._table, self._read = table, read
        self._at = np.zeros(len(table.actuators))
        self._end_s = table.now_s() + MOST_S

    def go(self, steps: np.ndarray) -> float:
        """Go there, one axis after the other. The signal there."""
        for actuator, way in zip(self._table.actuators, steps - self._at, strict=True):
            left_us = round(float(way) * actuator.step_us)
            while abs(left_us) >= SHORTEST_US:
                us = max(-400_000, min(400_000, left_us))  # the keep-alive of a longer one would have to be fed
                actuator.pulse(us)
                self._table.sleep(abs(us) * 1e-6 + 0.05)
                while actuator.is_moving():
                    self._table.sleep(0.01)
                left_us -= us
        self._at = steps.copy()
        if self._table.now_s() > self._end_s:
            raise _OutOfTime
        return float(np.mean([self._read() for _ in range(READINGS)]))


def simplex(stepper: Stepper, axes: int) -> None:
    """Nelder and Mead's, with their coefficients, until its corners differ by less than a hundredth of a step."""
    corners = [np.zeros(axes), *(FIRST_STEPS * np.eye(axes))]
    values = [stepper.go(corner) for corner in corners]
    while np.ptp(corners, axis=0).max() > 0.01:
        order = np.argsort(values)[::-1]
        corners, values = [corners[i] for i in order], [values[i] for i in order]
        middle = np.mean(corners[:-1], axis=0)
        away = middle - corners[-1]
        value = stepper.go(middle + away)
        if value > values[0]:
            farther = stepper.go(middle + 2 * away)
            corners[-1], values[-1] = (middle + 2 * away, farther) if farther > value else (middle + away, value)
        elif value > values[-2]:
            corners[-1], values[-1] = middle + away, value
        else:
            inner = stepper.go(middle - 0.5 * away)
            if inner > values[-1]:
                corners[-1], values[-1] = middle - 0.5 * away, inner
            else:
                corners = [corners[0], *((corner + corners[0]) / 2 for corner in corners[1:])]
                values = [values[0], *(stepper.go(corner) for corner in corners[1:])]
    stepper.go(corners[int(np.argmax(values))])


def raster(stepper: Stepper, axes: int) -> None:
    """Row by row to and fro over the two axes of a mount, then to the best point; again with half the pitch."""
    best = np.zeros(axes)
    for pitch in (PITCH, PITCH / 2):
        for pair in [(j, j + 1) for j in range(axes - 2, -1, -2)]:
            middle, most = best.copy(), -np.inf
            for row in range(-HALF, HALF + 1):
                for column in range(-HALF, HALF + 1):
                    point = middle.copy()
                    point[list(pair)] += pitch * row, pitch * (column if row % 2 else -column)
                    if (value := stepper.go(point)) > most:
                        best, most = point, value
            stepper.go(best)


@contextlib.contextmanager
def opened(
    seed: int, mounts: int, profile: str
) -> Iterator[tuple[LocalTable, Callable[[], float], Callable[[], float]]]:
    """A table, a reading of its meter, and the truth: what part there is of the light that can be there now."""
    url = f"virtual-table://?profile={profile}&mounts={mounts}&seed={seed}"
    with contextlib.closing(open_table(url)) as table, contextlib.ExitStack() as stack:
        names = ("first", "second")[:mounts]
        made = {name: stack.enter_context(Mount(Link(port))) for name, port in zip(names, table.ports, strict=True)}

        def coupled() -> float:
            light, most = table.truth.fibre_light(table.now_s())
            return light / most

        yield LocalTable(made, [], table.now_s, table.sleep), table.power, coupled


def one(method: str, seed: int, mounts: int, profile: str) -> tuple[float, float]:
    """What is coupled at the end, and the seconds that it took."""
    with opened(seed, mounts, profile) as (table, read, coupled):
        begin_s = table.now_s()
        with contextlib.suppress(_OutOfTime):
            if method == "sweeps":
                maximise(table, read)
            else:
                {"simplex": simplex, "raster": raster}[method](Stepper(table, read), 2 * mounts)
        return coupled(), table.now_s() - begin_s


def main() -> None:
    """A line for each seed, and the row of the table for each method."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--mounts", type=int, choices=(1, 2), action="append")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--method", choices=("sweeps", "simplex", "raster"), action="append")
    args = parser.parse_args()
    methods = args.method or ("sweeps", "simplex", "raster")
    for mounts, method in itertools.product(args.mounts or (1, 2), methods):
        found = []
        for seed in range(args.first, args.first + args.seeds):
            found.append(one(method, seed, mounts, args.profile))
            print(f"{method}, {2 * mounts} axes, seed {seed}: {found[-1][0]:.3f} in {found[-1][1]:.0f} s", flush=True)
        light, seconds = zip(*found, strict=True)
        good = sum(part >= 0.95 and s <= MOST_S for part, s in found)
        print(
            f"| {method} | {2 * mounts} | {good} of {len(found)} | {np.median(light):.3f} | {min(light):.3f} |"
            f" {np.median(seconds):.0f} | {max(seconds):.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
