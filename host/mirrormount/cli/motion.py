"""The commands that move: step, move, home, jog, drive. moving.py does the work."""

import argparse
import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from mirrormount.cli.command import SECONDS_HELP, Command, axis_argument, number, open_mount, port_options, whole
from mirrormount.common.errors import BadValue
from mirrormount.common.units import HELP as UNITS_HELP
from mirrormount.common.units import STEPS, UNITS

if TYPE_CHECKING:
    from mirrormount.device.mount import Mount


@contextlib.contextmanager
def _opened(args: argparse.Namespace) -> "Iterator[Mount]":
    """The mount that the arguments name. A stop that comes before the motion has begun is for that motion, too."""
    with open_mount(args) as mount, mount.unless_stopped(since_open=True):
        yield mount


def step_arguments(parser: argparse.ArgumentParser) -> None:
    """AXIS, N and UNIT."""
    port_options(parser)
    axis_argument(parser)
    parser.add_argument("n", metavar="N", help="a number, such as 5 or -0.25")
    parser.add_argument("unit", metavar="UNIT", nargs="?", default=STEPS, choices=UNITS, help=UNITS_HELP)


def step(args: argparse.Namespace) -> None:
    """Move by N of a unit and print the position. Raises MountError."""
    from mirrormount.cli import moving

    n = number(args.n, "N")
    with _opened(args) as mount:
        moving.step(mount, args.axis, n, args.unit)


def move_arguments(parser: argparse.ArgumentParser) -> None:
    """AXIS, POSITION and UNIT."""
    port_options(parser)
    axis_argument(parser)
    parser.add_argument("position", metavar="POSITION", help="a number, such as 5 or -0.25; 0 is where it was zeroed")
    parser.add_argument("unit", metavar="UNIT", nargs="?", default=STEPS, choices=UNITS, help=UNITS_HELP)


def move(args: argparse.Namespace) -> None:
    """Move to a position and print it. Raises MountError."""
    from mirrormount.cli import moving

    position = number(args.position, "POSITION")
    with _opened(args) as mount:
        moving.move(mount, args.axis, position, args.unit)


def home_arguments(parser: argparse.ArgumentParser) -> None:
    """AXIS."""
    port_options(parser)
    axis_argument(parser)


def home(args: argparse.Namespace) -> None:
    """Home an axis. Raises MountError."""
    from mirrormount.cli import moving

    with _opened(args) as mount:
        moving.home(mount, args.axis)


def jog_arguments(parser: argparse.ArgumentParser) -> None:
    """AXIS, SPEED, and for how long."""
    port_options(parser)
    axis_argument(parser)
    parser.add_argument("speed", metavar="SPEED", help="-1 ... 1, of full speed")
    parser.add_argument("--seconds", metavar="S", help=SECONDS_HELP)


def jog(args: argparse.Namespace) -> None:
    """Run one axis. Raises MountError."""
    from mirrormount.cli import moving

    speed, seconds = number(args.speed, "SPEED"), _seconds(args)
    with _opened(args) as mount:
        moving.jog(mount, args.axis, speed, seconds)


def drive_arguments(parser: argparse.ArgumentParser) -> None:
    """M1, M2, and for how long."""
    port_options(parser)
    parser.add_argument("m1", metavar="M1")
    parser.add_argument("m2", metavar="M2")
    parser.add_argument("--seconds", metavar="S", help=SECONDS_HELP)


def drive(args: argparse.Namespace) -> None:
    """Drive both motors. Raises MountError."""
    from mirrormount.cli import moving

    m1, m2, seconds = whole(args.m1, "M1"), whole(args.m2, "M2"), _seconds(args)
    with _opened(args) as mount:
        moving.drive(mount, m1, m2, seconds)


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
    Command("jog", "run at SPEED until Ctrl-C or the board's run limit, or for S seconds", jog, jog_arguments),
    Command(
        "drive",
        "drive y (motor 1) at M1 and x (motor 2) at M2 (-255 ... 255) until Ctrl-C or the run limit, or for S seconds",
        drive,
        drive_arguments,
    ),
)
