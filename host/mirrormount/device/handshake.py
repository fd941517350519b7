"""The first exchange with a board: is it a mount?"""

import re

from mirrormount.common.errors import (
    AllowNeeded,
    AtPrompt,
    ConnectionLost,
    FirmwareMissing,
    NoAnswer,
    NotAMount,
    PortAbsent,
    PortBusy,
)
from mirrormount.common.printable import printable
from mirrormount.transport.lines import AT_PROMPT, GREETING, NO_BOARD, NOT_ALLOWED, TAKEN, Link

ANSWER_S = 2.0  # a board answers in milliseconds, but one that was just plugged in, or is virtual, may be starting
_SERVED_ANSWER_S = 5.0  # after a greeting: `serve` stops the board first, which takes longer on a busy computer

_STATUS_END = re.compile(r"[0-9,|-]+")  # of an answer to a poll, which a busy computer brings late


def identify(link: Link) -> str:
    """Stop all motion, drop old answers, and query the identity. Returns the answer to *IDN?.

    Raises NotAMount, AtPrompt, FirmwareMissing, PortBusy, PortAbsent, AllowNeeded.
    """
    try:
        link.write(b"!\n")
        before = link.drain(0.1)
        _check_served(before.decode("ascii", "replace"))
        link.write(b"*IDN?\n")
        answer = link.read_line(_SERVED_ANSWER_S if GREETING in before else ANSWER_S)
        # the board is just starting; or that is the rest of an answer to a client that was killed
        if answer.endswith("soft reboot") or _STATUS_END.fullmatch(answer):
            answer = link.read_line(ANSWER_S)
    except ConnectionLost as e:
        raise NotAMount("it hung up when asked who it is: not a mount") from e
    except NoAnswer as e:
        answer = link.drain(0.05).decode("ascii", "replace")
        if not answer:
            raise NotAMount("nothing answers: not a mount, or its firmware hangs") from e
    _check_served(answer)
    answer = answer.lstrip("\ufffd\x01\x03")  # a greeting that came late
    if not answer.startswith("mirrormount,"):
        link.write(b"\r")  # a prompt in the middle of a line shows only after its end
        answer += link.drain(0.3).decode("ascii", "replace")
    rest = link.drain(0.05).decode("ascii", "replace")
    if answer.startswith("mirrormount,") and not rest:
        answer = printable(answer)
        if answer.count(",") < 3:
            raise NotAMount(f"not the four parts of a mount's identity: {answer[:80]!r}")
        return answer
    if ">>>" in answer + rest:
        link.write(b"\r\x03\r")
        link.drain(0.1)
        if _fails_to_import(link, b"mountfw"):
            raise FirmwareMissing("Python answers, but mountfw is not on this board: deploy it first")
        raise AtPrompt("the board is at its Python prompt: press Ctrl-D there, or reset it, to start mountfw")
    raise NotAMount(f"this is not a mount; it answered {(answer + rest)[:60]!r}")


def _fails_to_import(link: Link, module: bytes) -> bool:
    """Whether a prompt cannot import it. No answer within ANSWER_S: False. Raises ConnectionLost."""
    link.write(b"import " + module + b"\r")
    said, end = b"", link.monotonic() + ANSWER_S
    while b">>> " not in said.partition(module)[2] and link.monotonic() < end:  # behind the echo of what was sent
        said += link.drain(0.05)
    return b"ImportError" in said


def _check_served(received: str) -> None:
    """Raise the error that stands for a refusal of a program that serves the board."""
    if TAKEN in received:
        raise PortBusy("another program drives this board")
    if NO_BOARD in received:
        raise PortAbsent("the program that serves this board has lost it: plug the board in")
    if AT_PROMPT in received:
        raise AtPrompt("the board is at its Python prompt: press Ctrl-D there (on its pty) to start mountfw")
    if NOT_ALLOWED in received:
        raise AllowNeeded("this computer may not drive that board: serve it with --allow, or go through ssh -L")
