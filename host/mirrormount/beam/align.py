"""Brings the beam to its targets: corrections by the response until all spots are near enough. Imports guard."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from mirrormount.beam.choosing import Prices
from mirrormount.beam.driven import QUICKLY
from mirrormount.beam.events import ALIGNING, ENDED, STOPPED, Event, GateClosed, Listen, StateChanged, silent
from mirrormount.beam.gap import Gap
from mirrormount.beam.gates import NO_HELP, Closed
from mirrormount.beam.guard import Guard
from mirrormount.beam.loop_table import LoopTable
from mirrormount.beam.response import Response, check_belongs
from mirrormount.beam.summary import Summary

WITHIN_UM = 15.0  # on every camera, along x and y
MOST_CORRECTIONS = 10
_MOST_CREEPS = 80
_FRAMES = 6  # of a look that decides
# of WITHIN_UM, at which it ends, up to so many corrections; the rest is for the look's noise and the beam's tremble
_AIMS = ((8, 0.6), (math.inf, 0.85))
_HELPED = 0.5  # of the first error: what corrections by a true calibration leave at most
_PRICES, _AT_ANY_PRICE = Prices(pulse_um2=9.0, gap_um2=80.0), Prices(pulse_um2=0.0, gap_um2=0.0)


def align(
    table: LoopTable,
    response: Response,
    gaps: Sequence[Gap] | None = None,
    listen: Listen = silent,
    *,
    within_um: float = WITHIN_UM,
    most: int = MOST_CORRECTIONS,
    cancelled: Callable[[], bool] = lambda: False,
) -> Summary:
    """Align. Motors are off at the end. reached of what is returned tells whether the goal was met.

    A gate that closes ends it: it is in `gates`. Raises ResponseOfOther.
    """
    check_belongs(response, table)
    summary = Summary(table.eyes)

    def told(event: Event) -> None:
        if isinstance(event, GateClosed):
            summary.gates.append(event)
        listen(event)

    guard = Guard(table, response, gaps, told)
    guard.corrector.creep = QUICKLY
    begin_s = table.now_s()
    weight = np.eye(len(response.noise_um))
    told(StateChanged(begin_s, ALIGNING, f"until all spots are within {within_um:g} um of their targets"))
    why, begun_um = "", 0.0
    try:
        while True:
            look = guard.look(_FRAMES)
            summary.add(look.time_s, look.errors_um)
            begun_um = begun_um or look.worst_um
            if look.worst_um <= _aim(guard.corrector.number) * within_um or cancelled():
                break
            if guard.corrector.number >= most or guard.corrector.creeps > _MOST_CREEPS:
                why = f"{guard.corrector.number} corrections were not enough"
                if guard.corrector.number >= MOST_CORRECTIONS and look.worst_um > _HELPED * begun_um:
                    raise Closed(NO_HELP, f"{why}: of {begun_um:.0f} um, {look.worst_um:.0f} um are left")
                break
            prices = _PRICES
            choice = guard.choose(prices, weight)
            if not choice and look.worst_um > within_um:
                prices = _AT_ANY_PRICE
                choice = guard.choose(prices, weight)
            if not choice:
                break
            guard.correct(choice, prices, weight, frames=2)
        summary.reached = summary.last_um is not None and float(np.max(np.abs(summary.last_um))) <= within_um
    except Closed as closed:
        told(closed.event(table.now_s()))
        told(StateChanged(table.now_s(), STOPPED, closed.detail))
        why = closed.detail
    finally:
        guard.motors_off()
        summary.corrections = guard.corrector.number
        summary.actions, summary.reversals = guard.mover.actions, guard.mover.reversals
        summary.motor_s, summary.seconds = guard.mover.motor_s, table.now_s() - begin_s
    told(StateChanged(table.now_s(), ENDED, why))
    return summary


def _aim(corrections: int) -> float:
    """What is near enough after so many: between two corrections the laser drifts, so more of them need not help."""
    return next(aim for most, aim in _AIMS if corrections < most)
