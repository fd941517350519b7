"""Errors, refusals and speed of find_spot on rendered scenes (tests/beam/scenes.py), as tables.

usage: spot.py [--scenes 300] [--seed 0]
"""

import argparse
import time
from collections import Counter

import _paths  # noqa: F401
import cv2
import numpy as np
import scenes

from mirrormount_beam.spot.find import NoSpot, find_spot


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="errors, refusals and speed of find_spot")
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0, help="of the first scene; the others follow")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    numbers = range(args.seed, args.seed + args.scenes)
    print(f"least error of a clean scene (Cramer and Rao): {_bound(12.0, 180.0):.4f} px in x, and in y")
    _table("clean, sigma 12 px, peak 180", [scenes.clean(np.random.default_rng(n)) for n in list(numbers)[:200]])
    _table(
        "ghost 10 %, hot pixels, 3 % saturated", (scenes.marred(np.random.default_rng(n)) for n in list(numbers)[:200])
    )
    _table("nasty", (scenes.nasty(np.random.default_rng(n)) for n in numbers))
    each = list(numbers)[: max(1, args.scenes // 5)]
    print(f"real beams, {len(each)} scenes of a kind: |error| of x and of y in px, and in stated errors")
    for kind in scenes.ONE_BEAM + scenes.NO_BEAM:
        _line(kind, (scenes.real(np.random.default_rng(n), kind) for n in each))


def _bound(width, peak, read=1.0, gain=0.1):
    """The least standard error of x that any unbiased estimate can have, if all nine numbers of the spot are unknown.

    Noise as in scenes.expose(): read, shot, rounding. Source: C. R. Rao, Bull. Calcutta Math. Soc. 37 (1945) 81.
    """
    reach = np.arange(-6 * width, 6 * width + 1)
    x, y = (each.ravel() for each in np.meshgrid(reach, reach))
    variance = read**2 + gain * (8 + peak * np.exp(-(x * x + y * y) / (2 * width**2))) + 1 / 12
    light = peak * np.exp(-(x * x + y * y) / (2 * width**2))
    terms = [light / peak, light * x / width**2, light * y / width**2]
    terms += [light * x * x, light * x * y, light * y * y, np.ones_like(x), x, y]
    jacobian = np.stack(terms, axis=1)
    return float(np.linalg.inv((jacobian / variance[:, None]).T @ jacobian)[1, 1]) ** 0.5


def _line(kind, some) -> None:
    answered, errors, pulls, reasons = 0, [], [], Counter()
    for scene in some:
        found = find_spot(scene.image)
        if isinstance(found, NoSpot):
            reasons[found.reason.code] += 1
            continue
        answered += 1
        if scene.truth is not None:
            error = np.array([found.x, found.y]) - scene.truth
            errors.append(np.abs(error))
            pulls.append(np.abs(error / [found.sigma_x, found.sigma_y]))
    words = "" if kind in scenes.ONE_BEAM else " where no one beam is"
    if errors:
        pull = np.array(pulls)
        words = f", median {np.median(errors):.3f}, worst {np.max(errors):.2f} px"
        words += f"; rms {np.sqrt((pull**2).mean()):.1f}, worst {pull.max():.1f}"
    print(f"  {kind}: answered {answered}{words}; refused {dict(reasons.most_common())}")


def _table(name, some) -> None:
    errors, pulls, seconds, reasons, wrong, count = [], [], [], Counter(), [], 0
    for count, scene in enumerate(some, 1):
        begin = time.process_time()
        found = find_spot(scene.image, scene.dark)
        seconds.append(time.process_time() - begin)
        if isinstance(found, NoSpot):
            reasons[found.reason.code] += 1
        elif scene.truth is None:
            wrong.append((count - 1, "spot where none, or no one, is", scene.parts))
        else:
            error = np.array([found.x - scene.truth[0], found.y - scene.truth[1]])
            pull = error / [found.sigma_x, found.sigma_y]
            errors.append(error)
            pulls.append(pull)
            if np.abs(pull).max() > 5:
                wrong.append((count - 1, f"{np.abs(pull).max():.1f} sigma", scene.parts))
    error, pull, ms = np.array(errors), np.array(pulls), 1e3 * np.array(seconds)
    print(f"{name}: {count} scenes")
    print(f"  answered {len(errors)}, refused {sum(reasons.values())}: {dict(reasons.most_common())}")
    off = np.abs(error)
    print(f"  error in px: rms {np.sqrt((off**2).mean()):.4f}, median {np.median(off):.4f}, largest {off.max():.4f}")
    inside = [100 * (np.abs(pull) < k).mean() for k in (2, 3)]
    print(f"  truth within 2 sigma: {inside[0]:.1f} %, within 3: {inside[1]:.2f} %")
    print(f"  ms of processor time: median {np.median(ms):.1f}, 95 % {np.percentile(ms, 95):.1f}")
    print(f"  wrong: {len(wrong)} {wrong[:40]}")


if __name__ == "__main__":
    main()
