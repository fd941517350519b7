"""The step of `mirrormount setup` for an axis with an encoder: which way it counts, and how many counts a step has.

Changes settings on the board and saves nothing, as the other steps.
"""

from mirrormount.cli.dialogue import Dialogue
from mirrormount.common.errors import EncoderFault, SetupEnded
from mirrormount.device.mount import Axis, Mount


def open_loops(mount: Mount) -> None:
    """Steps are timed until the encoders are measured: one whose wires have changed would end them."""
    mount.apply({axis.name: {"closed_loop": 0} for axis in mount.axes if axis.has_encoder})


def encoder(mount: Mount, axis: Axis, talk: Dialogue) -> None:
    """Measure the counts of a step, and ask whether the loop is to be closed; nothing where no encoder is fitted."""
    if not axis.has_encoder:
        return
    talk.say(f"{axis.name}: thirteen steps and back, to see what its encoder counts …")
    while True:
        try:
            found = axis.measure_counts()
            break
        except EncoderFault as e:
            talk.say(f"  {e}: look at its plug and its wires")
            what = talk.choice("Measure again, go on without it (timed steps), or end?", ("again", "without", "end"))
            if what == "without":
                return
            if what == "end":
                raise SetupEnded(f"the encoder of {axis.name} does not count") from e
    way = "up" if found.per_step > 0 else "down"
    talk.say(
        f"  it counts {way} as the motor turns its positive way: {abs(found.positive):.0f} a step,"
        f" {abs(found.negative):.0f} back"
    )
    talk.say("  whether it loses counts: `mirrormount check --move`, once the position is defined (1DH0;2DH0)")
    closed = talk.yes(f"Close the loop, so that a step of {axis.name} is {abs(found.per_step)} counts from now on?")
    mount.apply({axis.name: found.settings | {"closed_loop": int(closed)}})


def measured(axis: Axis) -> list[str]:
    """A line for the summary, where there is an encoder."""
    if not axis.has_encoder:
        return []
    per_step, closed = axis.ask_whole("XN?", "MM?")
    counts = f"{per_step} counts a step" if per_step else "not measured"
    return [f"{axis.name}: encoder, {counts}, {'closed' if closed else 'open'} loop"]
