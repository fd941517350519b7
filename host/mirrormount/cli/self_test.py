"""`mirrormount check`: the self-test, one line a check. Nothing moves unless that is asked for.

A check is a function of the mount that returns what it found, or raises Wrong with what is wrong
and what to do, or NotTested with the reason. Other checks still run after one that failed.
"""

from collections.abc import Callable, Iterator

from mirrormount.cli import self_test_encoder, self_test_motion
from mirrormount.cli.outcomes import NotTested, Wrong
from mirrormount.common.errors import BoardError, CheckFailed, ConnectionLost, MountError
from mirrormount.common.printable import printable
from mirrormount.common.validation import whole_numbers
from mirrormount.device.board import RESET_CAUSES
from mirrormount.device.mount import Axis, Mount
from mountfw import __version__
from mountfw import codes as wire


def run_checks(open_mount: Callable[[], Mount], *, move: bool) -> None:
    """Run all checks and print a line for each. Raises CheckFailed if one failed."""
    failed = 0
    try:
        mount = open_mount()
    except MountError as e:
        _line("FAILED", "port", str(e))
        raise CheckFailed("no mount was reached: nothing else was tested") from e
    with mount:
        _line("ok", "port", "a mount answers")
        for what, test in _checks(mount, move):
            try:
                with mount.unless_stopped():
                    _check_not_stopped(mount)  # in the block: a stop from here on keeps the test from moving
                    _line("ok", what, test())
            except NotTested as e:
                _line("not tested", what, str(e))
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


def _checks(mount: Mount, move: bool) -> Iterator[tuple[str, Callable[[], str]]]:
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
            yield f"{axis.name} encoder", lambda axis=axis: self_test_encoder.at_rest(axis)
    yield "stop", lambda: stop_at_rest(mount)
    for axis in axes:
        for what, test in self_test_motion.checks(mount, axis):
            yield f"{axis.name} {what}", test if move else _without_moving


def _without_moving() -> str:
    raise NotTested("this one moves the mirror: say --move")


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
