"""The shell command `mirrormount`: a table of subcommands, each a thin call of the client.

Errors are one line on stderr, with two more for cause and remedy if the board has numbered it, and exit status
1; wrong usage is 2; Ctrl-C stops the motors and is 130. Anything heavy is imported inside the subcommand that needs it.
"""

import argparse
import contextlib
import io
import os
import sys
from pathlib import Path

from mirrormount import Mount, __version__
from mirrormount.cli import motion
from mirrormount.common.errors import REASONS, BadValue, MountError, NotSupported
from mirrormount.common.printable import printable
from mirrormount.common.remedies import explain
from mirrormount.device.arduino_sketch import LIMITS, SketchMount

_LIMITS = {0: "-", 1: "positive", 2: "negative", 3: "both"}

_LONGEST_MESSAGE = 2000  # characters


def main(argv: list[str] | None = None) -> int:
    """Run the command line. Returns the exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal without … or ± shows their numbers
    args = _parser().parse_args(argv)
    try:
        status = args.run(args) or 0
        if sys.stdout:
            sys.stdout.flush()  # what cannot be written is told now, not when Python ends
        return status
    except MountError as e:
        _complain(str(e), *explain(e.codes))
        return 1
    except KeyboardInterrupt as e:
        _complain(str(e) or "stopped")
        return 130
    except BrokenPipeError:
        _abandon_stdout()
        return 1
    except OSError as e:
        _abandon_stdout()
        _complain(f"{e.filename or 'standard output'}: {e.strerror or e}")
        return 1
    except Exception as e:
        if os.environ.get("MIRRORMOUNT_TRACEBACK"):
            raise
        _complain(
            f"a fault of this program, please report it ({type(e).__name__}: {e});"
            " with MIRRORMOUNT_TRACEBACK=1 it says where"
        )
        return 1


def _complain(message: str, *more: str) -> None:
    """Print an error on stderr: one line, in which nothing from outside controls the terminal."""
    if sys.stderr:
        with contextlib.suppress(OSError):
            print("\n".join([f"mirrormount: {printable(message, _LONGEST_MESSAGE)}", *more]), file=sys.stderr)


def _abandon_stdout() -> None:
    """Nobody takes what is printed: without this, Python complains at its end."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="mirrormount",
        description="Drive a motorised mirror mount.",
        epilog="AXIS is x (right +) or y (up +).",
    )
    parser.add_argument("--version", action="version", version=f"mirrormount {__version__}")
    at = argparse.ArgumentParser(add_help=False)
    at.add_argument(
        "--port",
        default=os.environ.get("MIRRORMOUNT_PORT"),
        help="serial port, socket://HOST:PORT or virtual:// (default: $MIRRORMOUNT_PORT, else the one board there is)",
    )
    at.add_argument("--sketch", action="store_true", help="the port is an Arduino that runs the paper's sketch")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, run, what: str, *, port: bool = True) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=what, description=what, parents=[at] if port else [])
        sub.set_defaults(run=run)
        return sub

    add("ports", do_ports, "list the ports that a mount may be at", port=False)
    add("status", do_status, "show what the board knows")
    axis_help = "x (right +) or y (up +)"
    seconds_help = "how long, at most the board's run limit (10 s unless set otherwise)"
    sub = add("step", do_step, "move by N steps (may be negative)")
    sub.add_argument("axis", choices=("x", "y"), help=axis_help)
    sub.add_argument("n", metavar="N", help="steps, a whole number")
    sub = add("move", do_move, "move to a position, in steps")
    sub.add_argument("axis", choices=("x", "y"), help=axis_help)
    sub.add_argument("position", metavar="STEPS", help="a number, such as 5 or -0.25")
    sub = add("home", do_home, "find an axis's end-stop; position 0 is there")
    sub.add_argument("axis", choices=("x", "y"), help=axis_help)
    sub = add("jog", do_jog, "run at SPEED until Ctrl-C or the board's run limit, or for S seconds")
    sub.add_argument("axis", choices=("x", "y"), help=axis_help)
    sub.add_argument("speed", metavar="SPEED", help="-1 ... 1, of full speed")
    sub.add_argument("--seconds", metavar="S", help=seconds_help)
    sub = add(
        "drive",
        do_drive,
        "drive y (motor 1) at M1 and x (motor 2) at M2 (-255 ... 255) until Ctrl-C or the run limit, or for S seconds",
    )
    sub.add_argument("m1", metavar="M1")
    sub.add_argument("m2", metavar="M2")
    sub.add_argument("--seconds", metavar="S", help=seconds_help)
    add("stop", do_stop, "both motors off, now")
    sub = add("send", do_send, "send one command line of docs/protocol.md, for instance 2XI1 or 2TP?")
    sub.add_argument("line", metavar="LINE")
    sub.add_argument(
        "--no-wait",
        dest="wait",
        action="store_false",
        help="do not wait for its motion: it goes on without this program",
    )
    sub = add("config", do_config, "show, change, save, export and import settings", port=False)
    from mirrormount.cli import config  # plain argument lists; nothing heavy

    config.add_arguments(sub, at)
    sub = add("check", do_check, "test the mount step by step; nothing moves without --move")
    sub.add_argument("--move", action="store_true", help="also make a few steps on each axis")
    add("setup", do_setup, "go through a new mount: directions, switches, scale and backlash, with questions")
    sub = add("virtual", do_virtual, "serve a virtual board until Ctrl-C", port=False)
    sub.add_argument(
        "--machine",
        choices=("cpython", "micropython", "rp2040", "circuitpython"),
        default="cpython",
        help="what runs the firmware (circuitpython: its port for those boards, on fake modules)",
    )
    sub.add_argument(
        "--files", type=Path, metavar="FOLDER", help="the board's file system (cpython, circuitpython: what it saves)"
    )
    sub.add_argument(
        "--image", type=Path, metavar="FILE", help="rp2040: the MicroPython or CircuitPython image, .uf2 or .bin"
    )
    sub.add_argument("--flash", type=Path, metavar="FILE", help="rp2040: keeps the flash from run to run")
    sub.add_argument("--link", type=Path, metavar="PATH", help="make PATH a symlink to the board's pty")
    sub.add_argument("--tcp", metavar="PORT", help="listen on this loopback port (0: any that is free)")
    sub.add_argument("--edges", type=Path, metavar="FILE", help="write every pin edge to FILE, one JSON object a line")
    sub.add_argument("--bench", choices=("paper", "switches"), default="paper", help="with or without end-stops")
    sub.add_argument("--board", choices=("pico", "pico_drv8833"), default="pico", help="which H-bridge")
    sub.add_argument("--speed", choices=("1", "max"), default="1", help="max is for virtual://?speed=max only")
    sub = add("serve", do_serve, "put the board on TCP, as a New Focus 8742 on Ethernet, until Ctrl-C", port=False)
    sub.add_argument("at", nargs="?", metavar="PORT", help="serial port (default: the one board there is)")
    sub.add_argument("--port", default=os.environ.get("MIRRORMOUNT_PORT"), help="the same")
    sub.add_argument("--tcp", default="127.0.0.1:23", metavar="HOST:PORT", help="where to listen (port 0: any)")
    sub.add_argument(
        "--no-telnet", dest="telnet", action="store_false", help="no greeting, and no telnet bytes removed"
    )
    sub.add_argument("--token", help="a client's first line must be this (default: $MIRRORMOUNT_TOKEN)")
    sub.add_argument("--token-file", type=Path, metavar="FILE", help="the same, from a file's first line")
    sub.add_argument(
        "--on-leave",
        choices=("stop", "finish"),
        default="stop",
        help="when a client goes: stop what moves, or finish moves of known length (PR, PA, XU, OR, MT)",
    )
    sub = add("panel", do_panel, "the web panel: drive the mount from a browser, until Ctrl-C", port=False)
    sub.add_argument("at", nargs="?", metavar="PORT", help="serial port (default: the one board there is)")
    sub.add_argument("--port", default=os.environ.get("MIRRORMOUNT_PORT"), help="the same")
    sub.add_argument("--virtual", action="store_true", help="a virtual board, with its screen; no hardware needed")
    sub.add_argument(
        "--host", default="127.0.0.1", help="where to listen; 0.0.0.0: all networks of this computer, with a token"
    )
    sub.add_argument("--http", metavar="PORT", help="the web server's port (default: 8080, or the next free one)")
    sub.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help="the token is FILE's first line (default: $MIRRORMOUNT_TOKEN, or made where one is needed)",
    )
    sub.add_argument("--token", help="the token itself; other users see it in the list of processes")
    sub.add_argument(
        "--patience", default="0.35", metavar="S", help="stop what a page drives when it is silent for so long (0.35)"
    )
    sub.add_argument("--no-browser", dest="browser", action="store_false", help="do not open the browser")
    sub = add("deploy", do_deploy, "put the firmware on a board that runs MicroPython or CircuitPython", port=False)
    _add_deploy_port(sub)
    sub.add_argument("--source", action="store_true", help="plain .py files instead of compiled ones")
    which = sub.add_mutually_exclusive_group()
    which.add_argument("--board", metavar="NAME", help="use mountfw/boards/NAME.py instead of the board's own")
    which.add_argument("--pins", type=Path, metavar="FILE", help="use this board file (see mountfw/boards/pico.py)")
    sub.add_argument(
        "--replace-main", action="store_true", help="replace somebody else's main.py or code.py (a copy stays)"
    )
    sub = add("undeploy", do_undeploy, "take off a board what deploy has put there", port=False)
    _add_deploy_port(sub)
    sub = add("repl", do_repl, "the board's own Python prompt, with the mount at it as m", port=False)
    sub.add_argument("at", nargs="?", metavar="PORT", help="serial port (default: the one board there is)")
    sub.add_argument("--port", default=os.environ.get("MIRRORMOUNT_PORT"), help="the same")
    sub = add("demo", do_demo, "the paper's square on a virtual board, measured and drawn", port=False)
    sub.add_argument("--output", type=Path, default=Path("square.png"), metavar="FILE", help="the picture")
    sub.add_argument("--port", default="virtual://?speed=max", help="a virtual:// address with other options")
    sub.add_argument(
        "--machine", choices=("cpython", "micropython", "rp2040", "circuitpython"), help="what runs the firmware"
    )
    return parser


