"""`mirrormount panel`: the web panel, by panel_opening.py."""

import argparse

from mirrormount.cli.command import Command, board_port, patience_option, virtual_options, web_options


def arguments(parser: argparse.ArgumentParser) -> None:
    """Which board, where to listen, and the token."""
    board_port(parser)
    virtual_options(parser, "a virtual board, with its screen; no hardware needed")
    parser.add_argument("--mounts", choices=("1", "2"), help="virtual: how many (1)")
    parser.add_argument("--encoder", choices=("motor", "shaft"), help="virtual: an encoder on each motor, or behind it")
    web_options(parser)
    patience_option(parser, "a page")
    parser.add_argument(
        "--camera",
        help="a camera's picture, and clicks that move the spot: index, device, part of a name; with --virtual: 1 or 2",
    )


def run(args: argparse.Namespace) -> None:
    """Serve the panel until a signal ends it. Raises MountError."""
    from mirrormount.cli.panel_opening import serve_panel

    serve_panel(args)


COMMANDS = (Command("panel", "the web panel: drive one or more mounts from a browser, until Ctrl-C", run, arguments),)
