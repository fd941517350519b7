"""The part of `mirrormount check` about an encoder: it answers, it counts, the right way, and loses nothing."""

from mirrormount.cli.outcomes import NotTested, Wrong
from mirrormount.common.errors import EncoderFault, MoveEnded
from mirrormount.device.encoder import counts_between
from mirrormount.device.mount import Axis

_STEPS = 4  # counted each way, after three that take up the play
_LOOKS = 3  # without an answer a board calls the encoder lost
_MEASURED = "measured"  # what a board calls a position that no lost count has made an estimate
_DIFFERENT = 0.35  # of the counts of a step, when a step is timed: supply and load change that much


def at_rest(axis: Axis) -> str:
    """The encoder answers."""
    per_step, closed = axis.ask_whole("XN?", "MM?")
    try:
        counts = [axis.counts for _ in range(_LOOKS)][-1]
    except EncoderFault as e:
        raise Wrong(
            f"{e}: its plug, its supply, SDA and SCL, the distance of the magnet;"
            f" 'mirrormount config set {axis.name}.closed_loop 0' goes on without it"
        ) from e
    what = f"stands at {counts} counts"
    if not per_step:
        raise NotTested(f"{what}; how many a step has is not known (mirrormount setup measures it)")
    return f"{what}, {abs(per_step)} a step, {'closed' if closed else 'open'} loop"


def in_a_move(axis: Axis) -> str:
    """It turns with the motor, in the direction and by the counts that setup has found, and none gets lost."""
    lost, ended = "", None
    try:
        lost = _none_lost(axis)  # at first: timed steps are no measured ones
    except MoveEnded as e:
        ended = e  # what the encoder counts says more
    try:
        found = axis.measure_counts(_STEPS)
    except EncoderFault as e:
        raise Wrong(f"{e}: does the motor turn? If so, its plug, supply and wires, then mirrormount setup") from e
    per_step = axis.counts_per_step
    counted = f"{found.positive:.0f} counts a step, {found.negative:.0f} back"
    if not per_step:
        raise NotTested(f"{counted}; they are not set (mirrormount setup measures them)")
    if per_step * found.per_step < 0:
        raise Wrong(f"{counted}, the other way than counts_per_step ({per_step}): A and B, or the motor's leads")
    if abs(found.per_step - per_step) > _DIFFERENT * abs(per_step):
        raise Wrong(f"{counted} where counts_per_step is {per_step}: supply, a slipping disc, or mirrormount setup")
    if ended:
        raise Wrong(f"{counted}, but in the closed loop: {ended}; docs/errors.md has the causes") from ended
    return _kept(axis, counted + lost)


def _none_lost(axis: Axis) -> str:
    """A board says that counts were lost by taking back what a measured position is worth; any other it does not."""
    if axis.status().certainty != _MEASURED:
        return f", lost counts not looked for (that needs the closed loop and a measured position: {axis.number}DH0)"
    axis.step(_STEPS)
    axis.step(-_STEPS)
    if axis.status().certainty != _MEASURED:
        raise Wrong("counts were lost on the way: motor wires beside those of the encoder, or a bad plug")
    return ", none lost"


def _kept(axis: Axis, counted: str) -> str:
    """At rest nothing is counted."""
    before = axis.counts
    for _ in range(20):
        if abs(counts_between(before, axis.counts)) > 2:
            raise Wrong(f"{counted}, but it goes on counting at rest: noise on its wires")
    return f"{counted}, and none at rest"
