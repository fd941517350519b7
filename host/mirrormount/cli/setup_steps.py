"""What `mirrormount setup` asks about one axis: which way it goes, which switches it has, how far a step goes.

Each function changes the settings on the board as it learns, and stores nothing; setup_course.py does
that in the end, or puts everything back.
"""

from mirrormount.cli.dialogue import Dialogue
from mirrormount.common.errors import SettingRefused, SetupEnded
from mirrormount.device.calibration import Scale, Step
from mirrormount.device.mount import Axis, Mount
from mirrormount.device.scale_fit import Marks, Measured, beam_per_mirror, measure

WAYS = {"x": ("right", "left"), "y": ("up", "down")}
_TRIES = (5, 10, 20)  # steps: the first few may vanish in the backlash
_ENDS = {1: 0, 2: 1}  # the bit of an end-stop: which of an axis's ways leads to it
_MOST_TAKE_UP_US = 2_000_000
_USUAL_MRAD = (0.01, 2.0)  # of the mirror a step; the paper's mount: 0.2
_ALIKE = 0.25  # relative difference of the two directions that is still believed without a question


def direction(mount: Mount, axis: Axis, talk: Dialogue) -> None:
    """Make positive steps go right (x) or up (y). Raises SetupEnded if the motors are exchanged or dead."""
    forward, backward = WAYS[axis.name]
    tries = list(_TRIES)
    while True:
        _step(mount, axis, tries[0], talk)
        answer = talk.choice("Which way did the spot go?", ("right", "left", "up", "down", "nothing", "again"))
        if answer == forward:
            return
        if answer == backward:
            mount.apply({axis.name: {"inverted": 1 - axis.ask_whole("XI?")[0]}})
            talk.say(f"  {axis.name} is inverted now; once more, to see it.")
        elif answer == "nothing":
            tries.pop(0)
            if not tries:
                raise SetupEnded(f"{axis.name} does not move the spot: look at motor supply, plug and coupler")
            talk.say("  The backlash may have swallowed it; now more steps.")
        elif answer != "again":
            raise SetupEnded(
                f"{axis.name} moves the spot {answer}: the motors are exchanged; exchange their plugs"
                " (or say x_axis=1 in Python) and run setup again"
            )


def switches(mount: Mount, axis: Axis, talk: Dialogue) -> None:
    """Say which end-stops are fitted, and see each of them pressed."""
    forward, backward = WAYS[axis.name]
    which = talk.choice(
        f"End-stop switches on {axis.name}: on both sides, on the {forward} or {backward} side only, or none?",
        ("both", forward, backward, "none"),
    )
    fitted = {"both": 3, forward: 1, backward: 2, "none": 0}[which]
    try:
        _fit(mount, axis, fitted)
    except SettingRefused as e:
        talk.say(f"  {e}: going on without switches")
        fitted = 0
    if fitted and not _all_released(axis, talk):
        fitted = 0
    for bit, way in _ENDS.items():
        if fitted & bit and not _see_pressed(axis, bit, WAYS[axis.name][way], talk):
            fitted &= ~bit
    _fit(mount, axis, fitted)


def scale(
    mount: Mount, axis: Axis, talk: Dialogue, distance_mm: float, incidence_deg: float, n: int
) -> tuple[Scale, int]:
    """Measure the scale of both directions and the backlash. Returns the scale and the take-up in us of drive."""
    mount.apply({axis.name: {"take_up_us": 0}})  # it would hide what is to be measured
    factor = beam_per_mirror(axis.name, incidence_deg)
    while True:
        found = measure(_marks(mount, axis, talk, n), n, distance_mm, factor)
        if found is None:
            talk.say(f"  These readings do not go with the steps: they must grow to the {WAYS[axis.name][0]}. Again.")
        elif max(found.lost) > _approach(n):
            n *= 2
            talk.say(f"  The backlash is too large for so few steps. Again, with {n}.")
        elif _believed(found, axis, talk, distance_mm):
            break
    pulse_us, step_duty, inverted = axis.ask_whole("XP?", "XD?", "XI?")
    take_up_us = min(_MOST_TAKE_UP_US, round(found.backlash * pulse_us))
    mount.apply({axis.name: {"take_up_us": take_up_us}})
    step = Step(pulse_us, step_duty, inverted)
    return Scale(float(f"{found.positive:.4g}"), float(f"{found.negative:.4g}"), step), take_up_us


def _step(mount: Mount, axis: Axis, n: int, talk: Dialogue) -> None:
    talk.say(f"{axis.name}: {abs(n)} steps {WAYS[axis.name][0 if n > 0 else 1]} …")
    axis.step(n)
    simulation = getattr(mount.link.port, "simulation", None)
    if simulation:  # a virtual board in this process: nobody sees its screen
        right, up = simulation.bench.spot_mm()
        talk.say(f"  (virtual screen: the spot is at {right:.1f} mm right, {up:.1f} mm up)")


def _fit(mount: Mount, axis: Axis, own: int) -> None:
    """XL counts the inputs of the board; they keep their direction when the axis is inverted."""
    inverted = axis.ask_whole("XI?")[0]
    mount.apply({axis.name: {"switches": (own & 1) << 1 | own >> 1 if inverted else own}})


def _active(axis: Axis) -> int:
    return axis.status().limits & 3


def _all_released(axis: Axis, talk: Dialogue) -> bool:
    while active := _active(axis):
        ends = " and ".join(WAYS[axis.name][way] for bit, way in _ENDS.items() if active & bit)
        talk.say(f"  The switch on this side shows as pressed: {ends}. It must open when it is pressed, and its wire")
        talk.say("  must not be broken; the mount must not stand at its end.")
        if not talk.enter("Look again?", "none"):
            return False
    return True


def _see_pressed(axis: Axis, bit: int, side: str, talk: Dialogue) -> bool:
    """False if the person gives up on this switch."""
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


def _marks(mount: Mount, axis: Axis, talk: Dialogue, n: int) -> Marks:
    _step(mount, axis, -_approach(n), talk)  # and back, so that all of it stays within n steps of here
    readings = []
    for steps in (_approach(n), n, -n, -n, n):
        _step(mount, axis, steps, talk)
        question = f"Where is the spot now, in mm (more is {WAYS[axis.name][0]})?"
        readings.append(talk.number(question, "mm", -100_000, 100_000))
    return Marks(*readings)


def _believed(found: Measured, axis: Axis, talk: Dialogue, distance_mm: float) -> bool:
    talk.say(
        f"  {axis.name}: {found.positive:.4g} mrad a step {WAYS[axis.name][0]}, {found.negative:.4g}"
        f" {WAYS[axis.name][1]}; a turn loses {found.lost[0]:.2f} and {found.lost[1]:.2f} steps"
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
