"""`mirrormount panel`: the web panel, by panel_opening.py."""

import argparse
from pathlib import Path

from mirrormount.cli.command import Command, board_port, virtual_options


def arguments(parser: argparse.ArgumentParser) -> None:
    """Which board, where to listen, and the token."""
    board_port(parser)
    virtual_options(parser, "a virtual board, with its screen; no hardware needed")
    parser.add_argument(
        "--host", default="127.0.0.1", help="where to listen; 0.0.0.0: all networks of this computer, with a token"
    )
    parser.add_argument("--http", metavar="PORT", help="the web server's port (default: 8080, or the next free one)")
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help="the token is FILE's first line (default: $MIRRORMOUNT_TOKEN, or made where one is needed)",
    )
    parser.add_argument("--token", help="the token itself; other users see it in the list of processes")
    parser.add_argument(
        "--patience", default="0.35", metavar="S", help="stop what a page drives when it is silent for so long (0.35)"
    )
    parser.add_argument(
        "--camera",
        help="a camera's picture, and clicks that move the spot: index, device, part of a name; with --virtual: 1 or 2",
    )
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="do not open the browser")


def run(args: argparse.Namespace) -> None:
    """Serve the panel until a signal ends it. Raises MountError."""
    from mirrormount.cli.panel_opening import serve_panel

    serve_panel(args)


COMMAND = Command("panel", "the web panel: drive the mount from a browser, until Ctrl-C", run, arguments)
