"""`mirrormount ports`: the ports of boards with known USB ids."""

import argparse

from mirrormount.cli.command import Command, no_arguments


def run(_args: argparse.Namespace) -> None:
    """Print one line a port."""
    from mirrormount.common.printable import printable
    from mirrormount.transport.find import find

    found = find()
    for device, what in found:
        print(f"{printable(device)}  {printable(what)}")
    if not found:
        print("no board found; a virtual one is always there: --port virtual://")


COMMANDS = (Command("ports", "list the ports that a mount may be at", run, no_arguments),)
