"""`mirrormount stop`: both motors off, also when another program has the port."""

import argparse
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from mirrormount.cli.command import Command, PortOfEnvironment, open_any, port_options
from mirrormount.common.errors import MountError, NoAnswer, NoBoardFound, NotAMount, PortBusy
from mirrormount.common.names import is_name

if TYPE_CHECKING:
    from mirrormount.transport.processes import Owner

_LEAVES_S, _LOOK_S = 0.5, 0.02  # how long a program that could not stop may take to close the port
_PROMPT_S = 1.0  # how long a prompt may take to come back
_BUSY_S = 1.5  # how long a program may have it and take no stop: another `stop`, or one that has just opened it
_not_said: list[OSError] = []  # why lines could not be printed


class _Port(NamedTuple):
    """Where a mount may be."""

    address: str
    named: bool  # by a person, in the environment or in the table; else its USB id or its drive is all that is known


def run(args: argparse.Namespace) -> None:
    """Stop the mount at --port, or all. Raises MountError."""
    from mirrormount.transport.stop_socket import owners

    if args.sketch and not (args.port and owners(args.port)):
        with open_any(args):  # opening already stops, and says so if it could not
            pass
        print("stopped")
        return
    untyped = isinstance(args.port, PortOfEnvironment)  # somebody may mean another mount
    try:
        stop(None if untyped else args.port, args.port if untyped else None)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted: not every mount is known to have stopped") from None
    if _not_said:
        raise _not_said.pop()


def stop(address: str | None, of_environment: str | None = None) -> None:
    """Stop the mount at address; without one, all: every mount that a program of this user has open, the one that the
    environment names, those of the table, and those that are plugged in.

    Raises MountError if one of them did not stop, or cannot be known to have; the others are stopped all the same.
    With several of those, the message has all of them. A program that has a port is asked before anything of the client
    library is imported.
    """
    problems = _stop_one(address) if address else _stop_all(of_environment)
    texts = list(dict.fromkeys(map(str, problems)))
    if len(texts) > 1:
        raise MountError("; ".join(texts))
    if problems:
        raise problems[0]


def _stop_one(address: str) -> list[MountError]:
    """Stop the mount at an address or of a name. Returns what went wrong."""
    from mirrormount.transport import stop_socket

    if is_name(address):
        from mirrormount.device.named import place_of

        address = place_of(address).address
    if owners := stop_socket.owners(address):
        problems = _ask(owners)
        if not problems or not _have_left(owners):
            return problems
    return _stop_at([_Port(address, named=True)], [])  # as they were asked they closed the port, which does not stop


def _stop_all(of_environment: str | None) -> list[MountError]:
    """Stop every mount that may be there: programs are asked while the other ports are looked for and opened.

    Returns what went wrong.
    """
    from threading import Thread

    from mirrormount.transport import stop_socket

    owners = stop_socket.owners()
    problems: list[MountError] = []
    if why := stop_socket.why_none():
        problems.append(NoAnswer(f"no program that has a port open can be asked for a stop: {why}"))
    asking = Thread(target=lambda: problems.extend(_ask(owners)))
    asking.start()
    try:
        others = _stop_unasked(of_environment, owners)
    finally:
        asking.join()
    return problems + others


def _stop_unasked(of_environment: str | None, asked: "Sequence[Owner]") -> list[MountError]:
    """Stop the mounts that may be there, but for those whose programs are asked. Returns what went wrong."""
    from mirrormount.transport.find import find_one

    ports, problems = _every_port(of_environment)
    if not (ports or problems or asked):
        try:
            find_one()  # says what is plugged in instead
        except NoBoardFound as e:
            problems.append(e)
    return problems + _stop_at(ports, asked)


def _every_port(of_environment: str | None) -> tuple[list[_Port], list[MountError]]:
    """Where mounts may be, each port once; and the reasons why not all of them are known."""
    from mirrormount.device.named import addresses, place_of
    from mirrormount.transport.find import find
    from mirrormount.transport.stop_socket import real_name

    places = (
        (lambda: [place_of(of_environment).address] if of_environment else [], True),
        (addresses, True),
        (lambda: [device for device, _ in find()], False),
    )
    ports: dict[str, _Port] = {}
    problems: list[MountError] = []
    for look, named in places:
        try:
            for address in look():
                ports.setdefault(real_name(address), _Port(address, named))
        except MountError as e:
            problems.append(e)
    real = [port for port in ports.values() if not port.address.startswith("virtual://")]
    return real or list(ports.values()), problems  # a virtual board would be a new one, in which nothing runs


