"""The course of `mirrormount setup`: questions at the terminal, moves between them, and the results saved.

All or nothing: until the last question is answered with yes, nothing is stored, and however setup ends
before that, the motors are off and the board's settings are what they were.
"""

from collections.abc import Callable

from mirrormount.cli.dialogue import Dialogue
from mirrormount.cli.setup_steps import WAYS, direction, scale, switches
from mirrormount.common.errors import MountError, SetupEnded
from mirrormount.device import calibration
from mirrormount.device.calibration import Scale
from mirrormount.device.mount import Mount

_NOTHING = "nothing was saved, and the settings are as they were"
_WELCOME = """Setup of {identity}
The mirror will move by some ten steps. Block the beam where it could meet an eye; a screen in its way,
with a ruler on it, is needed for the scale. Both screws should be in mid travel.
Ctrl-C ends it at any time: motors off, nothing saved."""


def run_course(mount: Mount, ask: Callable[[str], str] = input, say: Callable[[str], None] = print) -> None:
    """Ask and move, and save at the end if told to.

    Raises SetupEnded when the input ends or when it cannot go on; BadFile when the calibration file is
    damaged; what moving raises.
    """
    talk = Dialogue(ask, say)
    calibration.read(mount.board_id, 1)  # a damaged file is told now, not after all the work
    before = mount.settings()
    try:
        scales = _go_through(mount, talk)
        if not talk.yes(f"Save this on the board{f', and the scales in {calibration.path()}' if scales else ''}?"):
            say(_put_back(mount, before))
            return
    except EOFError:
        say("")  # the question stands without an answer
        raise SetupEnded(f"the input has ended: {_put_back(mount, before)}") from None
    except KeyboardInterrupt:
        say(f"\n{_put_back(mount, before)}")
        raise
    except SetupEnded as e:
        raise SetupEnded(f"{e}: {_put_back(mount, before)}") from e
    except MountError:
        say(_put_back(mount, before))
        raise
    _save(mount, scales, say)


def _go_through(mount: Mount, talk: Dialogue) -> dict[int, Scale]:
    """All questions. Returns the scales that were measured, by the number of the axis."""
    talk.say(_WELCOME.format(identity=mount.identity))
    if not talk.yes("May it move now?"):
        raise SetupEnded("not begun")
    axes = (mount.x, mount.y)
    for axis in axes:
        direction(mount, axis, talk)
    for axis in axes:
        switches(mount, axis, talk)
    scales = {}
    summary = []
    distance_mm = talk.number("Distance from the mirror to the screen, in mm (0: no scale now)", "mm", 0, 1e6)
    if distance_mm:
        incidence = talk.number(
            "Angle between beam and mirror's normal, in degrees (folding mirror: 45)", "degrees", 0, 80
        )
        n = talk.whole_number("Steps from mark to mark", "steps", 2, 1000, 20)
        for axis in axes:
            found, take_up_us = scale(mount, axis, talk, distance_mm, incidence, n)
            scales[axis.number] = found
            summary.append(
                f"{axis.name}: {found.positive:g} mrad of the mirror a step {WAYS[axis.name][0]},"
                f" {found.negative:g} {WAYS[axis.name][1]}; take-up {take_up_us} us"
            )
    for axis in axes:
        inverted, fitted = axis.ask_whole("XI?", "XL?")
        summary.append(f"{axis.name}: {'inverted' if inverted else 'not inverted'}, end-stops fitted (XL): {fitted}")
    talk.say("\n".join(summary))
    return scales


def _put_back(mount: Mount, before: dict[str, dict[str, int | float]]) -> str:
    """Motors off, settings as they were. Returns what to tell."""
    try:
        mount.stop()
        mount.apply(before)
    except MountError as e:
        return f"nothing was saved; the settings could not be put back ({e}): a restart of the board does that"
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
