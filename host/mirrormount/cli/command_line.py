"""The work of `mirrormount send`: one command line, its answers, the board's errors, and the end of what it starts.

Answers go to stdout; how a motion ended goes to stderr.
"""

import contextlib
import re
import sys

from mirrormount.cli.moving import place, watched
from mirrormount.common.errors import REASONS, BadValue, MountError
from mirrormount.common.keep_alive import KEEP_ALIVE_MS
from mirrormount.device.mount import Axis, Mount, Status
from mountfw import codes as wire

_LONGEST = 128 - len(f"XK{KEEP_ALIVE_MS};;TB?")  # a line of the board has 128 characters (docs/protocol.md)
_ADDRESS = re.compile(r" *[0-9]+ *>")
_STARTS_MOTION = re.compile(r"[ 0-9]*(PR|PA|XU|MV|MT|OR)(?!.*\?)", re.IGNORECASE)
_KEEP_ALIVE = re.compile(r"XK *([0-9]+)", re.IGNORECASE)
_POLL_S = 0.05


def send(mount: Mount, line: str) -> None:
    """Send the line, print what it answers, and wait until nothing that it started moves any more.

    Raises BoardError for the first command of it that cannot be done, MountError if a motion did not end as done.
    """
    at = _begin(line)
    moves = any(map(_STARTS_MOTION.match, line[at:].split(";")))
    keep_alives = _keep_alives(line)
    if moves and not keep_alives:
        line = f"{line[:at]}XK{KEEP_ALIVE_MS};{line[at:]}"
    poll_s = min([_POLL_S, *(ms / 5000 for ms in keep_alives if ms)])
    with watched(mount, list(mount.by_name.values())) as shown:
        status = _send(mount, line)
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
    _begin(line)
    try:
        if axes := _moving(mount, _send(mount, line)):
            names = " and ".join(axis.name for axis in axes)
            print(f"{names}: still moving; {_bounds(mount, _keep_alives(line))}", file=sys.stderr)
    except BaseException:
        with contextlib.suppress(MountError):
            mount.stop()
        raise


def _begin(line: str) -> int:
    """Where the line's first command begins. Raises BadValue for a line that is too long."""
    if len(line) > _LONGEST:
        raise BadValue(f"a command line has at most {_LONGEST} characters here, not {len(line)}")
    address = _ADDRESS.match(line)
    return address.end() if address else 0


def _send(mount: Mount, line: str) -> Status:
    if answers := mount.send(line):
        print(answers, flush=True)
    return mount.status()


def _moving(mount: Mount, status: Status) -> list[Axis]:
    return [axis for axis in mount.by_name.values() if status.by_name[axis.name].moving]


def _keep_alives(line: str) -> list[int]:
    """The keep-alives that the line sets itself, in ms."""
    return [int(ms) for ms in _KEEP_ALIVE.findall(line)]


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
