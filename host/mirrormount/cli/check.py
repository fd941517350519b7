"""`mirrormount check`: the self-test, one line a check. Nothing moves unless that is asked for.

A check is a function that returns what it found, or raises Wrong with what is wrong and what to do, or NotTested with
the reason. Other checks still run after one that failed. With --move the mirror moves by a few steps, and about the
same back. A board knows pulses, not motion: a jammed motor has had them, too. So these checks are "ok" only for an axis
that its encoder, or the person at the terminal, has seen move; else they are "not seen".
"""

import argparse
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from mirrormount.cli.arguments import Command, open_mount, port_options, said_yes
from mirrormount.device.axis import Axis, counts_between
from mirrormount.device.mount import Mount
from mirrormount.device.status import RESET_CAUSES, Ended
from mirrormount.errors import REASONS, BoardError, CheckFailed, ConnectionLost, EncoderFault, MountError, MoveEnded
from mirrormount.terminal import ended_in_order, printable
from mirrormount.values import KEEP_ALIVE_MS, whole_numbers
from mountfw import __version__
from mountfw import codes as wire

_STEPS = 4  # steps whose counts are measured each way, after three that take up the play
_LOOKS = 3  # A board calls an encoder lost after so many readings without an answer.
_MEASURED = "measured"  # the certainty of a position as long as no count was lost
_DIFFERENT = 0.35  # Supply and load change the counts of a timed step by this part at most.
_KEEP_ALIVE_MS = 50  # the keep-alive that the test sets
# The silence is shorter than the host's own keep-alive, which must not be the one that ends the move. It is much longer
# than the test's, for on a busy computer a virtual board runs slower than the clock of its host.
_SILENCE_S = 0.8 * KEEP_ALIVE_MS / 1000
_LATE_US = 1000  # by so much a pulse may be wrong
_BY_ENCODER = (wire.CLOSED_LOOP_FAILED, wire.STALLED, wire.WRONG_WAY, wire.FOLLOWING, wire.ENCODER_LOST)
_WHY = "what its encoder counts has ended it, see there; docs/errors.md has the causes"


def arguments(parser: argparse.ArgumentParser) -> None:
    """--move, --timing, and the port."""
    port_options(parser)
    parser.add_argument("--timing", action="store_true", help="instead: time the board's pins, the motors' supply off")
    parser.add_argument("--supply-off", action="store_true", help="timing: the motors' supply is off; do not ask")
    parser.add_argument("--report", metavar="FILE", default="timing", help="timing: FILE.json and .html (timing)")
    parser.add_argument("--move", action="store_true", help="also make a few steps on each axis")


def run(args: argparse.Namespace) -> None:
    """Print one line a check. Raises CheckFailed if one failed."""
    if args.timing:
        from mirrormount.cli.timing import SEND, run_timing
        from mirrormount.device.table_file import find_port
        from mirrormount.transport.discovery import find_one

        with ended_in_order():
            ask = None if args.supply_off else said_yes
            pages = run_timing(find_port(args.port).address if args.port else find_one(), Path(args.report), ask)
        print(f"OK: {pages[0]} and {pages[1]} are written.\n{SEND.format(file=pages[0].name)}")
        return
    with ended_in_order():
        run_checks(lambda: open_mount(args), move=args.move, ask=said_yes if sys.stdin and sys.stdin.isatty() else None)


# ---- all checks


class NotTested(Exception):
    """A check could not be made; the message says why."""


class NotSeen(Exception):
    """The board did as it was told, and nothing has seen whether the mirror moved; the message says what it did."""


class Wrong(Exception):
    """A check failed; the message says what is wrong and what to do."""


def run_checks(open_mount: Callable[[], Mount], *, move: bool, ask: Callable[[str], bool] | None = None) -> None:
    """Run all checks and print a line for each. ask: puts a question to a person. Raises CheckFailed if one failed."""
    failed = 0
    try:
        mount = open_mount()
    except MountError as e:
        _line("FAILED", "port", str(e))
        raise CheckFailed("no mount was reached: nothing else was tested") from e
    with mount:
        _line("ok", "port", "a mount answers")
        for what, test in _checks(mount, move, ask):
            try:
                with mount.unless_stopped():
                    _check_not_stopped(mount)  # in the block: a stop from here on keeps the test from moving
                    _line("ok", what, test())
            except NotTested as e:
                _line("not tested", what, str(e))
            except NotSeen as e:
                _line("not seen", what, f"{e}; motion not verified")
            except (ConnectionLost, CheckFailed):
                raise
            except (MountError, Wrong) as e:
                failed += 1
                _line("FAILED", what, str(e))
                _check_not_stopped(mount)
    if failed:
        raise CheckFailed(f"{failed} {'check' if failed == 1 else 'checks'} failed")


def _check_not_stopped(mount: Mount) -> None:
    """Raise CheckFailed if another program has stopped the mount: then nothing more is to move."""
    if mount.session.stops_by_others:
        raise CheckFailed("stopped by `mirrormount stop`: the rest was not tested")


