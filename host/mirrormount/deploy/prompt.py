"""A board's Python prompt: its keys, and the one way to it, through it and back to the firmware.

MicroPython and CircuitPython have the same keys. Imports transport.
"""

import contextlib
import time
from collections.abc import Iterator

from mirrormount.common.errors import MountError
from mirrormount.common.signals import Terminated
from mirrormount.transport.lines import Link

SIGN = b">>>"
INTERRUPT = b"\x03"  # Ctrl-C
FRIENDLY = b"\x02"  # Ctrl-B: leaves a raw prompt
RAW = b"\x01"  # Ctrl-A
RESTART = b"\x04"  # Ctrl-D: a soft reset, which runs the program in the root again
STOP = b"\r" + 2 * INTERRUPT  # the first may come within a `finally` of what runs

_QUIET_S = 0.2
_PROMPT_S = 5.0  # the longest time until a prompt
_AGAIN_S = 0.5  # until the raw prompt is asked for again


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
