"""How well the loop calibrates, aligns and holds, over seeds: .venv/bin/python tools/bench/hold.py [--virtual]

Each seed is another table, 9 mm off at the begin. Without --virtual: the tests' table without boards and pictures
(tests/beam/fast_table.py), ten minutes of each in some seconds. With --virtual: boards, firmware and pictures. Figures
are of the true beam where the table tells it, else of what the cameras saw. docs/hold.md has a run.
"""

import argparse
import json
import tempfile
from pathlib import Path

import _paths  # noqa: F401
import numpy as np
from fast_table import FastTable

from mirrormount.cli.main import main as command
from mirrormount_beam.control.calibrate import Calibration
from mirrormount_beam.control.events import Estimated
from mirrormount_beam.control.hold import Hold, align

OFF_MM = 9.0
LEVER_M = 1.2


def fast(profile: str, seed: int, seconds: float) -> dict[str, float]:
    """One seed on the fast table."""
    table = FastTable(profile, seed, OFF_MM)
    measuring = Calibration(table)
    response = measuring.run()
    promise = response.promise
    assert promise and promise.urad
    calibrated_s = table.now_s()
    aligned = align(table, response, measuring.gaps)
    left_um = float(np.abs(table.truth_um()).max())
    hold = Hold(table, response, measuring.gaps)
    rows: list[tuple[float, ...]] = []
    add = hold.summary.add

    def both(time_s: float, errors_um: np.ndarray) -> Estimated:
        rows.append((time_s, *table.truth_um()))
        return add(time_s, errors_um)

    hold.summary.add = both
    summary = hold.run(seconds)
    found = np.array(rows)
    dt = np.diff(found[:, 0])[:, None]
    angles = (found[:-1, 3:5] - found[:-1, 1:3]) / LEVER_M
    return {
        "calibrate_s": calibrated_s,
        "corrections": aligned.corrections,
        "aligned_um": left_um,
        "promised_urad": promise.urad,
        "times": summary.held.rms.times(promise),
        "rms_urad": float(np.sqrt((angles**2 * dt).sum(axis=0) / dt.sum()).max()),
        "max_um": float(np.abs(found[:, 1:]).max()),
        "reversals": summary.reversals,
        "interlocks": len(summary.interlocks),
    }


def virtual(profile: str, seed: int, seconds: float) -> dict[str, float]:
    """One seed by the command."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "hold.json"
        options = ["--profile", profile, "--seed", str(seed), "--duration", str(seconds), "--json", str(file)]
        command(["hold", "--virtual", "--off", str(OFF_MM), *options])
        found = json.loads(file.read_text())
    names = ("rms_urad", "max_um", "reversals")
    return {name: float(found[name]) for name in names} | {"interlocks": float(len(found["interlocks"]))}


def main() -> None:
    """All seeds, and the worst of each figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--virtual", action="store_true")
    parser.add_argument("--profile", choices=("smooth", "rough", "hardware"), action="append")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--duration", type=float, default=600.0)
    args = parser.parse_args()
    for profile in args.profile or ("smooth", "rough"):
        found = []
        for seed in range(args.first, args.first + args.seeds):
            found.append((virtual if args.virtual else fast)(profile, seed, args.duration))
            print(profile, seed, " ".join(f"{name} {value:.1f}" for name, value in found[-1].items()), flush=True)
        for name in found[0]:
            values = [each[name] for each in found]
            worst = int(np.argmax(values)) + args.first
            print(
                f"{profile}: {name}: median {np.median(values):.1f}, worst {max(values):.1f} (seed {worst})", flush=True
            )


if __name__ == "__main__":
    main()
