"""Which actuators correct an error, and by how much: the ones whose moves save more than they cost. Pure; numpy.

Every set of actuators is tried. A set's steps are the damped least squares (A. N. Tikhonov, 1963); the sum of squares
that is left, and a price for each pulse and for each gap that has to be crossed, are its cost. So an error within the
noise is not corrected (the dead band), a reversal is made only where it pays (the hysteresis), and a mount that
corrects an error nearly does so alone.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mirrormount.beam.gap import Gap
from mirrormount.beam.response import Response

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

TIKHONOV = 0.03  # of the largest singular value
MOST_STEPS = 15.0  # of one actuator in one correction
LEAST_STEPS = 0.003  # a smaller wish is none


@dataclass(frozen=True)
class Prices:
    """What a move must save at least, in um² of the sum of squares: a pulse, and crossing a whole gap."""

    pulse_um2: float
    gap_um2: float


@dataclass(frozen=True, eq=False)
class Choice:
    """Steps of the screws for each actuator (0: it rests), and the errors that are left by them, um."""

    steps: Vector
    left_um: Vector

    def __bool__(self) -> bool:
        """True if something is to be moved."""
        return bool(np.any(self.steps))


def choose(
    errors_um: Vector,
    response: Response,
    gaps: Sequence[Gap],
    prices: Prices,
    weight: Matrix,
    *,
    among: Sequence[int] | None = None,
    contact_only: bool = False,
) -> Choice:
    """The best correction. weight: of the sum of squares, (errors, errors).

    among: actuators that may move (default: all). contact_only: none that would have to cross its gap.
    """
    allowed = range(response.actuators) if among is None else among
    n = response.actuators
    best, least = np.zeros(n), float(errors_um @ weight @ errors_um)
    top = float(np.linalg.norm(response.matrices[1], 2))
    damping = (TIKHONOV * top) ** 2
    for size in range(1, len(allowed) + 1):
        for chosen in itertools.combinations(allowed, size):
            steps = _least_squares(errors_um, response, chosen, damping, weight)
            if np.any(np.abs(steps[list(chosen)]) < LEAST_STEPS):
                continue
            if contact_only and not all(gaps[i].in_contact(1 if steps[i] > 0 else -1) for i in chosen):
                continue
            left = errors_um + response.effect(steps)
            cost = float(left @ weight @ left) + _price(steps, chosen, gaps, prices)
            if cost < least:
                best, least = steps, cost
    return Choice(best, errors_um + response.effect(best))


def needed_steps(errors_um: Vector, response: Response) -> Vector:
    """The steps of all actuators that an error needs, undamped and not bounded."""
    return np.asarray(np.linalg.lstsq(response.matrices[1], -errors_um, rcond=None)[0], dtype=np.float64)


def _price(steps: Vector, chosen: Sequence[int], gaps: Sequence[Gap], prices: Prices) -> float:
    price = 0.0
    for i in chosen:
        way = 1 if steps[i] > 0 else -1
        gap = gaps[i]
        price += prices.pulse_um2 + prices.gap_um2 * min(1.0, gap.slack(way)[0] / max(gap.widths[way].mean, 1e-6))
    return price


def _least_squares(
    errors_um: Vector, response: Response, chosen: Sequence[int], damping: float, weight: Matrix
) -> Vector:
    """Damped steps of the chosen actuators; the columns are those of the ways that come out."""
    steps = np.zeros(response.actuators)
    picked = list(chosen)
    signs = np.ones(response.actuators)
    for _ in range(3):
        columns = response.columns(signs)[:, picked]
        left = columns.T @ weight @ columns + damping * np.eye(len(picked))
        steps[picked] = np.linalg.solve(left, -columns.T @ weight @ errors_um)
        if np.array_equal(np.sign(steps[picked]), signs[picked]):
            break
        signs[picked] = np.where(steps[picked] < 0, -1.0, 1.0)
    largest = float(np.max(np.abs(steps)))
    return steps * min(1.0, MOST_STEPS / largest) if largest and math.isfinite(largest) else np.zeros_like(steps)
