"""`mirrormount stop`: all motors off, also when another program has the port.

Programs that have a port are asked first; what only the others need is imported after that. All stops are given at the
same time, each in a thread of its own: one that does not answer delays no other.
"""

import argparse
import threading
import time
from collections.abc import Callable, Sequence
from queue import SimpleQueue

from mirrormount.cli.arguments import Command, PortOfEnvironment, port_options
from mirrormount.errors import MountError, NoAnswer, NoBoardFound, NotAMount, PortBusy
from mirrormount.transport.stop_socket import STOPPED, Owner, ask_for, owners, real_name, why_none
from mirrormount.values import is_name

_BUSY_S = 1.5  # how long a program may have a port and take no stop: another `stop`, or one that has just opened it
_PROMPT_S, _POLL_S = 1.0, 0.02  # how long a prompt may take to come back


def run(args: argparse.Namespace) -> None:
    """Stop the mount at --port; without one, all: every mount that a program of this user has open, the one that the
    environment names, those of the table, and those that are plugged in.

    Raises MountError if one of them did not stop, or cannot be known to have; with several of those, the message has
    all of them.
    """
    untyped = isinstance(args.port, PortOfEnvironment)  # somebody may mean another mount
    try:
        problems = _stop_all(args.port) if untyped or not args.port else _stop_one(args.port)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted: not every mount is known to have stopped") from None
    texts = list(dict.fromkeys(map(str, problems)))
    if len(texts) > 1:
        raise MountError("; ".join(texts))
    if problems:
        raise problems[0]


def _stop_one(address: str) -> list[MountError]:
    """Stop the mount at an address or of a name. Returns what went wrong."""
    board = ""
    if is_name(address):
        from mirrormount.device.table_file import find_port

        address, _, board = find_port(address)
    stops, asked = _Stops(), owners(address)
    for owner in asked:
        stops.begin(lambda owner=owner: _ask(owner, board))
    problems = stops.tell()
    if asked and not problems:
        return []
    try:
        # a program that could not stop may have closed the port, which does not stop
        print(_open(address, asked, board))
        return []
    except MountError as e:
        return problems or [e]


def _stop_all(of_environment: str | None) -> list[MountError]:
    """Stop every mount that may be there: programs are asked while the other ports are looked for and opened.

    Returns what went wrong. Where a person has named some mounts, the other boards may be other instruments: one that
    is no mount is told, and is no failure.
    """
    stops, asked = _Stops(), owners()
    for owner in asked:
        stops.begin(lambda owner=owner: _ask(owner))
    ports, problems = _every_port(of_environment)
    if not (ports or problems or asked):
        from mirrormount.transport.discovery import find_one

        try:
            find_one()  # says what is plugged in instead
        except NoBoardFound as e:
            problems.append(e)
    if why := why_none():
        problems.append(NoAnswer(f"no program that has a port open can be asked for a stop: {why}"))
    some_named = any(ports.values())
    for address, named in ports.items():

        def stop(address: str = address, named: bool = named) -> str:
            if len(ports) == 1:
                return _stop_at(address, asked, may_interrupt=True)
            try:
                line = _stop_at(address, asked, may_interrupt=named)
            except MountError as e:
                if not str(e).startswith(address):
                    e.args = (f"{address}: {e}",)
                if named or not some_named or not isinstance(e, NotAMount):
                    raise
                return f"left alone: {e}"
            return line and f"{address}: {line}"

        stops.begin(stop)
    return problems + stops.tell()


class _Stops:
    """Stops that are given at the same time. Each of them returns a line for the person, or raises."""

    def __init__(self) -> None:
        self._results: SimpleQueue[str | BaseException] = SimpleQueue()
        self._begun = 0

    def begin(self, stop: Callable[[], str]) -> None:
        """Give a stop. The thread is no daemon: nothing that happens meanwhile keeps it from its end."""

        def run() -> None:
            try:
                self._results.put(stop())
            except BaseException as e:
                self._results.put(e)

        self._begun += 1
        threading.Thread(target=run).start()

    def tell(self) -> list[MountError]:
        """Print the lines as they come. Returns what went wrong."""
        problems: list[MountError] = []
        for _ in range(self._begun):
            result = self._results.get()
            if isinstance(result, MountError):
                problems.append(result)
            elif isinstance(result, BaseException):
                raise result
            elif result:
                print(result, flush=True)
        return problems


