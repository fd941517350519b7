"""The steps of `mirrormount setup` for one axis: direction, end-stop switches, scale and backlash.

Each function changes settings on the board and saves nothing. setup_course.py saves them at the end, or restores
the old ones.
"""

from dataclasses import dataclass

from mirrormount.cli.dialogue import Dialogue
from mirrormount.common.errors import SettingRefused, SetupEnded
from mirrormount.device.calibration import Scale, Step
from mirrormount.device.mount import Axis, Mount
from mirrormount.device.scale_fit import Marks, Measured, beam_per_mirror, measure, take_up

_TRIES = (5, 10, 20)  # steps: the first few may vanish in the backlash
_USUAL_MRAD = (0.01, 2.0)  # of the mirror a step; the paper's mount: 0.2
_ALIKE = 0.25  # relative difference of the two directions that needs no question


@dataclass(frozen=True)
class Ways:
    """The words for an axis's positive and negative direction.

    like: "x" or "y", the axis whose geometry this one has; "": it turns no mirror, so it has no scale.
    """

    positive: str
    negative: str
    like: str

    def of(self, n: int) -> str:
        """The direction of n steps."""
        return self.positive if n > 0 else self.negative

    def of_end_stop(self, bit: int) -> str:
        """The side of the end-stop with that bit (1 positive, 2 negative)."""
        return self.positive if bit == 1 else self.negative


_WAYS = {
    "sideways": Ways("right", "left", "x"),
    "vertically": Ways("up", "down", "y"),
    "neither": Ways("forward", "backward", ""),
}


def ways(axis: Axis, talk: Dialogue) -> Ways:
    """The words for the directions of an axis; asks for those of a third and further axis."""
    known = {"x": "sideways", "y": "vertically"}.get(axis.name)
    return _WAYS[known or talk.choice(f"How does {axis.name} move the spot?", tuple(_WAYS))]


def direction(mount: Mount, axis: Axis, way: Ways, talk: Dialogue) -> None:
    """Find the direction of positive steps, and invert the axis if it is the wrong one.

    Raises SetupEnded if nothing moves, or the motors of x and y are exchanged.
    """
    either = ("right", "left", "up", "down") if axis.name in ("x", "y") else (way.positive, way.negative)
    thing = "the spot" if way.like else axis.name
    tries = list(_TRIES)
    while True:
        _step(mount, axis, way, tries[0], talk)
        answer = talk.choice(f"Which way did {thing} go?", (*either, "nothing", "again"))
        if answer == way.positive:
            return
        if answer == way.negative:
            mount.apply({axis.name: {"inverted": 1 - axis.ask_whole("XI?")[0]}})
            talk.say(f"  {axis.name} is inverted now; once more, to see it.")
        elif answer == "nothing":
            tries.pop(0)
            if not tries:
                nothing = "does not move the spot" if way.like else "does not move"
                raise SetupEnded(f"{axis.name} {nothing}: look at motor supply, plug and coupler")
            talk.say("  The backlash may have taken all of it; now more steps.")
        elif answer != "again":
            raise SetupEnded(
                f"{axis.name} moves the spot {answer}: the motors are exchanged; exchange their plugs"
                " (or say x_axis=1 in Python) and run setup again"
            )


def switches(mount: Mount, axis: Axis, way: Ways, talk: Dialogue) -> None:
    """Ask for the end-stops that are fitted, and test each of them."""
    positive, negative = way.positive, way.negative
    fitted_at = talk.choice(
        f"End-stop switches on {axis.name}: on both sides, on the {positive} or {negative} side only, or none?",
        ("both", positive, negative, "none"),
    )
    fitted = {"both": 3, positive: 1, negative: 2, "none": 0}[fitted_at]
    try:
        _fit(mount, axis, fitted)
    except SettingRefused as e:
        talk.say(f"  {e}: going on without switches")
        fitted = 0
    if fitted and not _all_released(axis, way, talk):
        fitted = 0
    for bit in (1, 2):
        if fitted & bit and not _press_is_seen(axis, bit, way.of_end_stop(bit), talk):
            fitted &= ~bit
    _fit(mount, axis, fitted)


