"""Shared by deploys to MicroPython and CircuitPython: the options, and what they ask the running firmware."""

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from mirrormount.common.errors import DeployError, NoAnswer, PortBusy
from mirrormount.common.printable import printable
from mirrormount.transport.lines import TAKEN, Link

STATUS = re.compile(r"\d+,\d+,\d+((?:\|-?\d+,[01],-?\d+,\d+,\d+,\d+)+)")
_ANSWER_S = 3.0
_ADDRESS = b"01>"  # the board's own, in a form that no other program uses: the board repeats it before its answers


@dataclass(frozen=True)
class Options:
    """The options of the command line. port: None for the only board that is plugged in."""

    port: str | None = None
    stop: bool = False
    source: bool = False
    board: str | None = None
    pins: Path | None = None
    replace_main: bool = False
    drive: Path | None = None


def quiet(link: Link, stop: bool) -> str:
    """Check that no motor moves; with stop, stop them first. Returns the board's status line.

    Raises DeployError, PortBusy.
    """
    answer = ask(link, b"XS?\n")
    if TAKEN in answer:
        raise PortBusy("another program drives this board")
    if stop and _moves(answer):
        link.write(b"!\n")
        link.drain(0.1)
        answer = ask(link, b"XS?\n")
    if _moves(answer):
        raise DeployError("a motor moves: wait until it is done, or say --stop")
    return answer


def ask(link: Link, question: bytes) -> str:
    """The first line of the answer to a query, and the bytes right after it; "" without an answer."""
    link.write(question)
    try:
        line = link.read_line(_ANSWER_S)
    except NoAnswer:
        line = ""
    return (line + "\n" + link.drain(0.05).decode("ascii", "replace")).lstrip("\n")


def _moves(answer: str) -> bool:
    status = STATUS.search(answer)
    return bool(status) and any(axis.split(",")[1] == "1" for axis in status[1].strip("|").split("|"))


def check(link: Link, wanted: Collection[str] | None) -> tuple[int, str]:
    """Check that XF? answers one of these hashes (None: any). Returns the number of axes, and that answer.

    Raises DeployError, NoAnswer, ConnectionLost.
    """
    # answers to earlier queries may still arrive from a board that was starting: they have no address
    answer = link.ask(_ADDRESS + b"XF?;XH?;XS?\n", _ANSWER_S)
    while not answer.startswith(_ADDRESS.decode()):
        answer = link.read_line(_ANSWER_S)
    parts = answer[len(_ADDRESS) :].split("; ")
    if len(parts) != 3:
        raise DeployError(f"the board answers {answer[:60]!r} when asked what runs there")
    found, health, status = parts
    if wanted is not None and found not in wanted:
        expected = " or ".join(f"{one[:16]}…" for one in wanted)
        raise DeployError(f"the board's firmware is not what was sent (XF? {printable(found[:16])}…, not {expected})")
    numbers = health.split(",")  # four before 0.2.0
    if len(numbers) not in (4, 5) or not all(number.isdecimal() for number in numbers):
        raise DeployError(f"the board does not tell its health: {health[:60]!r}")
    return status.count("|"), found
