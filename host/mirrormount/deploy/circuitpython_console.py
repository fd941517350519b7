"""The console of a CircuitPython board: interrupt the program, and restart the board."""

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
_ENDED = (b"Code done running", b"Press any key", b">>> ")  # CircuitPython's output after a program
_KEYS = 8  # times that a key is sent between two Ctrl-C


def interrupt(port: str) -> None:
    """Interrupt the program, whose `finally` turns the motors off, and wait for the prompt. Raises DeployError.

    At the prompt CircuitPython does not reload when the drive is written to. It stays there after the port is closed.
    """
    link = Link(open_port(port))
    try:
        end = time.monotonic() + _PROMPT_S
        while time.monotonic() < end:
            link.write(prompt.INTERRUPT)
            received = link.drain(_QUIET_S)
            # A second Ctrl-C at once would interrupt the program's `finally`. After the program any key opens the
            # prompt, and Ctrl-B leaves a raw prompt.
            for _ in range(_KEYS):
                link.write(b"\r" + prompt.FRIENDLY)
                received = received[-200:] + link.drain(_QUIET_S)
                if received.rstrip().endswith(prompt.SIGN):
                    return
    finally:
        link.close()
    raise DeployError(
        f"the program on the board does not stop for Ctrl-C on {port}: nothing was changed; press its reset button"
        " and try again"
    )


def reset(port: str) -> None:
    """Reset the board from its prompt, as its button does: a soft reset would not run boot.py."""
    link = Link(open_port(port))
    try:
        link.write(b"\r" + prompt.INTERRUPT + prompt.FRIENDLY)
        link.drain(_QUIET_S)
        link.write(b"import microcontroller\r")
        link.drain(_QUIET_S)
        link.write(b"microcontroller.reset()\r")
        link.drain(_QUIET_S)
    except ConnectionLost:
        pass  # the reset closes the port
    finally:
        link.close()


def last_words(port: str) -> str:
    """Run the program once more. Returns the last line of its error, or "". Raises DeployError."""
    interrupt(port)
    link = Link(open_port(port))
    try:
        link.write(prompt.RESTART)
        received = b""
        end = time.monotonic() + _START_S
        while not any(sign in received for sign in _ENDED) and time.monotonic() < end:
            received += link.drain(_QUIET_S, _LAST_WORDS_S)
    finally:
        link.close()
    text = received.decode("utf-8", "replace")
    said = [
        line.strip() for line in text.splitlines() if "Error" in line or line.startswith(("mirrormount", "mountfw:"))
    ]
    return printable(said[-1]) if said else ""
