"""How often the truth lies within two standard errors of what `mirrormount measure` finds through rendered pictures.

usage: experiments.py [EXPERIMENT ...] [--seeds 20] [--first 0] [--profile smooth] [--profile rough]
                      [--minutes M] [--json FILE]

Each run is a new virtual table: firmware, pins, mechanics, a laser that drifts, pictures of a camera, the spot in them.
`tests/beam/test_experiments.py` judges many more mounts, without board and pictures. FILE gets a line for each run as
it ends; runs that it has are not made again. After --minutes no further run begins. The table at the end, or after
Ctrl-C, is of all runs of FILE.
"""

import argparse
import contextlib
import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise
from pathlib import Path

import _paths  # noqa: F401
import numpy as np

from mirrormount.device.mount import Mount
from mirrormount.transport.link import Link
from mirrormount_beam.estimates import Result
from mirrormount_beam.experiments import backlash, drift, square, steps
from mirrormount_beam.experiments.rig import MountRig, Vector
from mirrormount_beam.experiments.steps import AT_REST
from mirrormount_beam.observe import FRAMES, Sighting, SpotObserver
from mirrormount_sim.bench import LEVER_X_MM, LEVER_Y_MM
from mirrormount_sim.mechanics import Drivetrain
from mirrormount_sim.optics import DEFAULT, BeamPath
from mirrormount_sim.profiles import GAP_REV, PROFILES, Profile
from mirrormount_sim.table import LASER_DRIFT_URAD, MOUNT_DRIFT_URAD, Kind, VirtualTable

STEP_US = 200_000
DRIFT_MIN = 20
WAYS = (("positive", 1), ("negative", -1))
_COAST_S = 0.1  # more than a motor needs to come to rest
_SMALL_RAD = 1e-4

Truths = dict[str, float]


# ---- what is true


@cache
def steps_rad(profile: Profile, axis: str, us: int, count: int = 4000) -> tuple[float, float, float]:
    """A pulse of so many us, by the mechanics alone over many turns of the screw.

    Mean way of the mirror in rad, standard deviation in parts of it (of a straight screw), mean turn of the screw.
    """
    ways = []
    for each in (profile, replace(profile, periodic=0.0)):
        noise = np.random.default_rng(1)
        train = Drivetrain.new(LEVER_X_MM if axis == "x" else LEVER_Y_MM, each, noise)
        train.travel_rev = math.inf
        places, turns = [], []
        for k in range(count + 20):  # the first 20 take up the backlash, and the creep becomes steady
            train.begin(math.copysign(1.0, us), noise)
            train.advance(abs(us) * 1e-6, math.copysign(1.0, us))
            train.advance(_COAST_S, None)
            if k >= 19:
                places.append(train.mirror_rad)
                turns.append(train.screw_rev)
        ways.append((np.abs(np.diff(places)), abs(turns[-1] - turns[0]) / count))
    (bent, turn), (straight, _) = ways
    scatter = float(straight.std() / straight.mean()) if straight.any() else math.inf  # a pulse that never moves
    return float(bent.mean()), scatter, float(turn)


def lost_steps(profile: Profile, axis: str, way: int, gap_rev: float = GAP_REV) -> float:
    """How many steps in direction way a gap takes."""
    return gap_rev / steps_rad(profile, axis, way * STEP_US)[2]


