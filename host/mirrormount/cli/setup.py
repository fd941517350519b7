"""`mirrormount setup`: the guided set-up of a new mount.

Questions at the terminal, moves between them, and the results saved. The steps for one axis (direction, switches,
encoder, scale and backlash) change settings on the board and save nothing. Until the last question is answered with
yes, nothing is saved: however setup ends before that, the motors are off and the old settings are on the board.
"""

import argparse
import contextlib
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from mirrormount.cli.arguments import Command, open_mount, port_options
from mirrormount.device import calibration, settings
from mirrormount.device.axis import Axis, counts_between
from mirrormount.device.calibration import Marks, Measured, Scale, Step, beam_per_mirror, measure_scale, take_up
from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, EncoderFault, MountError, SettingRefused, SetupEnded
from mirrormount.terminal import Terminated, ended_in_order
from mirrormount.values import typed_number

T = TypeVar("T")
_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(,[0-9]{3})+(\.[0-9]*)?")


# ---- questions


class Dialogue:
    """Asks with ask(question), which returns a line or raises EOFError, and tells with say(text)."""

    def __init__(self, ask: Callable[[str], str] = input, say: Callable[[str], None] = print) -> None:
        self._ask = ask
        self.say = say

    def until(self, question: str, parse: Callable[[str], T]) -> T:
        """Ask until parse(answer) does not raise BadValue. Returns what it returns."""
        while True:
            try:
                return parse(self._ask(question + " ").strip().lower())
            except RuntimeError:  # input() without a standard input
                raise EOFError from None
            except BadValue as e:
                self.say(f"  {e}")

    def choice(self, question: str, words: tuple[str, ...]) -> str:
        """One of these words; its first letters are enough where no other word begins so."""

        def parse(answer: str) -> str:
            found = [word for word in words if answer and word.startswith(answer)]
            if len(found) != 1:
                raise BadValue(f"please answer {', '.join(words[:-1])} or {words[-1]}")
            return found[0]

        return self.until(f"{question} [{'/'.join(words)}]", parse)

    def yes(self, question: str) -> bool:
        """True for yes, False for no; there is no default."""
        return self.choice(question, ("yes", "no")) == "yes"

    def number(self, question: str, unit: str, least: float, most: float, default: float | None = None) -> float:
        """A number within least … most, repeated with its unit; with a default, an empty answer means that.

        What a comma in it means is asked.
        """

        def parse(answer: str) -> float:
            if not answer and default is not None:
                return float(default)
            meant = self._without_comma(answer) if "," in answer else answer
            try:
                value = typed_number(meant, question)
            except ValueError:
                value = float("nan")
            if not least <= value <= most:
                raise BadValue(f"please give a number within {least:.10g} … {most:.10g}, in {unit}")
            return value

        value = self.until(question if default is None else f"{question} [{default:g}]", parse)
        self.say(f"  = {value:.10g} {unit}")
        return value

    def whole_number(self, question: str, unit: str, least: int, most: int, default: int) -> int:
        """A whole number, as number() asks for one."""
        while True:
            value = self.number(question, unit, least, most, default)
            if value.is_integer():
                return int(value)
            self.say("  please give a whole number")

    def _without_comma(self, answer: str) -> str:
        """The number that is meant by an answer with a comma. Raises BadValue if it is another one."""
        meanings = [answer.replace(",", ".")] if answer.count(",") == 1 and "." not in answer else []
        if _THOUSANDS.fullmatch(answer):
            meanings.append(answer.replace(",", ""))
        for meant in meanings:
            if self.yes(f"A comma: is {answer} the number {meant}?"):
                return meant
        raise BadValue("please give the number without a comma")

    def enter(self, question: str, way_out: str) -> bool:
        """True for Enter alone, False for the word way_out."""

        def parse(answer: str) -> bool:
            if answer not in ("", way_out):
                raise BadValue(f"please press Enter, or type {way_out}")
            return not answer

        return self.until(f"{question} [Enter, or {way_out}]", parse)


# ---- steps for one axis

_TRIES = (5, 10, 20)  # steps: the first few may vanish in the backlash
_USUAL_MRAD = (0.01, 2.0)  # usual angles of the mirror a step; the paper's mount has 0.2
_ALIKE = 0.25  # a smaller relative difference of the two directions needs no question


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
        found = measure_scale(_marks(mount, axis, way, talk, n), n, distance_mm, factor)
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


# ---- the least duty that starts the motor