def _line(verdict: str, what: str, found: str) -> None:
    print(f"{verdict:11}{what}: {printable(found, 2000)}", flush=True)


def _checks(mount: Mount, move: bool, ask: Callable[[str], bool] | None) -> Iterator[tuple[str, Callable[[], str]]]:
    waiting = mount.errors()  # before a check can add to them
    yield "identity", lambda: identity(mount)
    yield "firmware", lambda: firmware(mount)
    yield "health", lambda: health(mount)
    yield "settings", lambda: saved_settings([error.code for error in waiting])
    others = [error for error in waiting if error.code != wire.SETTINGS_DAMAGED]
    yield "errors waiting", lambda: errors_waiting([f"{error.code} {error.text}" for error in others])
    axes = mount.by_name.values()
    for axis in axes:
        yield f"{axis.name} emergency stop", lambda axis=axis: emergency_stop(axis)
    for axis in axes:
        yield f"{axis.name} end-stops", lambda axis=axis: end_stops(axis)
    for axis in axes:
        if axis.has_encoder:
            yield f"{axis.name} encoder", lambda axis=axis: encoder_at_rest(axis)
    yield "stop", lambda: stop_at_rest(mount)
    for axis in axes:
        for what, test in motion_checks(mount, axis, ask):
            yield f"{axis.name} {what}", test if move else _without_moving


def _without_moving() -> str:
    raise NotTested("this one moves the mirror: say --move")


# ---- checks at rest


def identity(mount: Mount) -> str:
    """Board, unique id and firmware version; the version must be this host's."""
    version = mount.identity.split(",")[-1]
    if version != __version__:
        raise Wrong(f"the board has mountfw {version}, this host is {__version__}: mirrormount deploy")
    return mount.identity


def firmware(mount: Mount) -> str:
    """Are the files on the board those that this host would deploy?"""
    from mirrormount.deploy.firmware import known_hashes

    if mount.send("XF?") in known_hashes():
        return "the files on the board are those that this host deploys"
    raise NotTested(
        "the files on the board are not those that this host deploys: another version, or a board file of your own"
        " (--pins); if it is neither, mirrormount deploy"
    )


def health(mount: Mount) -> str:
    """Free memory, longest pass of the loop, and whether the watchdog had to reset the board."""
    free, longest_us, _passes, cause, gate = whole_numbers(mount.send("XH?"), 5)
    if cause == wire.WATCHDOG:
        raise Wrong(f"the board was reset by {RESET_CAUSES[str(cause)]}; report it (docs/errors.md, 66)")
    memory = f"{free // 1024} KB of memory free" if free else "free memory not known here"
    place = "" if not gate else ", gate in place" if gate == wire.GATE_IN_PLACE else f", gate not in place ({gate})"
    return f"{memory}, longest pass of the loop {longest_us / 1000:.1f} ms{place}"


def saved_settings(waiting: list[int]) -> str:
    """Has the board said that its saved settings are damaged?"""
    if wire.SETTINGS_DAMAGED in waiting:
        raise Wrong(
            "those saved on the board are damaged and its defaults are in use: mirrormount config import FILE"
            " (or mirrormount setup), then mirrormount config save"
        )
    return "the board has not called its saved ones damaged"


def errors_waiting(waiting: list[str]) -> str:
    """Errors that nobody had read."""
    if waiting:
        raise Wrong(f"{'; '.join(waiting)} (docs/errors.md tells cause and remedy; they are read now)")
    return "none"


def emergency_stop(axis: Axis) -> str:
    """A move of no steps is refused while the emergency stop is pressed; it drives nothing."""
    try:
        axis.step(0)
    except BoardError as e:
        if e.code % 100 == wire.AXIS_EMERGENCY_STOP:
            raise Wrong("pressed, or its wire is broken: close it, then mirrormount send '*RST'") from e
        raise
    return "not pressed, or not fitted"


def end_stops(axis: Axis) -> str:
    """What the end-stops that are said to be fitted show."""
    fitted, checking = axis.ask_whole("XL?", "ZH?")
    if not fitted:
        raise NotTested("none are said to be fitted (mirrormount setup tells it)")
    if checking & 1:
        raise NotTested(f"they are ignored: mirrormount config set {axis.name}.checking 0")
    active = axis.status().limits & 3
    if active == 3:
        raise Wrong("both are active at once: a broken wire or plug, or switches that are not there (XL)")
    if active:
        side = "positive" if active == 1 else "negative"
        away = -20 if active == 1 else 20
        raise Wrong(
            f"the {side} one is active: mirrormount step {axis.name} {away}, and check again;"
            " if it stays active away from its end, its wire is broken"
        )
    return "fitted, and none is active"


def stop_at_rest(mount: Mount) -> str:
    """The stop is answered. That it ends a motion takes --move."""
    mount.stop()
    return "answered, and nothing moves"


# ---- checks that move the mirror