class Watched(MountRig):
    """A mount in front of a camera of a virtual table; what the mirrors have made of each look and of each turn."""

    def __init__(self, table: VirtualTable, mount: Mount) -> None:
        super().__init__(mount, SpotObserver(table.cameras[0]))
        self.table = table
        self.bench = table.simulations[0].bench
        self.seen: list[tuple[float, Vector]] = []  # of each look: when, and where the spot is without drift and noise
        # by axis and direction: the places of single steps in a row, the first one before them; the gap after each
        self.rows: list[tuple[tuple[str, int], list[Vector]]] = []
        self.gaps_rev: dict[tuple[str, int], list[float]] = {}
        self._last: tuple[str, int] | None = None
        self._stepped = False  # since the last look
        self._path = BeamPath(1, DEFAULT)

    def observe(self, frames: int = FRAMES) -> Sighting:
        sighting = super().observe(frames)
        self.seen.append((sighting.time_s, self.place(*self.bench.mirrors_rad()[0])))
        if self._stepped:
            self.rows[-1][1].append(self.seen[-1][1])
            self._stepped = False
        return sighting

    def step(self, axis: str, n: int) -> None:
        super().step(axis, n)
        if abs(n) == 1:
            train = self.bench.horizontal if axis == "x" else self.bench.vertical
            gap_rev = train.gap_rev / 2 * (train.ahead + train.behind)
            self.gaps_rev.setdefault((axis, n), []).append(gap_rev)
            if self._last != (axis, n):
                self.rows.append(((axis, n), [self.seen[-1][1]]))
        self._last = axis, n
        self._stepped = abs(n) == 1

    def place(self, yaw: float, pitch: float) -> Vector:
        """Where the spot of an undisturbed laser is in the picture, px."""
        (spot, *_) = self._path.spots((0.0, 0.0), (0.0, 0.0), [(yaw, pitch)])
        assert spot
        return np.array(self.table.cameras[0].truth_px(spot))

    def way(self, axis: str) -> Vector:
        """px in the picture for 1 rad of the mirror."""
        small = np.array([_SMALL_RAD, 0.0] if axis == "x" else [0.0, _SMALL_RAD])
        return (self.place(*small) - self.place(*-small)) / (2 * _SMALL_RAD)


def _of_steps(rig: Watched, profile: Profile, _result: Result) -> Truths:
    """The angle of x is the camera's rotation. That of y is of the very run, since its way is bent (a cone)."""
    truths: Truths = {}
    for axis in rig.axes:
        way = rig.way(axis)
        for name, sign in WAYS:
            mean, scatter, _ = steps_rad(profile, axis, sign * STEP_US)
            truths[f"{axis}.{name}.step"] = mean * float(np.linalg.norm(way))
            truths[f"{axis}.{name}.scatter"] = 100 * scatter
        truths[f"{axis}.negative_over_positive"] = truths[f"{axis}.negative.step"] / truths[f"{axis}.positive.step"]
    longest = dict(sorted(rig.rows, key=lambda row: len(row[1])))
    chords = {key: places[-1] - places[0] for key, places in longest.items()}
    y = chords["y", 1] / np.linalg.norm(chords["y", 1]) - chords["y", -1] / np.linalg.norm(chords["y", -1])
    truths["x.angle_in_picture"] = _angle_mrad(rig.way("x"))
    truths["y.angle_in_picture"] = _angle_mrad(y)
    truths["cross_talk"] = truths["y.angle_in_picture"] - truths["x.angle_in_picture"] - math.pi / 2 * 1e3
    return truths


def _angle_mrad(way: Vector) -> float:
    """From the picture's x towards its top."""
    return math.atan2(-way[1], way[0]) * 1e3


def _of_backlash(rig: Watched, profile: Profile, _result: Result) -> Truths:
    truths: Truths = {}
    for axis in rig.axes:
        lost = [lost_steps(profile, axis, sign) for _, sign in WAYS]
        truths |= {f"{axis}.to_{name}": steps for (name, _), steps in zip(WAYS, lost, strict=True)}
        truths[f"{axis}.backlash"] = float(np.mean(lost))
    return truths


def _of_pulses(rig: Watched, profile: Profile, _result: Result) -> Truths:
    return {
        f"{axis}.{name}.pulse_{ms:g}ms": steps_rad(profile, axis, sign * ms * 1000)[0]
        * float(np.linalg.norm(rig.way(axis)))
        for axis in rig.axes
        for name, sign in WAYS
        for ms in backlash.LENGTHS_MS
    }


