"""`mirrormount demo`: the paper's square on a virtual board, by demo_square.py."""

import argparse
from pathlib import Path

from mirrormount.cli.command import Command


def arguments(parser: argparse.ArgumentParser) -> None:
    """The picture's file, and which virtual board."""
    parser.add_argument("--output", type=Path, default=Path("square.png"), metavar="FILE", help="the picture")
    parser.add_argument("--port", default="virtual://?speed=max", help="a virtual:// address with other options")
    parser.add_argument(
        "--machine", choices=("cpython", "micropython", "rp2040", "circuitpython"), help="what runs the firmware"
    )


def run(args: argparse.Namespace) -> None:
    """Drive the square, print the tables, draw the picture. Raises DemoFailed if a figure is not the paper's."""
    from mirrormount.cli.demo_square import demonstrate

    machine = f"{'&' if '?' in args.port else '?'}machine={args.machine}" if args.machine else ""
    demonstrate(args.port + machine, args.output)


COMMANDS = (Command("demo", "the paper's square on a virtual board, measured and drawn", run, arguments),)
