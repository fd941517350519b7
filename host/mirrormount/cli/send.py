"""`mirrormount send`: one command line to the board, by command_line.py."""

import argparse
import contextlib

from mirrormount.cli.command import Command, open_mount, port_options


def arguments(parser: argparse.ArgumentParser) -> None:
    """LINE, and whether the motion that it starts is awaited."""
    port_options(parser)
    parser.add_argument("line", metavar="LINE")
    parser.add_argument(
        "--no-wait",
        dest="wait",
        action="store_false",
        help="do not wait for its motion: it goes on without this program",
    )


def run(args: argparse.Namespace) -> None:
    """Send the line, print its answers, and wait for the motion that it starts. Raises MountError."""
    from mirrormount.cli import command_line

    mount = open_mount(args)
    # a stop that comes before the line is for its motion, too
    with mount if args.wait else contextlib.closing(mount), mount.unless_stopped(since_open=True):
        (command_line.send if args.wait else command_line.start)(mount, args.line)


COMMANDS = (Command("send", "send one command line of docs/protocol.md, for instance 2XI1 or 2TP?", run, arguments),)
