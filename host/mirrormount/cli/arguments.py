"""The form of a command, and the arguments that several commands share.

Every command's file imports this one, `mirrormount stop` included, so that it imports at its top only what is quickly
imported: a stop must not wait.
"""

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mirrormount.errors import BadValue, ExtraMissing
from mirrormount.values import LEAST_PATIENCE_S, MOST_PATIENCE_S, PATIENCE_S, is_axis, typed_number

if TYPE_CHECKING:
    from mirrormount.device.mount import Mount
    from mirrormount.device.table_file import CameraSettings

AXIS_HELP = "x (right +), y (up +), or a further one: axis3 …"
SECONDS_HELP = "how long, at most the board's run limit (10 s unless set otherwise)"
PORT_VARIABLE = "MIRRORMOUNT_PORT"  # of the environment: the port where none is named
_LARGEST = 1_000_000
_DEFAULT_PORT = "serial port, or a mount's name (default: the one board there is)"


class PortOfEnvironment(str):
    """A port that nobody has typed: PORT_VARIABLE names it, and an error that names it says so."""


class Command(NamedTuple):
    """One row of the table of commands.

    arguments(parser) adds the command's own; run(arguments) does the work, returns the exit status (None: 0) and may
    raise MountError.
    """

    name: str
    summary: str
    run: Callable[[argparse.Namespace], int | None]
    arguments: Callable[[argparse.ArgumentParser], None]


@contextlib.contextmanager
def from_extra(extra: str, what: str) -> Iterator[None]:
    """For the imports of a command that needs an optional part of mirrormount. Raises ExtraMissing."""
    from mirrormount.terminal import install_command

    try:
        yield
    except ModuleNotFoundError as e:
        raise ExtraMissing(f"{what} a package that is not installed ({e.name}): {install_command(extra)}") from e


def page_of(command: str) -> Callable[..., Any]:
    """What serves the web page of a command: an entry point of the group mirrormount.pages. Raises ExtraMissing."""
    return _of_other_package("mirrormount.pages", command, "a page needs")


def spot_of(mount: "Mount", args: argparse.Namespace) -> Any:
    """The spot in the camera of the arguments, for a mount: an entry point of the group mirrormount.spots.

    Raises ExtraMissing, and what opening a camera raises.
    """
    return _of_other_package("mirrormount.spots", "kept", "--camera needs")(mount, args)


def _of_other_package(group: str, name: str, what: str) -> Any:
    from importlib.metadata import entry_points

    (point,) = entry_points(group=group, name=name)
    with from_extra(",".join(point.extras), what):
        return point.load()


def no_work(_args: argparse.Namespace) -> None:
    """For a command that cannot run here."""


def no_arguments(_parser: argparse.ArgumentParser) -> None:
    """For a command that takes none."""


def table_option(parser: argparse.ArgumentParser) -> None:
    """--table: which file has the names of mounts and cameras. main() hands it on."""
    parser.add_argument(
        "--table",
        metavar="FILE",
        default=argparse.SUPPRESS,  # it may also stand before the command
        help="the file of names (default: $MIRRORMOUNT_TABLE, else table.toml in the user's folder)",
    )


def _port_of_environment() -> PortOfEnvironment | None:
    port = os.environ.get(PORT_VARIABLE)
    return None if port is None else PortOfEnvironment(port)


def whence(args: argparse.Namespace, told: str) -> str:
    """To follow an error: where its port comes from, if nobody has typed it; else ""."""
    port = getattr(args, "port", None)
    if getattr(args, "at", None) or not isinstance(port, PortOfEnvironment) or port not in told:
        return ""
    return f"; {PORT_VARIABLE} names that port"


def port_options(parser: argparse.ArgumentParser) -> None:
    """--port and --table, for commands that run on a mount."""
    table_option(parser)
    parser.add_argument(
        "--port",
        default=_port_of_environment(),
        help=f"serial port, a mount's name, socket://HOST:PORT or virtual:// (default: ${PORT_VARIABLE}, else the one)",
    )


DEFAULT_PROFILE = "hardware"  # of commands; an address, such as virtual://, that names none is smooth


def profile_options(parser: argparse.ArgumentParser) -> None:
    """--profile and --seed of a virtual board."""
    parser.add_argument(
        "--profile",
        choices=("smooth", "rough", "hardware"),
        help="virtual: kind mechanics, those of a mount of hobby parts, or those of real actuators as far as they are"
        f" known (default: {DEFAULT_PROFILE})",
    )
    parser.add_argument("--seed", metavar="N", help="virtual: another seed is another mount of that profile (1)")