def motion_checks(
    mount: Mount, axis: Axis, ask: Callable[[str], bool] | None = None
) -> Iterator[tuple[str, Callable[[], str]]]:
    """The checks of one axis: (what, check). The first one sees whether it moves, if anything does."""
    saw = False

    def looked() -> str:
        nonlocal saw
        found = encoder_in_a_move(axis) if axis.has_encoder else seen_by_person(axis, ask)
        saw = True
        return found

    def seen(found: str) -> str:
        if not saw:
            raise NotSeen(found)
        return found

    yield "encoder in a move" if axis.has_encoder else "motion", looked
    yield "one step forward", lambda: seen(one_step(axis, 1))
    yield "one step back", lambda: seen(one_step(axis, -1))
    yield "stop in a move", lambda: seen(stop_in_motion(mount, axis))
    yield "keep-alive", lambda: seen(keep_alive_ends_motion(mount, axis))


def seen_by_person(axis: Axis, ask: Callable[[str], bool] | None) -> str:
    """Steps there and back, enough for a gap and for the eye. Raises NotTested if nobody is there to see them."""
    if ask is None:
        raise NotTested("no encoder, and nobody at a terminal who would see the spot move: motion not verified")
    ask(f"{axis.name}: look at the spot, it is to move by {_STEPS} steps and back. Ready?")
    axis.step(_STEPS)
    axis.step(-_STEPS)
    if not ask(f"{axis.name}: did it move, there and back?"):
        raise Wrong("you saw no motion: motor, its wires, supply and coupler (docs/bring-up.md)")
    return f"you saw {_STEPS} steps there and back"


def one_step(axis: Axis, n: int) -> str:
    """A step is done, and its time under drive is the pulse's; a take-up of the backlash may come on top."""
    pulse_us, take_up_us = axis.ask_whole("XP?", "XB?")
    try:
        axis.step(n)
    except MoveEnded as e:
        if e.reason in _BY_ENCODER:
            raise Wrong(f"{e}: {_WHY}") from e
        raise
    if axis.has_encoder and axis.closed_loop:
        return f"done, {axis.last_move().on_time_s * 1e6:.0f} us under drive until its counts were there"
    on_us = round(axis.last_move().on_time_s * 1e6)
    if not pulse_us - _LATE_US <= on_us <= pulse_us + take_up_us + _LATE_US:
        raise Wrong(f"the motor had drive for {on_us} us, not {pulse_us} us: report it")
    return f"done, {on_us} us under drive for a pulse of {pulse_us} us"


def stop_in_motion(mount: Mount, axis: Axis) -> str:
    """A stop ends a move that is under way."""
    _rest(mount, axis)
    axis.step(-_long_move(axis), wait=False)
    mount.link.sleep(0.05)
    mount.stop()
    _must_be(axis.wait(), wire.ABORTED)
    return "the move ended at once"


def keep_alive_ends_motion(mount: Mount, axis: Axis) -> str:
    """A move ends when its host falls silent, and the board says so."""
    _rest(mount, axis)
    mount.send(f"XK{_KEEP_ALIVE_MS};{axis.number}PR{_long_move(axis)}")
    mount.link.sleep(_SILENCE_S)
    _must_be(axis.wait(), wire.KEEP_ALIVE)
    codes = [error.code for error in mount.errors()]
    if wire.KEEP_ALIVE_LOST not in codes:
        raise Wrong(f"the move ended, but error {wire.KEEP_ALIVE_LOST} was not told: report it")
    return f"the move ended after {_KEEP_ALIVE_MS} ms of silence, and the board says {wire.KEEP_ALIVE_LOST}"


def _long_move(axis: Axis) -> int:
    """So many steps that the move lasts for a second at least, were it not ended."""
    pulse_us, velocity = axis.ask("XP?", "VA?")
    return math.ceil(1 / max(1 / float(velocity), int(pulse_us) * 1e-6)) + 1


def _rest(mount: Mount, axis: Axis) -> None:
    """Wait for the end of the last step's rest: a move that begins in it is ended before the motor has drive."""
    pulse_us, velocity = axis.ask("XP?", "VA?")
    mount.link.sleep(max(1 / float(velocity), int(pulse_us) * 1e-6) + 0.01)


def _must_be(ended: Ended, reason: int) -> None:
    if ended.reason in _BY_ENCODER:
        raise Wrong(f"the move ended as {REASONS[ended.reason]!r}: {_WHY}")
    if ended.reason != reason:
        raise Wrong(f"the move ended as {REASONS[ended.reason]!r}, not as {REASONS[reason]!r}: report it")
    if not ended.on_time_s:
        raise Wrong("the move ended before the motor had drive, so nothing was tested: run it again")


# ---- encoder


def encoder_at_rest(axis: Axis) -> str:
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


def encoder_in_a_move(axis: Axis) -> str:
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
        needed = f"the closed loop and a measured position: `mirrormount zero {axis.name}`"
        return f", lost counts not looked for (that needs {needed})"
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


COMMANDS = (Command("check", "test the mount step by step; nothing moves without --move", run, arguments),)
