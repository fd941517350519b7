"""The board's own Python prompt in mpremote's terminal, with the mount at it.

What `m` is there is mountfw/repl.py. The firmware is interrupted meanwhile and started again after.
"""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator

from mirrormount.common.child_python import python_module
from mirrormount.common.errors import AtPrompt, BadAddress, FirmwareMissing, MountError, NoAnswer, NotAMount, PortBusy
from mirrormount.deploy import prompt
from mirrormount.device.mount import Mount
from mirrormount.transport.find import find_one
from mirrormount.transport.lines import TAKEN, Link
from mirrormount.transport.open import open_port
from mirrormount.transport.stop_socket import SENT, StopListener, supported

_GET_M = "from mountfw.repl import m"
_HELP = """\
m is the mount: m.x.step(5)  m.x.move_to(0)  m.y.jog(-0.3, ms=800)  m.drive(0, 255, ms=500)  m.status()  m.stop()
Ctrl-C stops a move. Ctrl-] (or Ctrl-x) leaves, and the firmware starts again."""
_START_S = 10.0  # the longest time until the firmware runs, after a soft reset


def open_prompt(address: str | None) -> None:
    """Interrupt the firmware, open the prompt, start the firmware again. Raises MountError."""
    port = find_one() if address is None else address
    if "://" in port:
        raise BadAddress(f"{port}: the board's prompt needs a serial port")
    if not (sys.stdin and sys.stdin.isatty()):
        raise MountError("repl needs a terminal to type in")
    link = Link(open_port(port))
    try:
        _interrupt(link)
        try:
            _check(link)
            link.close()  # mpremote opens it now
            print(_HELP, flush=True)
            with _stops_taken(port):
                status = subprocess.call(python_module("mpremote", "connect", port, "resume", "exec", _GET_M, "repl"))
        finally:
            link.close()
            link = Link(open_port(port))
            print(f"{_start(link)}: started again", flush=True)
        if status:
            raise MountError(f"mpremote has failed (exit status {status})")
    finally:
        link.close()


@contextlib.contextmanager
def _stops_taken(port: str) -> Iterator[None]:
    """While mpremote has the port: `mirrormount stop` types Ctrl-C, which ends a move at the prompt, motors off."""
    if not supported():  # nor could a port be opened twice there
        yield
        return
    beside = os.open(port, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)  # mpremote locks the port, and reads it alone

    def interrupt() -> str:
        os.write(beside, b"\x03")
        return SENT

    listener = StopListener([port], interrupt)
    try:
        yield
    finally:
        listener.close()
        os.close(beside)


def _interrupt(link: Link) -> None:
    """Stop the motors and the firmware. Returns at the prompt; raises NotAMount if none comes."""
    link.write(b"!\n")
    if TAKEN.encode() in link.drain(0.1):
        raise PortBusy("another program drives this board")
    heard = prompt.interrupt(link)
    if prompt.SIGN not in heard:
        raise NotAMount(f"no Python prompt comes; it answered {heard[-60:]!r}" if heard else "nothing answers")


def _check(link: Link) -> None:
    """See whether m can be had, before a terminal fills with a traceback. Raises FirmwareMissing, MountError."""
    link.drain(0.1)
    link.write(_GET_M.encode() + b"\r")
    said = prompt.receive(link, b"\n>>> ").decode("ascii", "replace")
    if "Traceback" in said:
        why = said.strip().removesuffix(">>>").strip().splitlines()[-1]
        if "ImportError" in why:
            raise FirmwareMissing(f"this board's firmware has no prompt control ({why}): deploy it")
        raise MountError(f"the board's prompt has no mount: {why}")


def _start(link: Link) -> str:
    """A soft reset. Returns the firmware's identity; raises what Mount raises if it does not start."""
    _interrupt(link)
    link.write(prompt.RESTART)
    prompt.receive(link, b"soft reboot")
    end = time.monotonic() + _START_S
    while True:
        try:
            return Mount(link).identity
        except (AtPrompt, FirmwareMissing):
            raise
        except (NotAMount, NoAnswer):  # its first words
            if time.monotonic() > end:
                raise