def _of_square(rig: Watched, profile: Profile, result: Result) -> Truths:
    """What the mirrors have made of the very same squares, without the beam's drift; the gap of that very turn."""
    corners = []
    for series in result.series:
        x, y, _ = series.points[0]
        at = [row[1:3] for row in result.readings].index((x, y))
        corners.append([place for _, place in rig.seen[at : at + len(series.points) : (len(series.points) - 1) // 4]])
    first = corners[0]
    sides = ("x.side_right", "y.side_down", "x.side_left", "y.side_up")
    truths = {side: float(np.linalg.norm(b - a)) for side, (a, b) in zip(sides, pairwise(first), strict=True)}
    ways = np.column_stack([first[1] - first[0], first[1] - first[2]])
    ways /= np.linalg.norm(ways, axis=0)
    for some, what in zip(corners, ("open", "open_with_take_up"), strict=True):
        x, y = np.linalg.solve(ways, some[-1] - some[0])
        truths |= {f"x.{what}": float(x), f"y.{what}": float(y)}
    for axis, back in (("x", -1), ("y", 1)):
        if f"{axis}.take_up" in result.estimates:
            gap_rev = rig.gaps_rev[axis, back][0]
            truths[f"{axis}.take_up"] = lost_steps(profile, axis, back, gap_rev) * STEP_US
    return truths


def _of_settle(rig: Watched, _profile: Profile, result: Result) -> Truths:
    truths: Truths = {}
    begin = AT_REST
    runs = [f"{axis}.{name}" for axis in rig.axes for name, _ in WAYS]
    for series, run in zip(result.series, runs, strict=True):
        before, *after = rig.seen[begin : begin + 1 + len(series.points)]
        begin += 1 + len(series.points)
        line = (after[0][1] - before[1]) / np.linalg.norm(after[0][1] - before[1])
        late = [place @ line for s, place in after if s - after[0][0] >= 0.7 * (after[-1][0] - after[0][0])]
        truths[f"{run}.creep"] = float(np.mean(late) - after[0][1] @ line)
    return truths


def _of_drift(rig: Watched, _profile: Profile, _result: Result) -> Truths:
    camera_m, px_per_um = DEFAULT.cameras_m[0], 1e-3 / rig.table.cameras[0].sensor.pixel_mm
    laser_um = LASER_DRIFT_URAD * (DEFAULT.laser_m + camera_m)
    turns = {"x": 2.0, "y": math.sqrt(2)}  # of the beam, for a turn of the mirror
    return {
        f"{axis}.walk": px_per_um * math.hypot(laser_um, turn * MOUNT_DRIFT_URAD * camera_m)
        for axis, turn in turns.items()
    }


# ---- the runs


@dataclass(frozen=True)
class Experiment:
    """run: as `mirrormount measure` runs it. truths: of a run that has ended. straight: with a straight screw."""

    run: Callable[..., None]
    truths: Callable[[Watched, Profile, Result], Truths]
    straight: bool = False


EXPERIMENTS = {
    "steps": Experiment(steps.run, _of_steps),
    "backlash": Experiment(backlash.run, _of_backlash),
    "square": Experiment(square.run, _of_square),
    # all pulses are at one place, where a screw that is not straight makes them larger or smaller; `measure` says so
    "pulses": Experiment(backlash.run_pulses, _of_pulses, straight=True),
    "settle": Experiment(drift.settle, _of_settle),
    "drift": Experiment(partial(drift.drift, seconds=60.0 * DRIFT_MIN), _of_drift),
}


@dataclass(frozen=True)
class Run:
    """One measurement: (value, standard error, truth) of each quantity, and the processor time it took."""

    experiment: str
    profile: str
    seed: int
    found: dict[str, tuple[float, float, float]]
    seconds: float


def run_one(name: str, profile_name: str, seed: int) -> Run:
    """Measure one mount, with everything that `mirrormount measure --virtual --seed SEED` has but the report."""
    experiment, profile = EXPERIMENTS[name], PROFILES[profile_name]
    if experiment.straight:
        profile = replace(profile, periodic=0.0)
    begun_s = time.process_time()
    table = VirtualTable(Kind(mounts=1, profile=profile, seed=seed))
    with table, Mount(Link(table.ports[0])) as mount:
        rig, result = Watched(table, mount), Result(name)
        experiment.run(rig, result, lambda _done, _phase: None)
        truths = experiment.truths(rig, profile, result)
    found = {
        quantity: (result.estimates[quantity].value, result.estimates[quantity].error, truth)
        for quantity, truth in truths.items()
    }
    return Run(name, profile_name, seed, found, time.process_time() - begun_s)


# ---- the table


@dataclass(frozen=True)
class Share:
    """Of n estimates: of how many the truth is within two standard errors. off: (value - truth) / error, mean and
    standard deviation."""

    n: int
    inside: int
    off: float
    spread: float

    def __str__(self) -> str:
        sigma = math.sqrt(max(self.inside, 1) * max(self.n - self.inside, 1) / self.n**3)
        percent = f"{100 * self.inside / self.n:5.1f} ± {100 * sigma:.1f} % of {self.n:5d}"
        return f"{percent}   off by {self.off:+.2f} ± {self.spread:.2f} standard errors"


def _kind(quantity: str) -> str:
    """What is put together: both axes, and the four sides of a square."""
    if quantity == "y.angle_in_picture":
        return quantity  # another truth than that of x
    rest = quantity.split(".", 1)[-1]
    return "side" if rest.startswith("side_") else rest


def shares(runs: list[Run]) -> dict[str, Share]:
    """By kind of quantity."""
    kinds: dict[str, list[tuple[float, float, float]]] = {}
    for run in runs:
        for quantity, row in run.found.items():
            kinds.setdefault(_kind(quantity), []).append(row)
    found = {}
    for kind, rows in kinds.items():
        value, error, truth = np.array(rows).T
        pulls = (value - truth) / error
        inside = int(np.count_nonzero(np.abs(pulls) < 2))
        found[kind] = Share(len(rows), inside, float(pulls.mean()), float(pulls.std()))
    return found


def show(runs: list[Run]) -> None:
    """Print a table for each experiment and profile."""
    for name in EXPERIMENTS:
        for profile in PROFILES:
            some = [run for run in runs if (run.experiment, run.profile) == (name, profile)]
            if not some:
                continue
            seeds = f"{min(run.seed for run in some)} to {max(run.seed for run in some)}"
            cost_s = float(np.mean([run.seconds for run in some]))
            print(f"{name}, {profile}: {len(some)} mounts, seeds {seeds}, {cost_s:.1f} s of processor time each")
            for kind, share in shares(some).items():
                print(f"  {kind:26} {share}")


def kept_runs(path: Path | None) -> list[Run]:
    """The runs of a file; none without one."""
    if path is None or not path.exists():
        return []
    with path.open(encoding="utf-8") as lines:
        return [Run(**json.loads(line)) for line in lines]


@contextlib.contextmanager
def _until_ctrl_c() -> Iterator[None]:
    with contextlib.suppress(KeyboardInterrupt):
        yield


def main() -> None:
    """Make the runs, and print the tables."""
    parser = argparse.ArgumentParser(description="are the error bars of `mirrormount measure` right, with pictures?")
    parser.add_argument("experiments", nargs="*", metavar="EXPERIMENT", help=", ".join(EXPERIMENTS) + " (all)")
    parser.add_argument("--seeds", type=int, default=20, help="mounts of each profile (20)")
    parser.add_argument("--first", type=int, default=0, help="the first seed; the others follow (0)")
    parser.add_argument("--profile", action="append", choices=tuple(PROFILES), help="only this one")
    parser.add_argument("--minutes", type=float, default=math.inf, help="after so many no further run begins")
    parser.add_argument("--json", type=Path, metavar="FILE", help="a line for each run; those it has are kept")
    args = parser.parse_args()
    if unknown := set(args.experiments) - set(EXPERIMENTS):
        parser.error(f"no experiment {', '.join(sorted(unknown))}: {', '.join(EXPERIMENTS)}")
    runs, end_s = kept_runs(args.json), time.monotonic() + 60 * args.minutes
    made = {(run.experiment, run.profile, run.seed) for run in runs}
    wanted = [
        (name, profile, seed)
        for name in args.experiments or EXPERIMENTS
        for seed in range(args.first, args.first + args.seeds)
        for profile in args.profile or PROFILES
    ]
    with _until_ctrl_c():
        for each in wanted:
            if each in made or time.monotonic() > end_s:
                continue
            runs.append(run_one(*each))
            if args.json:
                with args.json.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(vars(runs[-1])) + "\n")
    show(runs)


if __name__ == "__main__":
    main()
