"""`mirrormount stop`: both motors off, also when another program has the port."""

import argparse
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from mirrormount.cli.command import Command, open_any, port_options
from mirrormount.common.errors import BadFile, MountError, NoAnswer, NoBoardFound, NotAMount, PortBusy
from mirrormount.common.names import is_name

if TYPE_CHECKING:
    from mirrormount.transport.processes import Owner

_LEAVES_S, _LOOK_S = 0.5, 0.02  # how long a program that could not stop may take to close the port
_PROMPT_S = 1.0  # how long a prompt may take to come back
_BUSY_S = 1.5  # how long a program may have it and take no stop: another `stop`, or one that has just opened it


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
    problems += _ask(owners)
    if address and problems and _have_left(owners):
        owners, problems = [], []  # as they were asked they closed the port, which does not stop
    if not owners or address is None:
        problems += _stop_by_opening(address, bool(owners))
    if len(problems) > 1:
        raise MountError("; ".join(str(problem) for problem in problems))
    if problems:
        raise problems[0]


def _ask(owners: "Sequence[Owner]") -> list[MountError]:
    """Ask programs that have a port for a stop, and print what they did. Returns what went wrong."""
    from mirrormount.transport.stop_socket import STOPPED, ask_all

    problems: list[MountError] = []
    for owner, answer in zip(owners, ask_all(owners), strict=True):
        if isinstance(answer, MountError):
            problems.append(answer)
        else:
            how = "stopped" if answer == STOPPED else "stop sent, and not confirmed by the board"
            print(f"{how} (by {owner}, which has the port)")
    return problems


def _have_left(owners: "Sequence[Owner]") -> bool:
    """True if none of these programs has the port any more, or all leave it within a moment."""
    end = time.monotonic() + _LEAVES_S
    while any(owner.path and owner.path.exists() for owner in owners):
        if time.monotonic() > end:
            return False
        time.sleep(_LOOK_S)
    return True


def _stop_by_opening(address: str | None, others_were_asked: bool) -> list[MountError]:
    """Open the mount at address, else those of the table, else the one that is plugged in: opening stops it.

    Returns what went wrong.
    """
    from mirrormount.device.named import addresses
    from mirrormount.transport.stop_socket import owners

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
            problems += _open(one, "" if address or not one else f"{one}: ")
        except MountError as e:
            if not others_were_asked or not isinstance(e, NoBoardFound):
                problems.append(e)
    return problems


def _open(address: str | None, name: str) -> list[MountError]:
    """Open a mount, which stops it, and print that with its name. Returns what went wrong, or raises MountError."""
    from mirrormount.device.mount import Mount
    from mirrormount.transport.find import find_one
    from mirrormount.transport.processes import who_has
    from mirrormount.transport.stop_socket import owners

    one = address or find_one()
    holder: Owner | None = None
    end = 0.0
    while True:
        try:
            Mount.open(one).close()  # opening stops, and says so if it could not
        except PortBusy as e:
            now = who_has(one)
            if not end or (now and now != holder):  # of a crowd of stops each has its turn
                end = time.monotonic() + _BUSY_S
            holder = now or holder
            if time.monotonic() > end:
                raise PortBusy(f"{e}; that program takes no stop from here{_way(holder)}") from e
            time.sleep(_LOOK_S)  # no event shows that another process has closed a port
            if has := owners(one):
                problems = _ask(has)
                if not problems or not _have_left(has):
                    return problems
            continue
        except NotAMount as e:
            if type(e) is not NotAMount or not _end_program(one):
                raise
            print(f"{name}stopped: the program at the board's Python prompt was ended (Ctrl-D there starts mountfw)")
        else:
            print(f"{name}stopped")
        return []


def _way(holder: "Owner | None") -> str:
    """How else a stop may get to the program that has a port."""
    from mirrormount.transport.stop_socket import owners, why_none

    if why := why_none():
        return f": {why}"
    if holder and holder.pid in [other.pid for other in owners()]:
        return ": without --port it goes to every program of this user that takes one"
    return ": end it; to be sure, cut the motors' supply"


def _end_program(address: str) -> bool:
    """Interrupt what runs at a board's Python prompt, as a move there. True if the prompt is there then."""
    from mirrormount.transport.lines import Link
    from mirrormount.transport.open import open_port

    link = Link(open_port(address))
    try:
        for _ in range(2):  # a program may have caught the first
            link.write(b"\x03")
            said, end = b"", link.monotonic() + _PROMPT_S
            while link.monotonic() < end:
                said += link.drain(_LOOK_S)
                if b">>>" in said:
                    return True
        return False
    finally:
        link.close()


COMMAND = Command("stop", "both motors off, now", run, port_options)
