"""`mirrormount deploy`: the firmware onto a board."""

import argparse
from pathlib import Path

from mirrormount.cli.command import Command, board_port, port_of


def board_options(parser: argparse.ArgumentParser) -> None:
    """Which board, and whether its motors may be stopped: for deploy and undeploy."""
    board_port(parser)
    parser.add_argument(
        "--drive", type=Path, metavar="PATH", help="a CircuitPython board's drive (default: the one there is)"
    )
    parser.add_argument("--stop", action="store_true", help="stop the motors first if they move")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Which board, which firmware, and whether another program on the board may be replaced."""
    board_options(parser)
    parser.add_argument("--source", action="store_true", help="plain .py files instead of compiled ones")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--board", metavar="NAME", help="use mountfw/boards/NAME.py instead of the board's own")
    which.add_argument("--pins", type=Path, metavar="FILE", help="use this board file (see mountfw/boards/pico.py)")
    parser.add_argument(
        "--replace-main", action="store_true", help="replace somebody else's main.py or code.py (a copy stays)"
    )


def run(args: argparse.Namespace) -> None:
    """Deploy, and print the outcome in one line. Raises MountError; the board then has the firmware that it had."""
    from mirrormount.common.signals import ended_in_order
    from mirrormount.deploy.micropython import Options, deploy

    options = Options(port_of(args), args.stop, args.source, args.board, args.pins, args.replace_main, args.drive)
    with ended_in_order():
        print(deploy(options))


COMMANDS = (Command("deploy", "put the firmware on a board that runs MicroPython or CircuitPython", run, arguments),)
