"""`mirrormount stop`: both motors off, also when another program has the port."""

import argparse
import time

from mirrormount.cli.command import Command, open_any, port_options
from mirrormount.common.errors import BadFile, MountError, NoAnswer, NoBoardFound, PortBusy
from mirrormount.common.names import is_name

_LEAVES_S, _LOOK_S = 0.5, 0.02  # how long a program that could not stop may take to close the port


def run(args: argparse.Namespace) -> None:
    """Stop the mount at --port, or all. Raises MountError."""
    from mirrormount.transport.stop_socket import owners

    if args.sketch and not (args.port and owners(args.port)):
        with open_any(args):  # opening already stops, and says so if it could not
            pass
        print("stopped")
    else:
        stop(args.port)


def stop(address: str | None) -> None:
    """Stop the mount at address; without one, every mount that this user has open, and the one that is plugged in.

    Raises MountError if one of them did not stop, or cannot be known to have; the others are stopped all the same.
    With several of those, the message has all of them. A program that has the port is asked before anything of the
    client library is imported.
    """
    from mirrormount.transport import stop_socket

    if address and is_name(address):
        from mirrormount.device.named import place_of

        address = place_of(address).address
    owners = stop_socket.owners(address)
    problems: list[MountError] = []
    if not address and (why := stop_socket.why_none()):
        problems.append(NoAnswer(f"no program that has a port open can be asked for a stop: {why}"))
    for owner, answer in zip(owners, stop_socket.ask_all(owners), strict=True):
        if isinstance(answer, MountError):
            problems.append(answer)
        else:
            how = "stopped" if answer == stop_socket.STOPPED else "stop sent, and not confirmed by the board"
            print(f"{how} (by {owner}, which has the port)")
    if address and problems and _have_left(address):
        owners, problems = [], []  # as they were asked they closed the port, which does not stop
    if not owners or address is None:
        problems += _stop_by_opening(address, bool(owners))
    if len(problems) > 1:
        raise MountError("; ".join(str(problem) for problem in problems))
    if problems:
        raise problems[0]


def _have_left(address: str) -> bool:
    """True if no program has the port any more, or all leave it within a moment."""
    from mirrormount.transport.stop_socket import owners

    end = time.monotonic() + _LEAVES_S
    while owners(address):
        if time.monotonic() > end:
            return False
        time.sleep(_LOOK_S)
    return True


def _stop_by_opening(address: str | None, others_were_asked: bool) -> list[MountError]:
    """Open the mount at address, else those of the table, else the one that is plugged in: opening stops it.

    Returns what went wrong.
    """
    from mirrormount.device.mount import Mount
    from mirrormount.device.named import addresses
    from mirrormount.transport.stop_socket import owners, why_none

    problems: list[MountError] = []
    try:
        named = [] if address else addresses()
    except BadFile as e:
        named = []
        problems.append(e)
    for one in [address] if address else named or [None]:
        if one and not address and owners(one):
            continue  # its program was asked
        try:
            Mount.open(one).close()  # opening stops, and says so if it could not
        except PortBusy as e:
            why = why_none() or "without --port it goes to every program of this user that takes one"
            how = "" if address is None else f": {why}"
            problems.append(PortBusy(f"{e}; that program takes no stop from here{how}"))
        except MountError as e:
            if not others_were_asked or not isinstance(e, NoBoardFound):
                problems.append(e)
        else:
            print("stopped" if address or not one else f"{one}: stopped")
    return problems


COMMAND = Command("stop", "both motors off, now", run, port_options)
