"""`mirrormount undeploy`: the firmware off a board."""

import argparse

from mirrormount.cli.command import Command, port_of
from mirrormount.cli.deploy import board_options


def run(args: argparse.Namespace) -> None:
    """Remove the files that deploy has put there, and print the outcome in one line. Raises MountError."""
    from mirrormount.common.signals import ended_in_order
    from mirrormount.deploy.micropython import Options, undeploy

    with ended_in_order():
        print(undeploy(Options(port_of(args), args.stop, drive=args.drive)))


COMMANDS = (Command("undeploy", "take off a board what deploy has put there", run, board_options),)
