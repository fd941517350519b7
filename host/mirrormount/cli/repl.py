"""`mirrormount repl`: the board's own Python prompt, by board_prompt.py."""

import argparse

from mirrormount.cli.command import Command, board_port, port_of


def run(args: argparse.Namespace) -> None:
    """Open the prompt in this terminal; the firmware starts again after it. Raises MountError."""
    from mirrormount.cli.board_prompt import open_prompt
    from mirrormount.common.signals import ended_in_order

    with ended_in_order():
        open_prompt(port_of(args))


COMMANDS = (Command("repl", "the board's own Python prompt, with the mount at it as m", run, board_port),)