def scale(
    mount: Mount, axis: Axis, way: Ways, talk: Dialogue, distance_mm: float, incidence_deg: float, n: int
) -> tuple[Scale, str]:
    """Measure the scale of both directions and the backlash. Returns the scale, and the take-up in words."""
    mount.apply({axis.name: {"take_up_us": 0}})  # it would hide the backlash
    factor = beam_per_mirror(way.like, incidence_deg)
    while True:
        found = measure(_marks(mount, axis, way, talk, n), n, distance_mm, factor)
        if found is None:
            talk.say(f"  These readings contradict the steps: they must grow to the {way.positive}. Again.")
        elif max(found.lost) > _approach(n):
            n *= 2
            talk.say(f"  The backlash is too large for so few steps. Again, with {n}.")
        elif _plausible(found, axis, way, talk, distance_mm):
            break
    pulse_us, step_duty, inverted = axis.ask_whole("XP?", "XD?", "XI?")
    take_up_us, beyond = take_up(found.backlash * pulse_us)
    mount.apply({axis.name: {"take_up_us": take_up_us}})
    step = Step(pulse_us, step_duty, inverted)
    positive, negative, beam = (float(f"{n:.4g}") for n in (found.positive, found.negative, factor))
    return Scale(positive, negative, step, beam, distance_mm), f"{take_up_us} us" + (f" ({beyond})" if beyond else "")


def _step(mount: Mount, axis: Axis, way: Ways, n: int, talk: Dialogue) -> None:
    talk.say(f"{axis.name}: {abs(n)} steps {way.of(n)} …")
    axis.step(n)
    simulation = getattr(mount.link.port, "simulation", None)
    if simulation:  # a virtual board in this process has no visible screen
        right, up = simulation.bench.spot_mm()
        talk.say(f"  (virtual screen: the spot is at {right:.1f} mm right, {up:.1f} mm up)")


def _fit(mount: Mount, axis: Axis, own: int) -> None:
    """XL counts the inputs of the board; they keep their direction when the axis is inverted."""
    inverted = axis.ask_whole("XI?")[0]
    mount.apply({axis.name: {"switches": (own & 1) << 1 | own >> 1 if inverted else own}})


def _active(axis: Axis) -> int:
    return axis.status().limits & 3


def _all_released(axis: Axis, way: Ways, talk: Dialogue) -> bool:
    while active := _active(axis):
        ends = " and ".join(way.of_end_stop(bit) for bit in (1, 2) if active & bit)
        talk.say(f"  The switch on this side shows as pressed: {ends}. A switch opens when it is pressed;")
        talk.say("  a broken wire, or a mount at its end, looks the same.")
        if not talk.enter("Look again?", "none"):
            return False
    return True


def _press_is_seen(axis: Axis, bit: int, side: str, talk: Dialogue) -> bool:
    """Wait for a press of this switch. False if it is skipped."""
    while True:
        if not talk.enter(f"Press the {side} switch of {axis.name}, hold it, and press Enter.", "skip"):
            return False
        active = _active(axis)
        if active == bit:
            talk.say("  seen")
            return True
        if active == 3 - bit:
            talk.say("  That shows as the switch of the other side: exchange the two switches' wires.")
        else:
            talk.say("  Nothing seen." if not active else "  Both sides show as pressed.")


def _approach(n: int) -> int:
    """Steps that bring the gears to one side of the backlash before the first mark."""
    return max(5, n // 2)


def _marks(mount: Mount, axis: Axis, way: Ways, talk: Dialogue, n: int) -> Marks:
    _step(mount, axis, way, -_approach(n), talk)  # and back, so that all of it stays within n steps of here
    readings = []
    for steps in (_approach(n), n, -n, -n, n):
        _step(mount, axis, way, steps, talk)
        question = f"Where is the spot now, in mm (more is {way.positive})?"
        readings.append(talk.number(question, "mm", -100_000, 100_000))
    return Marks(*readings)


def _plausible(found: Measured, axis: Axis, way: Ways, talk: Dialogue, distance_mm: float) -> bool:
    """True if the result is a usual one, or is accepted after a question."""
    talk.say(
        f"  {axis.name}: {found.positive:.4g} mrad a step {way.positive}, {found.negative:.4g}"
        f" {way.negative}; a turn loses {found.lost[0]:.2f} and {found.lost[1]:.2f} steps"
    )
    least, most = _USUAL_MRAD
    if not (least <= found.positive <= most and least <= found.negative <= most):
        talk.say(f"  A step usually turns a mirror by {least:g} … {most:g} mrad.")
        talk.say(f"  Is the distance {distance_mm:g} mm, and were the marks in mm?")
        return talk.yes("Take it nevertheless?")
    alike = abs(found.positive - found.negative) <= _ALIKE * max(found.positive, found.negative)
    if alike and min(found.lost) > -1:
        return True
    return talk.yes("That is unusual; was a mark misread? Take it nevertheless?")
