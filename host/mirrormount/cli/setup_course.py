"""The course of `mirrormount setup`: questions at the terminal, moves between them, and the results saved.

All or nothing: until the last question is answered with yes, nothing is saved. However setup ends before that, the
motors are off and the old settings are on the board.
"""

import contextlib
from collections.abc import Callable

from mirrormount.cli.dialogue import Dialogue
from mirrormount.cli.setup_encoder import encoder, measured, open_loops
from mirrormount.cli.setup_steps import Ways, direction, scale, switches, ways
from mirrormount.common.errors import MountError, SetupEnded
from mirrormount.common.signals import Terminated
from mirrormount.device import calibration, settings
from mirrormount.device.calibration import Scale
from mirrormount.device.mount import Axis, Mount

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
    scales = {}
    summary = []
    mirrors = [{mount.x: axes[mount.x], mount.y: axes[mount.y]}]  # the axes of each mirror
    mirrors += [{axis: way} for axis, way in axes.items() if axis not in mirrors[0] and way.like]
    for mirror in mirrors:
        for axis, (found, take_up) in _measure(mount, mirror, talk).items():
            scales[axis.number] = found
            summary.append(
                f"{axis.name}: {found.positive:g} mrad of the mirror a step {axes[axis].positive},"
                f" {found.negative:g} {axes[axis].negative}; take-up {take_up}"
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
    except (KeyboardInterrupt, Terminated):  # of a shell command the only one: it ignores further ones
        _put_back(mount, before)
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
