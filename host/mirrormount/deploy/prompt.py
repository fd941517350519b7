"""What both kinds of deploy say to a board: the way to its Python prompt and back, what they ask its firmware, and what
they answer to `mirrormount stop` meanwhile.

MicroPython and CircuitPython have the same keys. Imports transport.
"""

import contextlib
import re
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from mirrormount.errors import DeployError, MountError, NoAnswer, PortBusy
from mirrormount.terminal import Terminated, printable
from mirrormount.transport.link import TAKEN, Link
from mirrormount.transport.stop_socket import SENT, STOPPED, StopListener

SIGN = b">>>"
INTERRUPT = b"\x03"  # Ctrl-C
FRIENDLY = b"\x02"  # Ctrl-B: leaves a raw prompt
RAW = b"\x01"  # Ctrl-A
RESTART = b"\x04"  # Ctrl-D: a soft reset, which runs the program in the root again
STOP = b"\r" + 2 * INTERRUPT  # the first may come within a `finally` of what runs

_QUIET_S = 0.2
_PROMPT_S = 5.0  # the longest time until a prompt
_AGAIN_S = 0.5  # until the raw prompt is asked for again

STATUS = re.compile(r"\d+,\d+,\d+((?:\|-?\d+,[01],-?\d+,\d+,\d+,\d+)+)")
_ANSWER_S = 3.0
_ADDRESS = b"01>"  # the board's own, in a form that no other program uses: the board repeats it before its answers
_OPENS_S = 1.0  # longest time until the port is open


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


def may_replace(options: Options) -> Callable[[dict[str, str]], bool]:
    """What a plan asks about files of somebody else, {path: name of its copy}: --replace-main, or who sits there."""

    def ask_user(aside: dict[str, str]) -> bool:
        if options.replace_main:
            return True
        if not (sys.stdin and sys.stdin.isatty()):
            return False
        names, copies = ", ".join(sorted(aside)), ", ".join(sorted(aside.values()))
        question = f"The board has files of somebody else: {names}. Replace them (copies stay as {copies})? [y/N] "
        print(question, end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    return ask_user


def receive(link: Link, text: bytes, longest_s: float = _PROMPT_S) -> bytes:
    """The board's output up to text, or of longest_s if it does not come."""
    received = b""
    end = time.monotonic() + longest_s
    while text not in received and time.monotonic() < end:
        received += link.drain(0.02, 0.1)
    return received


def interrupt(link: Link) -> bytes:
    """Interrupt the program and await the prompt. Returns the board's output: SIGN is in it if a prompt came."""
    link.write(STOP + FRIENDLY)
    return receive(link, SIGN + b" ")


def look(link: Link) -> str:
    """Interrupt the program on an unknown board. Returns its output, which may have SIGN in it."""
    link.write(STOP)
    received = link.drain(_QUIET_S)
    link.write(FRIENDLY)
    return (received + link.drain(_QUIET_S)).decode("ascii", "replace")


def takes_programs(link: Link) -> tuple[bool, bytes]:
    """Interrupt the program and try the raw prompt, by which mpremote sends programs. Returns (works, output).

    If it works, the board is left at the friendly prompt; if not, the program is started again.
    """
    link.write(STOP)
    received = link.drain(_QUIET_S)
    end = time.monotonic() + _PROMPT_S
    while b"raw REPL" not in received and time.monotonic() < end:
        link.write(RAW)  # again: the program may have taken the one before, on its way out
        received += receive(link, b"raw REPL", _AGAIN_S)
    link.write(FRIENDLY)
    link.drain(0.1)
    works = b"raw REPL" in received
    if not works:
        link.write(RESTART)
        link.drain(_QUIET_S)
    return works, received


def run_again(link: Link) -> None:
    """At a prompt, raw or friendly: start the program in the root again."""
    link.write(b"\r" + INTERRUPT + FRIENDLY)
    link.drain(_QUIET_S)
    link.write(RESTART)


@contextlib.contextmanager
def restarted_on_interruption(link: Link) -> Iterator[None]:
    """When Ctrl-C or a signal ends this program within, the firmware is started again."""
    try:
        yield
    except (KeyboardInterrupt, Terminated):
        with contextlib.suppress(MountError):
            run_again(link)
            link.drain(_QUIET_S)
        raise


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


class StopAnswer:
    """Answers a stop: nothing drives once the firmware was found at rest.

    An interrupted firmware turns the motors off, and one that starts has them off. Until then the stop is written.
    """

    def __init__(self) -> None:
        self._link: Link | None = None
        self._at_rest = False
        self._known = threading.Event()
        self._lock = threading.Lock()
        self.asked = False  # somebody has stopped the board

    def asking(self, link: Link) -> None:
        """On this link the firmware is asked whether a motor moves."""
        self._link = link
        self._known.set()

    def write_unless_asked(self, link: Link, data: bytes) -> bool:
        """Write what moves something. False: a stop came before, and nothing was written."""
        with self._lock:
            if not self.asked:
                link.write(data)
            return not self.asked

    def found(self, at_rest: bool) -> None:
        """It said that none does. False: no firmware of ours has answered, so a stop means nothing to the board."""
        self._at_rest = at_rest
        self._link = None

    def stop(self) -> str:
        """STOPPED or SENT. Raises MountError."""
        if not self._known.wait(_OPENS_S):
            raise MountError("it has yet to open the port")
        if self._at_rest:
            return STOPPED
        if (link := self._link) is None:
            raise MountError("the board had no firmware that takes a stop; what ran there was interrupted")
        self.asked = True  # nothing that moves is begun to be written from here on
        free = self._lock.acquire(blocking=False)
        link.port.write(b"!\n")  # without the link's lock, which a hanging exchange may hold
        if not free and (free := self._lock.acquire(timeout=_OPENS_S)):
            link.port.write(b"!\n")  # behind what was being written
        if free:
            self._lock.release()
        return SENT


@contextlib.contextmanager
def stop_answered(port: str) -> Iterator[StopAnswer]:
    """A socket for stops, for as long as this lasts."""
    answer = StopAnswer()
    listener = StopListener([port], answer.stop)
    try:
        yield answer
    finally:
        listener.close()