def virtual_options(parser: argparse.ArgumentParser, what: str) -> None:
    """--virtual, and which kind. See virtual_address."""
    parser.add_argument("--virtual", action="store_true", help=what)
    profile_options(parser)


def camera_options(parser: argparse.ArgumentParser) -> None:
    """What a camera is asked for, and selection_options; for a command that opens one, or names one.

    camera_settings() reads them.
    """
    asked = parser.add_argument_group("what a webcam is asked for (default: as table.toml says, else as the camera is)")
    asked.add_argument("--backend", metavar="NAME", help="v4l2, dshow, msmf or any (v4l2 on Linux, dshow on Windows)")
    asked.add_argument("--fourcc", metavar="CODE", help="how pictures come over the cable: MJPG, YUYV …")
    asked.add_argument("--size", metavar="WxH", help="pixels, such as 1280x720")
    asked.add_argument("--exposure", metavar="N", help="number of the driver: 0.1 ms on Linux, a power of 2 on Windows")
    asked.add_argument("--gain", metavar="N", help="number of the driver")
    selection_options(parser)


def selection_options(parser: argparse.ArgumentParser) -> None:
    """--roi, --mask, --channel and --contrast: what of a picture is looked at. camera_settings() reads them."""
    looked = parser.add_argument_group("what of a picture is looked at (default: as table.toml says, else all of it)")
    looked.add_argument("--roi", metavar="X,Y,W,H", help="a region: its top left pixel, width and height in pixels")
    looked.add_argument(
        "--mask", metavar="FILE", help="a picture of the same size: where it is white nothing is looked at"
    )
    looked.add_argument(
        "--channel",
        metavar="NAME",
        help="red, green, blue, grey (their largest), or automatic, the brightest that is not saturated (default)",
    )
    looked.add_argument("--contrast", metavar="N", help="grey values of a spot's peak above its surroundings, at least")


def camera_settings(args: argparse.Namespace) -> "CameraSettings":
    """What camera_options' or selection_options' arguments ask for. Raises BadValue.

    A virtual camera has nothing that a webcam is asked for.
    """
    from mirrormount.device.table_file import CameraSettings

    names = ("backend", "fourcc", "size", "exposure", "gain", "roi", "mask", "channel", "contrast")
    given = {name: value for name in names if (value := getattr(args, name, None)) is not None}
    if getattr(args, "virtual", False) and (of_webcam := [name for name in given if name in names[:5]]):
        raise BadValue(f"--{' and --'.join(of_webcam)}: of a webcam; leave --virtual out")
    if "size" in given:
        given["width_px"], given["height_px"] = _size(given.pop("size"))
    if "fourcc" in given:
        given["fourcc"] = given["fourcc"].ljust(4)  # Y16 has a space at its end
    if "mask" in given:
        given["mask"] = os.path.abspath(given["mask"])  # table.toml may keep it
    for name in ("exposure", "gain", "contrast"):
        if name in given:
            given[name] = number(given[name], f"--{name}")
    return CameraSettings(**given)


def _size(text: str) -> tuple[int, int]:
    width, mark, height = text.lower().partition("x")
    if not mark:
        raise BadValue(f"--size is width x height in pixels, such as 1280x720, not {text!r}")
    return whole(width, "the width of --size"), whole(height, "the height of --size")


def mount_and_camera(parser: argparse.ArgumentParser) -> None:
    """--port and --camera of a command that looks at what one mount does, and virtual_options for both."""
    parser.add_argument("--port", default=_port_of_environment(), help="the mount (default: the only board)")
    parser.add_argument(
        "--camera",
        metavar="CAMERA",
        help="as `mirrormount camera` takes it (default: $MIRRORMOUNT_CAMERA, else 0); with --virtual: 1 or 2",
    )
    camera_options(parser)
    virtual_options(parser, "a virtual mount, table and camera, as fast as it goes; no hardware needed")


def virtual_address(args: argparse.Namespace, scheme: str = "virtual", **options: str) -> str | None:
    """The address that virtual_options' arguments name, with further options of the address. None without --virtual.

    scheme: virtual, or virtual-table.
    Raises BadValue for a profile, a seed or an encoder of a real board.
    """
    given = {name: value for name in ("profile", "seed", "encoder") if (value := getattr(args, name, None)) is not None}
    options |= given
    if not args.virtual:
        if given:
            raise BadValue(f"--{' and --'.join(given)}: of a virtual board; add --virtual")
        return None
    from urllib.parse import urlencode

    return f"{scheme}://?{urlencode({'profile': DEFAULT_PROFILE} | options)}"