_DUTIES = tuple(range(15, 256, 15))  # those that are tried: the middle of what is left, about four of them
_RUN_S = 1.5  # a step's way at a seventh of full duty
_TURNS_COUNTS = 10  # an encoder that counts so many has turned: noise is 2 at most


def starting(mount: Mount, axis: Axis, way: Ways, talk: Dialogue) -> None:
    """Find the least duty at which the motor starts: by the encoder, or the person sees what moves."""
    if not talk.yes(f"Find the least duty at which {axis.name} starts, by some short runs?"):
        return
    by_encoder = axis.has_encoder and axis.counts_per_step != 0
    closed = axis.closed_loop if axis.has_encoder else 0
    if closed:  # it would end a run that does not turn
        mount.apply({axis.name: {"closed_loop": 0}})
    axis.step(_TRIES[0])  # through the backlash: all runs go the same way
    before = axis.position
    low, high = 0, len(_DUTIES)  # of those from `high` on each has moved it, of those below `low` none
    while low < high:
        middle = (low + high) // 2
        if _starts(mount, axis, way, talk, _DUTIES[middle], by_encoder):
            high = middle
        else:
            low = middle + 1
    axis.step(-round(axis.position - before))  # about back: a run's way is an estimate
    if closed:
        mount.apply({axis.name: {"closed_loop": closed}})
    if low == len(_DUTIES):
        talk.say(f"  {axis.name} started at none of them: look at motor supply, coupler, encoder. Not set.")
        return
    mount.apply({axis.name: {"start_duty": _DUTIES[low]}})
    talk.say(f"  {axis.name} starts at a duty of {_DUTIES[low]} of 255; below it a run warns.")


def _starts(mount: Mount, axis: Axis, way: Ways, talk: Dialogue, duty: int, by_encoder: bool) -> bool:
    """Run at this duty for a moment, from rest. Did it move?"""
    thing = "the spot" if way.like else axis.name
    while True:
        talk.say(f"{axis.name}: {way.positive} at a duty of {duty} for {_RUN_S:g} s …")
        counts = axis.counts if by_encoder else 0
        axis.jog(duty / 255)
        mount.sleep(_RUN_S)
        axis.stop()
        if by_encoder:
            return abs(counts_between(counts, axis.counts)) >= _TURNS_COUNTS
        answer = talk.choice(f"Did {thing} move?", ("yes", "no", "again"))
        if answer != "again":
            return answer == "yes"


# ---- encoder


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
    talk.say("  whether it loses counts: `mirrormount check --move`, once the position is defined (`mirrormount zero`)")
    closed = talk.yes(f"Close the loop, so that a step of {axis.name} is {abs(found.per_step)} counts from now on?")
    mount.apply({axis.name: found.settings | {"closed_loop": int(closed)}})


def measured(axis: Axis) -> list[str]:
    """A line for the summary, where there is an encoder."""
    if not axis.has_encoder:
        return []
    per_step, closed = axis.ask_whole("XN?", "MM?")
    counts = f"{per_step} counts a step" if per_step else "not measured"
    return [f"{axis.name}: encoder, {counts}, {'closed' if closed else 'open'} loop"]


# ---- the course

_NOTHING = "nothing was saved, and the settings are as they were"
_WELCOME = """Setup of {identity}
The mirror will move by some tens of steps. Block the beam where it could meet an eye; a screen in its way,
with a ruler on it, is needed for the scale. Both screws should be in mid travel.
Ctrl-C ends it at any time: motors off, nothing saved."""


def run_course(mount: Mount, ask: Callable[[str], str] = input, say: Callable[[str], None] = print) -> None:
    """Ask and move, and save at the end if the answer is yes.

    Raises SetupEnded if the input ends or a step fails, BadFile or CannotWrite if the scales could not be saved, and
    as Axis.step() does.
    """
    talk = Dialogue(ask, say)
    for axis in mount.axes:
        calibration.read(mount.board_id, axis.number)  # a damaged file is reported now, not after all the work
    calibration.check_writable()
    before = mount.settings()
    try:
        with mount.unless_stopped(since_open=True):  # a stop in a question is for what follows it, too
            scales = _go_through(mount, talk)
        if not talk.yes(f"Save this on the board{f', and the scales in {calibration.path()}' if scales else ''}?"):
            say(_put_back(mount, before))
            return
    except EOFError:
        ended = SetupEnded(f"the input has ended: {_put_back(mount, before)}")
        with contextlib.suppress(OSError):
            say("")  # the question stands without an answer
        raise ended from None
    except SetupEnded as e:
        raise SetupEnded(f"{e}: {_put_back(mount, before)}") from e
    except BaseException as e:  # Ctrl-C and other signals, too, and output that nobody reads
        outcome = _put_back(mount, before)
        with contextlib.suppress(OSError):
            say(outcome if isinstance(e, MountError) else f"\n{outcome}")
        raise
    _save(mount, scales, say)


