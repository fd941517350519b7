"""`mirrormount flash`: an empty board to a mount in one command, or one .uf2 for many boards."""

import argparse
from pathlib import Path
from typing import Any

from mirrormount.cli.arguments import Command, board_port, from_extra, port_of, said_yes
from mirrormount.cli.config import import_, load
from mirrormount.errors import BadValue
from mirrormount.terminal import Progress, ended_in_order
from mountfw import settings as declared


def arguments(parser: argparse.ArgumentParser) -> None:
    """Which board, which image, which firmware; or the file to write."""
    board_port(parser)
    parser.add_argument(
        "--drive",
        type=Path,
        metavar="PATH",
        help="the drive of its boot loader (default: the one there is)",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--image", type=Path, metavar="FILE", help="MicroPython for the board (default: fetched once)")
    which.add_argument("--offline", action="store_true", help="fetch nothing; say what to fetch, and where to put it")
    parser.add_argument("--yes", action="store_true", help="do not ask before what runs on a board is replaced")
    parser.add_argument("--stop", action="store_true", help="stop the motors first if they move")
    pins = parser.add_mutually_exclusive_group()
    pins.add_argument("--board", metavar="NAME", help="use mountfw/boards/NAME.py instead of the board's own")
    pins.add_argument("--pins", type=Path, metavar="FILE", help="use this board file (see mountfw/boards/pico.py)")
    parser.add_argument("--replace-main", action="store_true", help="replace somebody else's main.py (a copy stays)")
    parser.add_argument("--settings", metavar="FILE", help="and keep these settings on the board (config export)")
    parser.add_argument(
        "--uf2", type=Path, metavar="OUT.uf2", help="flash nothing: write one file to drop on many boards (RP2040)"
    )


def run(args: argparse.Namespace) -> None:
    """Flash, deploy, check; or write the file. Raises MountError."""
    from mirrormount.deploy.prompt import Options

    settings = load(args.settings) if args.settings else {}
    options = Options(None, args.stop, False, args.board, args.pins, args.replace_main, args.drive)
    with from_extra("flash", "`mirrormount flash` needs"), ended_in_order():
        if args.uf2 is None:
            _flash(args, options, settings)
        else:
            _write(args, options, settings)


def _flash(args: argparse.Namespace, options: Any, settings: dict[str, Any]) -> None:
    from dataclasses import replace

    from mirrormount.cli.check import run_checks
    from mirrormount.deploy.flash import flash
    from mirrormount.device.mount import Mount

    port, line = flash(
        replace(options, port=port_of(args)), args.image, args.offline, lambda q: args.yes or said_yes(q)
    )
    print(line, flush=True)
    if port is None:
        return
    if settings:
        with Mount.open(port) as mount:
            import_(mount, settings, save=True)
    run_checks(lambda: Mount.open(port), move=False)


def _write(args: argparse.Namespace, options: Any, settings: dict[str, Any]) -> None:
    from mirrormount import files
    from mirrormount.deploy import uf2
    from mirrormount.deploy.flash import fetch
    from mirrormount.deploy.one_file import one_file
    from mirrormount.device.settings import saved_file
    from mirrormount.supported import text
    from mountfw import __version__

    if args.at or args.drive:
        raise BadValue("--uf2 writes a file and flashes no board: leave PORT and --drive out")
    if args.image and args.uf2.exists() and args.image.exists() and args.uf2.samefile(args.image):
        raise BadValue(f"{args.uf2} is the image itself: name another file with --uf2")
    files.check_writable(args.uf2)
    more = {declared.FILE: saved_file(settings)} if settings else {}
    image = uf2.read_image(args.image or fetch("RP2040", args.offline, Progress()))
    made = one_file(image, options, more)
    files.write_atomic(args.uf2, made)
    kept = f", {sum(map(len, settings.values()))} settings" if settings else ""
    print(
        f"OK: {args.uf2}, {len(made) >> 10} KB: MicroPython {text(image.version)}, mountfw {__version__}{kept}, for a"
        f" {image.machine}. Hold BOOTSEL while plugging in, and drop it on the drive RPI-RP2; all files that are on the"
        " board go"
    )


COMMANDS = (Command("flash", "put MicroPython and the firmware on a board, or into one .uf2 for many", run, arguments),)
