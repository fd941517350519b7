"""`mirrormount serve`: a board on TCP."""

import argparse
import contextlib

from mirrormount.cli.arguments import Command, board_port, port_of


def arguments(parser: argparse.ArgumentParser) -> None:
    """Which board, where to listen, which clients are admitted, and how a client's motion ends with it."""
    board_port(parser)
    parser.add_argument("--tcp", default="23", metavar="[HOST:]PORT", help="where to listen (23; 0: any free port)")
    parser.add_argument("--host", help="on which address (127.0.0.1); one that others can reach needs --allow")
    parser.add_argument(
        "--allow",
        action="append",
        default=[],
        metavar="ADDRESS-OR-NETWORK",
        help="who may drive the mount besides this computer, such as 192.168.1.17 or 192.168.1.0/24 (repeatable)",
    )
    parser.add_argument(
        "--on-leave",
        choices=("stop", "finish"),
        default="stop",
        help="when a client goes: stop what moves, or finish moves of known length (PR, PA, XU, OR, MT)",
    )


def run(args: argparse.Namespace) -> None:
    """Serve until a signal ends it. Raises MountError."""
    from mirrormount import serve
    from mirrormount.errors import BadValue
    from mirrormount.terminal import Terminated, ended_in_order
    from mirrormount.values import host_and_port

    if args.host and ":" in args.tcp:
        raise BadValue("--host and --tcp HOST:PORT: name the host once")
    try:
        host, port = host_and_port(args.tcp, args.host or "127.0.0.1")
    except BadValue:
        raise BadValue(f"--tcp is PORT or HOST:PORT, for instance 5023, not {args.tcp[:80]!r}") from None
    allowed = serve.networks(args.allow)
    with contextlib.suppress(Terminated), ended_in_order():  # a signal is how it is meant to end
        serve.serve(port_of(args), serve.listen(host, port, allowed), allowed, finish=args.on_leave == "finish")


COMMANDS = (Command("serve", "put the board on TCP, as a New Focus 8742 on Ethernet, until Ctrl-C", run, arguments),)