def _every_port(of_environment: str | None) -> tuple[dict[str, bool], list[MountError]]:
    """Where mounts may be, each port once; and the reasons why not all of them are known.

    True for those that are named by a person, in the environment or in the table: of the others a USB id or a drive is
    all that is known.
    """
    from mirrormount.device.table_file import find_port, table_addresses
    from mirrormount.transport.discovery import find

    sources: list[tuple[Callable[[], list[str]], bool]] = [
        (lambda: [find_port(of_environment).address] if of_environment else [], True),
        (table_addresses, True),
        (lambda: [device for device, _ in find()], False),
    ]
    found: dict[str, tuple[str, bool]] = {}
    problems: list[MountError] = []
    for source, named in sources:
        try:
            for address in source():
                found.setdefault(real_name(address), (address, named))
        except MountError as e:
            problems.append(e)
    every = dict(found.values())
    real = {address: named for address, named in every.items() if not address.startswith("virtual://")}
    return real or every, problems  # a virtual board would be a new one, in which nothing runs


def _ask(owner: Owner, board: str = "") -> str:
    """Ask a program that has a port for a stop. Returns what it did. board: the id of the one that is meant, if known.

    Raises NoAnswer.
    """
    done, stopped = ask_for(owner, board)
    how = "stopped" if done == STOPPED else "stop sent, and not confirmed by the board"
    return f"{how} (by {owner}, which has the port{f'; board {stopped}' if stopped else ''})"


def _stop_at(address: str, asked: Sequence[Owner], *, may_interrupt: bool) -> str:
    """As _open(). Returns "" if the programs that have the port are asked elsewhere."""
    has = owners(address)
    return "" if has and all(owner in asked for owner in has) else _open(address, asked, may_interrupt=may_interrupt)


def _open(address: str, asked: Sequence[Owner], board: str = "", *, may_interrupt: bool = True) -> str:
    """Open a mount, which stops it, or ask programs that have opened it meanwhile. Returns what was done.

    asked: programs that were asked. board: the id of the one that is meant, if known. may_interrupt: if it is no mount
    that answers, a program at a Python prompt there may be ended. Raises MountError.
    """
    from mirrormount.device.session import Session

    end = time.monotonic() + _BUSY_S
    while True:
        if others := [owner for owner in owners(address) if owner not in asked]:
            return "\n".join(_ask(owner, board) for owner in others)
        try:
            session = Session.open(address)  # which stops, and says so if it could not
            session.close()
            if board and session.board.id.upper() != board.upper():
                raise NoAnswer(f"{address}: the board {session.board.id} has stopped, not {board}: that may still move")
            return "stopped"
        except PortBusy as e:
            if owners(address) or time.monotonic() > end:
                to_do = why_none() or "end it; to be sure, cut the motors' supply"
                raise PortBusy(f"{e}; that program takes no stop from here: {to_do}") from e
            time.sleep(_POLL_S)  # no event shows that another process has closed a port
        except NotAMount as e:
            if type(e) is not NotAMount:
                raise
            if not may_interrupt:
                raise NotAMount(f"{e}; if it is one, name it (mirrormount stop --port {address})") from e
            if not _end_program(address):
                raise
            return "stopped: the program at the board's Python prompt was ended (Ctrl-D there starts mountfw)"


def _end_program(address: str) -> bool:
    """Interrupt what runs at a board's Python prompt, as a move there. True if the prompt is there then."""
    from mirrormount.transport.link import Link
    from mirrormount.transport.ports import open_port

    link = Link(open_port(address))
    try:
        for _ in range(2):  # a program may have caught the first
            link.write(b"\x03")
            said, end = b"", link.monotonic() + _PROMPT_S
            while link.monotonic() < end:
                said += link.drain(_POLL_S)
                if b">>>" in said:
                    return True
        return False
    finally:
        link.close()


COMMANDS = (Command("stop", "both motors off, now", run, port_options),)