def _add_deploy_port(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("at", nargs="?", metavar="PORT", help="serial port (default: the one board there is)")
    sub.add_argument("--port", default=os.environ.get("MIRRORMOUNT_PORT"), help="the same")
    sub.add_argument(
        "--drive", type=Path, metavar="PATH", help="a CircuitPython board's drive (default: the one there is)"
    )
    sub.add_argument("--stop", action="store_true", help="stop the motors first if they move")


def _open(args: argparse.Namespace):
    if args.sketch:
        if args.port is None:
            raise BadValue("an Arduino's port must be named: --port PORT --sketch")
        return SketchMount.open(args.port)
    return Mount.open(args.port)


def _open_mount(args: argparse.Namespace) -> Mount:
    """A mount with mountfw on it."""
    if args.sketch:
        raise NotSupported(f"`{args.command}` needs mountfw on the board: {LIMITS}")
    return Mount.open(args.port)


def _whole(text: str, what: str) -> int:
    try:
        if not text.isascii():
            raise ValueError
        return int(text)
    except ValueError:
        raise BadValue(f"{what} is a whole number, not {text!r}") from None


def _number(text: str, what: str) -> float:
    try:
        if not text.isascii():
            raise ValueError
        value = float(text)
    except ValueError:
        raise BadValue(f"{what} is a number, not {text!r}") from None
    if not abs(value) <= 1e6:
        raise BadValue(f"{what} is out of range: {text}")
    return value


def do_ports(_args: argparse.Namespace) -> None:
    """List boards with known USB ids."""
    from mirrormount.transport.find import find

    found = find()
    for device, what in found:
        print(f"{printable(device)}  {printable(what)}")
    if not found:
        print("no board found; a virtual one is always there: --port virtual://")


def do_status(args: argparse.Namespace) -> None:
    """Print identity, axes and errors."""
    with _open(args) as mount:
        if isinstance(mount, SketchMount):
            print(LIMITS)
            return
        status = mount.status()
        print(mount.identity)
        for name in ("x", "y"):
            axis = getattr(status, name)
            print(
                f"{name}: {axis.position:+.3f} steps ({axis.certainty}),"
                f" {'moving' if axis.moving else 'at rest'}, last move: {REASONS.get(axis.reason, axis.reason)},"
                f" end-stops: {_LIMITS[axis.limits & 3]}"
            )
        for error in mount.take_errors():
            print(f"error {error}")


def do_step(args: argparse.Namespace) -> None:
    """Move by steps."""
    n = _whole(args.n, "N")
    with _open(args) as mount:
        motion.step(mount, args.axis, n)


def do_move(args: argparse.Namespace) -> None:
    """Move to a position."""
    position = _number(args.position, "STEPS")
    with _open(args) as mount:
        motion.move(mount, args.axis, position)


def do_home(args: argparse.Namespace) -> None:
    """Home an axis."""
    with _open(args) as mount:
        motion.home(mount, args.axis)


def do_jog(args: argparse.Namespace) -> None:
    """Run one axis."""
    speed = _number(args.speed, "SPEED")
    seconds = motion.seconds_of(args, _number)
    with _open(args) as mount:
        motion.jog(mount, args.axis, speed, seconds)


def do_drive(args: argparse.Namespace) -> None:
    """Drive both motors."""
    m1, m2 = _whole(args.m1, "M1"), _whole(args.m2, "M2")
    seconds = motion.seconds_of(args, _number)
    with _open(args) as mount:
        motion.drive(mount, m1, m2, seconds)


def do_stop(args: argparse.Namespace) -> None:
    """Stop, also when another program has the port."""
    if args.sketch:
        with _open(args):  # opening already stops, and says so if it could not
            pass
        print("stopped")
        return
    from mirrormount.cli.stop import run

    run(args.port)


def do_send(args: argparse.Namespace) -> None:
    """Send one line, print its answers, and wait for the motion that it starts."""
    from mirrormount.cli import send

    mount = _open(args)
    with mount if args.wait else contextlib.closing(mount):
        if isinstance(mount, SketchMount):
            raise NotSupported(f"no command lines: {LIMITS}")
        (send.run if args.wait else send.start)(mount, args.line)


def do_config(args: argparse.Namespace) -> None:
    """Show and change settings."""
    from mirrormount.cli import config

    config.check_arguments(args)
    with _open_mount(args) as mount:
        config.run(mount, args)


def do_check(args: argparse.Namespace) -> None:
    """Test the mount."""
    from mirrormount.cli.check import run

    run(lambda: _open_mount(args), move=args.move)


def do_setup(args: argparse.Namespace) -> None:
    """Go through a new mount."""
    from mirrormount.cli.setup import run

    with _open_mount(args) as mount:
        run(mount)


def do_virtual(args: argparse.Namespace) -> None:
    """Serve a virtual board."""
    from mirrormount.cli.virtual import run

    run(args)


def do_serve(args: argparse.Namespace) -> None:
    """Serve a board on TCP."""
    from mirrormount.network.server import run

    run(args)


def do_panel(args: argparse.Namespace) -> None:
    """Serve the web panel."""
    from mirrormount.cli.panel import run

    run(args)


def do_deploy(args: argparse.Namespace) -> None:
    """Put the firmware on a board."""
    from mirrormount.deploy.micropython import Options, deploy

    port = args.at or args.port
    print(deploy(Options(port, args.stop, args.source, args.board, args.pins, args.replace_main, args.drive)))


def do_undeploy(args: argparse.Namespace) -> None:
    """Take the firmware off a board."""
    from mirrormount.deploy.micropython import Options, undeploy

    print(undeploy(Options(args.at or args.port, args.stop, drive=args.drive)))


def do_repl(args: argparse.Namespace) -> None:
    """Open the board's prompt."""
    from mirrormount.cli.repl import run

    run(args.at or args.port)


def do_demo(args: argparse.Namespace) -> None:
    """Run the demo."""
    from mirrormount.cli.demo import run

    machine = f"{'&' if '?' in args.port else '?'}machine={args.machine}" if args.machine else ""
    run(args.port + machine, args.output)
