"""`mirrormount step`, `move`, `home`, `zero`, `jog`, `drive`.

A motion is shown on one line while it lasts, if stderr is a terminal. However it ends, how far it went and the position
at the end are printed; Ctrl-C stops both motors first.
"""

import argparse
import contextlib
import math
from collections.abc import Callable, Iterator, Sequence

from mirrormount.cli.arguments import SECONDS_HELP, Command, axis_argument, number, open_mount, port_options, whole
from mirrormount.device.axis import Axis
from mirrormount.device.mount import Mount
from mirrormount.device.status import AxisStatus
from mirrormount.errors import REASONS, BadValue, MountError
from mirrormount.terminal import StatusLine
from mirrormount.values import HELP as UNITS_HELP
from mirrormount.values import STEPS, UNITS, amount_and_unit, spelled
from mountfw import codes as wire

_LOOK_S = 0.05  # between two looks at a run's status


def step_arguments(parser: argparse.ArgumentParser) -> None:
    """AXIS, N and UNIT."""
    port_options(parser)
    axis_argument(parser)
    parser.add_argument("n", metavar="N", help="a number, such as 5 or -0.25, also with its unit: 100urad")
    _unit_and_approach(parser)


def step(args: argparse.Namespace) -> None:
    """Move by N of a unit, and print how far it went and where it is. Raises MountError."""
    n, unit = _amount(args.n, args.unit, "N")
    with _opened(args) as mount:
        axis = mount.axis(args.axis)
        before = axis.position
        with watched(mount, [axis]) as line:
            aim = f"on the way to {before + n:+.1f}" if unit == STEPS else f"on the way by {n:+g} {unit}"
            made = axis.move_by(n, unit, approach=args.approach, progress=_shown(line, axis, aim))
        print(moved(axis, before, by=_worth(axis, made, unit)))


def move_arguments(parser: argparse.ArgumentParser) -> None:
    """AXIS, POSITION and UNIT."""
    port_options(parser)
    axis_argument(parser)
    parser.add_argument(
        "position", metavar="POSITION", help="a number, such as 5, -0.25 or 2mrad; 0 is where it was zeroed"
    )
    _unit_and_approach(parser)


def move(args: argparse.Namespace) -> None:
    """Move to a position of a unit, which may lie between two steps. Prints as step(). Raises MountError."""
    position, unit = _amount(args.position, args.unit, "POSITION")
    with _opened(args) as mount:
        axis = mount.axis(args.axis)
        before = axis.position
        with watched(mount, [axis]) as line:
            words = f"{position:+g}" if unit == STEPS else f"{position:+g} {unit}"
            shown = _shown(line, axis, f"on the way to {words}")
            axis.move_to(position, unit, approach=args.approach, progress=shown)
        print(moved(axis, before, at=_worth(axis, axis.position * axis.per_step(unit), unit)))


def _amount(text: str, unit: str | None, what: str) -> tuple[float, str]:
    """The number and the unit that were typed, in one word or in two. Raises BadValue."""
    value, unit = amount_and_unit(text, unit)
    return number(value, what), unit


def _worth(axis: Axis, amount: float, unit: str) -> str:
    """An amount that goes by a scale, and whose scale that is if nobody has measured it; "" of steps."""
    return "" if unit == STEPS else ", ".join(filter(None, (f"≈ {amount:+.4g} {unit}", axis.scale_source)))