def _stop_at(ports: Sequence[_Port], asked: "Sequence[Owner]") -> list[MountError]:
    """Stop the mounts at these ports, at the same time: one that does not answer delays no other's stop.

    Returns what went wrong. Where a person has named some, the others may be another instrument: one that is no mount
    is told, and is no failure.
    """
    from concurrent.futures import ThreadPoolExecutor

    several = len(ports) > 1
    some_named = any(port.named for port in ports)

    def stop_at(port: _Port) -> list[MountError]:
        name = f"{port.address}: " if several else ""
        try:
            return _open(port.address, name, asked, may_interrupt=port.named or not several)
        except MountError as e:
            if several and not str(e).startswith(port.address):
                e.args = (f"{name}{e}",)
            if port.named or not some_named or not isinstance(e, NotAMount):
                return [e]
            _say(f"left alone: {e}")
            return []

    with ThreadPoolExecutor(max(1, len(ports))) as pool:
        return [problem for problems in pool.map(stop_at, ports) for problem in problems]


def _ask(owners: "Sequence[Owner]") -> list[MountError]:
    """Ask programs that have a port for a stop, and print what they did. Returns what went wrong."""
    from mirrormount.transport.stop_socket import STOPPED, ask_all

    problems: list[MountError] = []
    for owner, answer in zip(owners, ask_all(owners), strict=True):
        if isinstance(answer, MountError):
            problems.append(answer)
        else:
            how = "stopped" if answer == STOPPED else "stop sent, and not confirmed by the board"
            _say(f"{how} (by {owner}, which has the port)")
    return problems


def _have_left(owners: "Sequence[Owner]") -> bool:
    """True if none of these programs has the port any more, or all leave it within a moment."""
    end = time.monotonic() + _LEAVES_S
    while any(owner.path and owner.path.exists() for owner in owners):
        if time.monotonic() > end:
            return False
        time.sleep(_LOOK_S)
    return True


def _open(address: str, name: str, asked: "Sequence[Owner]", may_interrupt: bool) -> list[MountError]:
    """Open a mount, which stops it, and print that with its name. Returns what went wrong, or raises MountError.

    Programs that have the port meanwhile are asked, but for those that are asked elsewhere. may_interrupt: if it is no
    mount that answers, a program at a Python prompt there may be ended.
    """
    from mirrormount.device.mount import Mount
    from mirrormount.transport.processes import who_has
    from mirrormount.transport.stop_socket import owners

    if (has := owners(address)) and all(owner in asked for owner in has):
        return []
    holder: Owner | None = None
    end = 0.0
    while True:
        try:
            Mount.open(address).close()  # opening stops, and says so if it could not
        except PortBusy as e:
            now = who_has(address)
            if not end or (now and now != holder):  # of a crowd of stops each has its turn
                end = time.monotonic() + _BUSY_S
            holder = now or holder
            if time.monotonic() > end:
                raise PortBusy(f"{e}; that program takes no stop from here{_way(holder)}") from e
            time.sleep(_LOOK_S)  # no event shows that another process has closed a port
            if has := owners(address):
                problems = _ask(has)
                if not problems or not _have_left(has):
                    return problems
            continue
        except NotAMount as e:
            if type(e) is not NotAMount:
                raise
            if not may_interrupt:
                raise NotAMount(f"{e}; if it is one, name it (mirrormount stop --port {address})") from e
            if not _end_program(address):
                raise
            _say(f"{name}stopped: the program at the board's Python prompt was ended (Ctrl-D there starts mountfw)")
        else:
            _say(f"{name}stopped")
        return []


def _say(line: str) -> None:
    """Print a line in one piece: several mounts are stopped at the same time. That it cannot be is told after all."""
    try:
        print(f"{line}\n", end="", flush=True)
    except OSError as e:
        _not_said.append(e)


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
