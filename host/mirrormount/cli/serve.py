"""`mirrormount serve`: a board on TCP, by network/server.py."""

import argparse
from pathlib import Path

from mirrormount.cli.command import Command, board_port, port_of


def arguments(parser: argparse.ArgumentParser) -> None:
    """Which board, where to listen, which clients are admitted, and how a client's motion ends with it."""
    board_port(parser)
    parser.add_argument("--tcp", default="127.0.0.1:23", metavar="HOST:PORT", help="where to listen (port 0: any)")
    parser.add_argument(
        "--no-telnet", dest="telnet", action="store_false", help="no greeting, and no telnet bytes removed"
    )
    parser.add_argument("--token", help="a client's first line must be this (default: $MIRRORMOUNT_TOKEN)")
    parser.add_argument("--token-file", type=Path, metavar="FILE", help="the same, from a file's first line")
    parser.add_argument(
        "--on-leave",
        choices=("stop", "finish"),
        default="stop",
        help="when a client goes: stop what moves, or finish moves of known length (PR, PA, XU, OR, MT)",
    )


def run(args: argparse.Namespace) -> None:
    """Serve until a signal ends it. Raises MountError."""
    from mirrormount.common.tokens import read_token
    from mirrormount.network.server import serve

    token = read_token(args.token, args.token_file)
    serve(port_of(args), args.tcp, token, telnet=args.telnet, finish=args.on_leave == "finish")


COMMAND = Command("serve", "put the board on TCP, as a New Focus 8742 on Ethernet, until Ctrl-C", run, arguments)