def _go_through(mount: Mount, talk: Dialogue) -> dict[int, Scale]:
    """Ask all questions. Returns the measured scales by the number of the axis."""
    talk.say(_WELCOME.format(identity=mount.identity))
    if not talk.yes("May it move now?"):
        raise SetupEnded("not begun")
    open_loops(mount)
    axes = {axis: ways(axis, talk) for axis in mount.by_name.values()}
    for axis, way in axes.items():
        direction(mount, axis, way, talk)
    for axis, way in axes.items():
        switches(mount, axis, way, talk)
    for axis in axes:
        encoder(mount, axis, talk)
    for axis, way in axes.items():
        starting(mount, axis, way, talk)
    scales = {}
    summary = []
    mirrors = [{mount.x: axes[mount.x], mount.y: axes[mount.y]}]  # the axes of each mirror
    mirrors += [{axis: way} for axis, way in axes.items() if axis not in mirrors[0] and way.like]
    for mirror in mirrors:
        for axis, (found, take_up_told) in _measure(mount, mirror, talk).items():
            scales[axis.number] = found
            summary.append(
                f"{axis.name}: {found.positive:g} mrad of the mirror a step {axes[axis].positive},"
                f" {found.negative:g} {axes[axis].negative}; take-up {take_up_told}"
            )
    for axis in axes:
        inverted, fitted = axis.ask_whole("XI?", "XL?")
        summary.append(f"{axis.name}: {'inverted' if inverted else 'not inverted'}, end-stops fitted (XL): {fitted}")
        summary += measured(axis)
    talk.say("\n".join(summary))
    return scales


def _measure(mount: Mount, axes: dict[Axis, Ways], talk: Dialogue) -> dict[Axis, tuple[Scale, str]]:
    """Ask for the geometry of one mirror, and measure the scale and take-up of its axes; {} without a distance."""
    mirror = "the mirror" if mount.x in axes else f"the mirror of {' and '.join(axis.name for axis in axes)}"
    distance_mm = talk.number(f"Distance from {mirror} to the screen, in mm (0: no scale now)", "mm", 0, 1e6)
    if not distance_mm:
        return {}
    incidence = talk.number("Angle between beam and mirror's normal, in degrees (folding mirror: 45)", "degrees", 0, 80)
    n = talk.whole_number("Steps from mark to mark", "steps", 2, 1000, 20)
    return {axis: scale(mount, axis, way, talk, distance_mm, incidence, n) for axis, way in axes.items()}


def _put_back(mount: Mount, before: dict[str, dict[str, int | float]]) -> str:
    """Motors off, old settings restored. Returns the line for the user."""
    try:
        mount.stop()
        settings.put_back(mount.session, before)
    except MountError as e:
        return f"nothing was saved; the settings could not be put back ({e}): a restart of the board does that"
    except (KeyboardInterrupt, Terminated):  # once more, whole: half of the settings would be neither old nor new
        mount.stop()
        settings.put_back(mount.session, before)
        raise
    return _NOTHING


def _save(mount: Mount, scales: dict[int, Scale], say: Callable[[str], None]) -> None:
    try:
        mount.save()
    except MountError as e:
        raise SetupEnded(f"the settings last until the board restarts, they and the scales were not saved: {e}") from e
    say("The settings are saved on the board.")
    if scales:
        try:
            path = calibration.write(mount.board_id, scales)
        except MountError as e:
            raise SetupEnded(f"the settings are saved on the board, the scales are not: {e}") from e
        say(f"The scales are saved in {path}.")
    say("Now: mirrormount check --move")


def run(args: argparse.Namespace) -> None:
    """Ask and move, and save at the end if the answer is yes. Raises MountError."""
    with ended_in_order(), open_mount(args) as mount:
        run_course(mount)


COMMANDS = (
    Command(
        "setup", "go through a new mount: directions, switches, scale and backlash, with questions", run, port_options
    ),
)