def _unit_and_approach(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("unit", metavar="UNIT", nargs="?", type=spelled, choices=UNITS, help=UNITS_HELP)
    parser.add_argument(
        "--approach",
        choices=("+", "-"),
        help="the direction of the last part of the way; past the goal and back where it must be",
    )


def home_arguments(parser: argparse.ArgumentParser) -> None:
    """AXIS."""
    port_options(parser)
    axis_argument(parser)


def home(args: argparse.Namespace) -> None:
    """Find the end-stop and print by how much the count was off. Raises MountError."""
    with _opened(args) as mount:
        axis = mount.axis(args.axis)
        with watched(mount, [axis]) as line:
            off = axis.home(progress=_shown(line, axis, "on the way to the end-stop")).discrepancy_steps
        print(f"{axis.name}: at home" + ("" if off is None else f"; the count was off by {off:+.3f} steps"))


def zero_arguments(parser: argparse.ArgumentParser) -> None:
    """AXIS."""
    port_options(parser)
    axis_argument(parser, optional=True)


def zero(args: argparse.Namespace) -> None:
    """Call the present position of an axis, or of all of them, 0, and print what it was. Raises MountError."""
    with open_mount(args) as mount:
        for axis in [mount.axis(args.axis)] if args.axis else list(mount.by_name.values()):
            before = axis.status()
            undo = f"`mirrormount undo {axis.name}` takes it back" if axis.zero() else "there is no undo of it"
            print(f"{axis.name}: 0 is here; it was at {_steps(before.position)} ({before.certainty}). {undo}")


def jog_arguments(parser: argparse.ArgumentParser) -> None:
    """AXIS, SPEED, and for how long."""
    port_options(parser)
    axis_argument(parser)
    parser.add_argument("speed", metavar="SPEED", help="-1 ... 1, of full speed")
    parser.add_argument("--seconds", metavar="S", help=SECONDS_HELP)


def jog(args: argparse.Namespace) -> None:
    """Run one axis at a speed for some seconds, or until Ctrl-C or the board's run limit. Raises MountError."""
    speed, seconds = number(args.speed, "SPEED"), _seconds(args)
    with _opened(args) as mount:
        axis = mount.axis(args.axis)
        _run(mount, [axis], seconds, lambda: axis.jog(speed))


def drive_arguments(parser: argparse.ArgumentParser) -> None:
    """M1, M2, and for how long."""
    port_options(parser)
    parser.add_argument("m1", metavar="M1")
    parser.add_argument("m2", metavar="M2")
    parser.add_argument("--seconds", metavar="S", help=SECONDS_HELP)


def drive(args: argparse.Namespace) -> None:
    """Drive both motors for some seconds, or until Ctrl-C or the board's run limit. Raises MountError."""
    m1, m2, seconds = whole(args.m1, "M1"), whole(args.m2, "M2"), _seconds(args)
    with _opened(args) as mount:
        if m1 == 0 and m2 == 0:
            mount.stop()
            return
        if mount.x.number > 2:
            mount.drive(m1, m2)  # raises NotSupported
        axes = [axis for axis in (mount.x, mount.y) if (m1, m2)[axis.number - 1]]
        _run(mount, axes, seconds, lambda: mount.drive(m1, m2))


def place(axis: Axis, status: AxisStatus | None = None) -> str:
    """Where an axis is: "x: +3.000 steps"."""
    return f"{axis.name}: {(status or axis.status()).position:+.3f} steps"


def moved(axis: Axis, before: float, *, by: str = "", at: str = "") -> str:
    """What a motion has done: "x: moved +3 steps, now at +12 (counted)". by, at: the same two in another unit."""
    now = axis.status()
    way = f"{_steps(now.position - before)} steps{by and f' ({by})'}"
    return f"{axis.name}: moved {way}, now at {_steps(now.position)} ({', '.join(filter(None, (now.certainty, at)))})"


def _steps(count: float) -> str:
    """A number of steps, to the thousandth that the board counts."""
    return f"{round(count, 3) + 0.0:+.10g}"  # + 0.0: no -0


@contextlib.contextmanager
def watched(mount: Mount, axes: Sequence[Axis]) -> Iterator[StatusLine]:
    """A line to show a motion on. A KeyboardInterrupt stops both motors, and then says where the axes are."""
    line = StatusLine()
    try:
        yield line
    except KeyboardInterrupt:
        line.end()
        mount.stop()
        status = mount.status()
        places = [(axis, status.by_name[axis.name]) for axis in axes]
        where = ", ".join(f"{place(axis, at)} ({at.certainty})" for axis, at in places)
        raise KeyboardInterrupt(f"stopped at {where}") from None
    finally:
        line.end()


@contextlib.contextmanager
def _opened(args: argparse.Namespace) -> Iterator[Mount]:
    """The mount that the arguments name. A stop that comes before the motion has begun is for that motion, too."""
    with open_mount(args) as mount, mount.unless_stopped(since_open=True):
        yield mount


def _shown(line: StatusLine, axis: Axis, where_to: str) -> Callable[[AxisStatus], None]:
    return lambda status: line.show(f"{axis.name}: {status.position:+.1f} steps, {where_to}; Ctrl-C stops")


def _run(mount: Mount, axes: Sequence[Axis], seconds: float | None, start: Callable[[], None]) -> None:
    """Start a motion that has no end of its own, and wait until it ends."""
    limit_s = min(axis.run_limit_s for axis in axes)
    if seconds is not None and seconds > limit_s:
        name = next(axis.name for axis in axes if axis.run_limit_s == limit_s)
        raise BadValue(f"the board lets {name} run for {limit_s:g} s at most (setting {name}.run_limit_ms)")
    before = mount.status().by_name
    with watched(mount, axes) as line:
        start()
        ended = _watch_run(mount, axes, seconds, limit_s, line)
    print("; ".join(moved(axis, before[axis.name].position) for axis in axes) + ended)


def _watch_run(mount: Mount, axes: Sequence[Axis], seconds: float | None, limit_s: float, line: StatusLine) -> str:
    """Wait for the end of a run. Returns what is to be said of it; raises MoveEnded if something else ended it."""
    begun = mount.link.monotonic()
    end = math.inf if seconds is None else begun + seconds
    while (left := end - mount.link.monotonic()) > 0:
        mount.sleep(min(_LOOK_S, left))
        status = mount.status()
        if not status.moving:
            return _how_it_ended(mount, axes, limit_s)
        where = ", ".join(f"{axis.name}: {status.by_name[axis.name].position:+.1f} steps" for axis in axes)
        rest_s = min(end, begun + limit_s) - mount.link.monotonic()
        line.show(f"{where}; {max(0.0, rest_s):.0f} s more, Ctrl-C stops")
    mount.stop()
    return ""


def _how_it_ended(mount: Mount, axes: Sequence[Axis], limit_s: float) -> str:
    """The run limit is the bound that a run without --seconds was asked to end at; all else is an error."""
    reasons = [axis.last_move().reason for axis in axes]
    errors = mount.errors()
    if set(reasons) == {wire.RUN_LIMIT}:
        names = " and ".join(f"{axis.name}.run_limit_ms" for axis in axes)
        return f" (the run limit of {limit_s:g} s has ended it: setting {names})"
    whys = [f"{axis.name}: {REASONS.get(reason, reason)}" for axis, reason in zip(axes, reasons, strict=True)]
    ended = MountError(f"the motion ended early: {'; '.join([*whys, *map(str, errors)])}")
    ended.codes = tuple(error.code for error in errors)
    raise ended


def _seconds(args: argparse.Namespace) -> float | None:
    """The value of --seconds, None without it. Raises BadValue."""
    if args.seconds is None:
        return None
    seconds = number(args.seconds, "--seconds")
    if seconds <= 0:
        raise BadValue("--seconds must be more than 0")
    return seconds


COMMANDS = (
    Command(
        "step",
        "move by N steps, or by an angle of the mirror or the beam, or by mm on the screen",
        step,
        step_arguments,
    ),
    Command("move", "move to a position, in steps, or in an angle, or in mm on the screen", move, move_arguments),
    Command("home", "find an axis's end-stop; position 0 is there", home, home_arguments),
    Command("zero", "call the position here 0, of AXIS or of all axes, without motion", zero, zero_arguments),
    Command("jog", "run at SPEED until Ctrl-C or the board's run limit, or for S seconds", jog, jog_arguments),
    Command(
        "drive",
        "drive y (motor 1) at M1 and x (motor 2) at M2 (-255 ... 255) until Ctrl-C or the run limit, or for S seconds",
        drive,
        drive_arguments,
    ),
)