def virtual_camera(given: str | None) -> int:
    """Which camera --camera with --virtual names: 1 or 2. Raises BadValue."""
    which = whole("1" if given is None else given, "--camera with --virtual")
    if which not in (1, 2):
        raise BadValue(f"the virtual table has the cameras 1 and 2, not {which}")
    return which


def note(text: str) -> None:
    """Tell on stderr what is no error."""
    print(f"note: {text}", file=sys.stderr)


def open_option(parser: argparse.ArgumentParser) -> None:
    """--open, of a command that writes a page; tell_page() does it."""
    parser.add_argument("--open", action="store_true", help="open the page in the browser at the end")


def tell_page(page: Path, opens: bool) -> None:
    """The last line of a command that has written a page: which file to open. opens: a browser shows it."""
    print(f"open {page}", flush=True)
    if opens:
        import webbrowser

        if not webbrowser.open(page.resolve().as_uri()):
            note("no browser was found here")


def said_yes(question: str) -> bool:
    """Ask the person. No answer is no, and so is nobody at a terminal."""
    if not (sys.stdin and sys.stdin.isatty()):
        return False
    try:
        return input(f"{question} [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        return False


def board_port(parser: argparse.ArgumentParser) -> None:
    """The port of a board that the command needs for itself: PORT, or --port, and --table. See port_of."""
    table_option(parser)
    parser.add_argument("at", nargs="?", metavar="PORT", help=_DEFAULT_PORT)
    parser.add_argument("--port", default=_port_of_environment(), help="the same")


def port_of(args: argparse.Namespace) -> str | None:
    """The port that board_port's arguments name, or None. Raises as table_file.find_port()."""
    from mirrormount.device.table_file import find_port

    given = args.at or args.port
    return None if given is None else find_port(given).address


def web_options(parser: argparse.ArgumentParser) -> None:
    """Where a page is served, and its token. The panel's package reads them."""
    parser.add_argument(
        "--host", default="127.0.0.1", help="where to listen; 0.0.0.0: all networks of this computer, with a token"
    )
    parser.add_argument("--http", metavar="PORT", help="the web server's port (default: 8080, or the next free one)")
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help="the token is FILE's first line (default: $MIRRORMOUNT_TOKEN, or made where one is needed)",
    )
    parser.add_argument("--token", help="the token itself; other users see it in the list of processes")
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="do not open the browser")


def patience_option(parser: argparse.ArgumentParser, whose: str, default_s: float = PATIENCE_S) -> None:
    """--patience: after which silence of a client its motion is stopped; patience_of() reads it."""
    parser.add_argument(
        "--patience",
        default=f"{default_s:g}",
        metavar="S",
        help=f"stop what {whose} drives when it is silent for so long ({default_s:g})",
    )


def patience_of(args: argparse.Namespace) -> float:
    """The patience in seconds. Raises BadValue."""
    with contextlib.suppress(ValueError):
        if LEAST_PATIENCE_S <= (seconds := typed_number(args.patience, "--patience")) <= MOST_PATIENCE_S:
            return seconds
    raise BadValue(f"--patience is {LEAST_PATIENCE_S:g} to {MOST_PATIENCE_S:g} seconds, not {args.patience!r}")


def _axis(text: str) -> str:
    if not is_axis(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no axis: choose x, y, or axis3 … of a board with more")
    return text


def axis_argument(parser: argparse.ArgumentParser, *, optional: bool = False) -> None:
    """AXIS; optional: None without it."""
    parser.add_argument("axis", type=_axis, metavar="AXIS", nargs="?" if optional else None, help=AXIS_HELP)


def open_mount(args: argparse.Namespace) -> "Mount":
    """The mount that port_options' arguments name. Raises MountError."""
    from mirrormount.device.mount import Mount

    return Mount.open(args.port)


def whole(text: str, what: str) -> int:
    """A whole number as it was typed. Raises BadValue."""
    try:
        if not text.isascii() or "_" in text:
            raise ValueError
        return int(text)
    except ValueError:
        raise BadValue(f"{what} is a whole number, not {text!r}") from None


def number(text: str, what: str) -> float:
    """A number as it was typed, at most _LARGEST in magnitude. Raises BadValue."""
    value = typed_number(text, what)
    if not abs(value) <= _LARGEST:
        raise BadValue(f"{what} is out of range: within -{_LARGEST} … {_LARGEST}, not {text}")
    return value


def positive(text: str, what: str) -> float:
    """A number above 0, as number(). Raises BadValue."""
    value = number(text, what)
    if not value > 0:
        raise BadValue(f"{what} is more than 0, not {text}")
    return value
