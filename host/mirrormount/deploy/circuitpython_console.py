"""The console of a CircuitPython board: stop what runs there, and restart the board."""

import time

from mirrormount.common.errors import ConnectionLost, DeployError
from mirrormount.common.printable import printable
from mirrormount.deploy import prompt
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_port

_PROMPT_S = 6.0
_QUIET_S = 0.2
_LAST_WORDS_S = 3.0
_START_S = 20.0  # how long a program may take to fail: all of it is compiled first
_ENDED = (b"Code done running", b"Press any key", b">>> ")  # what CircuitPython says after a program
_KEYS = 8  # between one Ctrl-C and the next


def interrupt(port: str) -> None:
    """Stop the program, so that its `finally` turns the motors off, and wait for the prompt. Raises DeployError.

    At the prompt CircuitPython does not reload by itself when the drive is written to. It stays there when the
    port is closed.
    """
    link = Link(open_port(port))
    try:
        end = time.monotonic() + _PROMPT_S
        while time.monotonic() < end:
            link.write(prompt.INTERRUPT)
            heard = link.drain(_QUIET_S)
            # Ctrl-C is given time for the program's `finally`; after the program has ended any key brings the
            # prompt, and Ctrl-B leaves a raw one
            for _ in range(_KEYS):
                link.write(b"\r" + prompt.FRIENDLY)
                heard = heard[-200:] + link.drain(_QUIET_S)
                if heard.rstrip().endswith(prompt.SIGN):
                    return
    finally:
        link.close()
    raise DeployError(
        f"the program on the board does not stop for Ctrl-C on {port}: nothing was changed; press its reset button"
        " and try again"
    )


def reset(port: str) -> None:
    """Restart the board as its reset button does, from its prompt: only that runs boot.py again."""
    link = Link(open_port(port))
    try:
        link.write(b"\r" + prompt.INTERRUPT + prompt.FRIENDLY)
        link.drain(_QUIET_S)
        link.write(b"import microcontroller\r")
        link.drain(_QUIET_S)
        link.write(b"microcontroller.reset()\r")
        link.drain(_QUIET_S)
    except ConnectionLost:
        pass  # it has gone: that is what a reset looks like
    finally:
        link.close()


def last_words(port: str) -> str:
    """Run the program once more, to hear why it ends: the last line of an error, or "". Raises DeployError."""
    interrupt(port)
    link = Link(open_port(port))
    try:
        link.write(prompt.RESTART)
        heard = b""
        end = time.monotonic() + _START_S
        while not any(sign in heard for sign in _ENDED) and time.monotonic() < end:
            heard += link.drain(_QUIET_S, _LAST_WORDS_S)
    finally:
        link.close()
    text = heard.decode("utf-8", "replace")
    said = [
        line.strip() for line in text.splitlines() if "Error" in line or line.startswith(("mirrormount", "mountfw:"))
    ]
    return printable(said[-1]) if said else ""
