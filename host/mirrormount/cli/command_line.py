"""The work of `mirrormount send`: one command line, its answers, the board's errors, and the end of what it starts.

Answers go to stdout; how a motion ended goes to stderr.
"""

import contextlib
import sys

from mirrormount.cli.moving import place, watched
from mirrormount.common.errors import REASONS, BadValue, BoardError, MountError
from mirrormount.device.command_lines import LONGEST, keep_alives_ms, starts_motion, with_keep_alive
from mirrormount.device.mount import Axis, Mount, Status
from mountfw import codes as wire

_POLL_S = 0.05


def send(mount: Mount, line: str) -> None:
    """Send the line, print what it answers, and wait until nothing that it started moves any more.

    Raises BoardError for the first command of it that cannot be done, MountError if something moved then, or if a
    motion did not end as done.
    """
    _check_length(line)
    moves = starts_motion(line)
    keep_alives = keep_alives_ms(line)
    if moves and not keep_alives:
        line = with_keep_alive(line)
    poll_s = min([_POLL_S, *(ms / 5000 for ms in keep_alives if ms)])
    with watched(mount, list(mount.by_name.values())) as shown:
        status = _sent(mount, line)
        axes = _moving(mount, status)
        while status.moving:
            shown.show(", ".join(place(axis, status.by_name[axis.name]) for axis in axes) + "; Ctrl-C stops")
            mount.link.sleep(poll_s)
            status = mount.status()
    errors = mount.errors()
    reasons = {axis.name: axis.last_move().reason for axis in axes}
    failed = [f"{name}: {REASONS.get(reason, reason)}" for name, reason in reasons.items() if reason != wire.DONE]
    if failed or errors:
        ended = MountError("; ".join([*failed, *(f"the board says {error}" for error in errors)]))
        ended.codes = tuple(error.code for error in errors)
        raise ended
    if moves:
        moved = axes or list(mount.by_name.values())
        print("done; " + ", ".join(place(axis, status.by_name[axis.name]) for axis in moved), file=sys.stderr)


def start(mount: Mount, line: str) -> None:
    """Send the line and print what it answers; what it starts goes on without this program, and that is said.

    Its only bounds are the board's limits, and a keep-alive that the line sets. Raises as send() does; then, and
    when it is interrupted, both motors are stopped.
    """
    if hasattr(mount.link.port, "simulation"):
        raise BadValue("this virtual board ends with this program, and its motion too: leave --no-wait out")
    _check_length(line)
    try:
        if axes := _moving(mount, _sent(mount, line)):
            names = " and ".join(axis.name for axis in axes)
            print(f"{names}: still moving; {_bounds(mount, keep_alives_ms(line))}", file=sys.stderr)
    except BaseException:
        with contextlib.suppress(MountError):
            mount.stop()
        raise


def _check_length(line: str) -> None:
    if len(line) > LONGEST:
        raise BadValue(f"a command line has at most {LONGEST} characters here, not {len(line)}")


def _send(mount: Mount, line: str) -> Status:
    if answers := mount.send(line, keep_alive=False):
        print(answers, flush=True)
    return mount.status()


def _sent(mount: Mount, line: str) -> Status:
    """As _send(). If a command is refused, what those before it have started is stopped, and that is told."""
    try:
        return _send(mount, line)
    except BoardError as e:
        if not (axes := _moving(mount, mount.status())):
            raise
        mount.stop()
        status = mount.status()
        places = ", ".join(place(axis, status.by_name[axis.name]) for axis in axes)
        ended = MountError(f"{e}; what the line had started before was stopped at {places}")
        ended.codes = e.codes
        raise ended from e


def _moving(mount: Mount, status: Status) -> list[Axis]:
    return [axis for axis in mount.by_name.values() if status.by_name[axis.name].moving]


def _bounds(mount: Mount, keep_alives: list[int]) -> str:
    """What ends a motion that nobody waits for."""
    if keep_alives and keep_alives[-1]:
        return f"the board stops it {keep_alives[-1]} ms after the last byte of this program (keep-alive)"
    run_s, search_s = (max(axis.ask_whole(query)[0] for axis in mount.axes) / 1000 for query in ("XM?", "XT?"))
    return (
        "it goes on without this program, except on CircuitPython boards, which see the port close, and behind"
        f" mirrormount serve without --on-leave finish: a run for {run_s:g} s at most, a search for a switch for"
        f" {search_s:g} s under drive at most, a move until its steps are made; mirrormount stop ends it"
    )
