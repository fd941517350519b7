"""The part of `mirrormount check` about an encoder: it answers, it counts, the right way, and loses nothing."""

from mirrormount.cli.outcomes import NotTested, Wrong
from mirrormount.common.errors import EncoderFault
from mirrormount.device.encoder import counts_between
from mirrormount.device.mount import Axis

_STEPS = 4  # counted each way, after three that take up the play
_LOST = "estimated"  # what a board calls a position when counts have been lost
_DIFFERENT = 0.35  # of the counts of a step, when a step is timed: supply and load change that much


def at_rest(axis: Axis) -> str:
    """The encoder answers."""
    per_step, closed = axis.ask_whole("XN?", "MM?")
    what = f"stands at {axis.counts} counts"
    if not per_step:
        raise NotTested(f"{what}; how many a step has is not known (mirrormount setup measures it)")
    return f"{what}, {abs(per_step)} a step, {'closed' if closed else 'open'} loop"


def in_a_move(axis: Axis) -> str:
    """It turns with the motor, in the direction and by the counts that setup has found, and none gets lost."""
    before = axis.status().certainty
    try:
        found = axis.measure_counts(_STEPS)
    except EncoderFault as e:
        raise Wrong(f"{e}: its plug, supply and wires, then mirrormount setup") from e
    if axis.status().certainty == _LOST != before:
        raise Wrong("counts were lost on the way: motor wires beside those of the encoder, or a bad plug")
    per_step = axis.counts_per_step
    counted = f"{found.positive:.0f} counts a step, {found.negative:.0f} back"
    if not per_step:
        raise NotTested(f"{counted}; they are not set (mirrormount setup measures them)")
    if per_step * found.per_step < 0:
        raise Wrong(f"{counted}, the other way than counts_per_step ({per_step}): A and B, or the motor's leads")
    if abs(found.per_step - per_step) > _DIFFERENT * abs(per_step):
        raise Wrong(f"{counted} where counts_per_step is {per_step}: supply, a slipping disc, or mirrormount setup")
    return _kept(axis, counted)


def _kept(axis: Axis, counted: str) -> str:
    """At rest nothing is counted."""
    before = axis.counts
    for _ in range(20):
        if abs(counts_between(before, axis.counts)) > 2:
            raise Wrong(f"{counted}, but it goes on counting at rest: noise on its wires")
    return f"{counted}, and none at rest"
