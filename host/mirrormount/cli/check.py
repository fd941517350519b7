"""`mirrormount check`: the self-test of self_test.py."""

import argparse

from mirrormount.cli.command import Command, open_mount, port_options


def arguments(parser: argparse.ArgumentParser) -> None:
    """--move, and the port."""
    port_options(parser)
    parser.add_argument("--move", action="store_true", help="also make a few steps on each axis")


def run(args: argparse.Namespace) -> None:
    """Print one line a check. Raises CheckFailed if one failed."""
    from mirrormount.cli.self_test import run_checks
    from mirrormount.common.signals import ended_in_order

    with ended_in_order():
        run_checks(lambda: open_mount(args), move=args.move)


COMMANDS = (Command("check", "test the mount step by step; nothing moves without --move", run, arguments),)
