"""`mirrormount deploy`, `undeploy`, `repl`, `send`: the firmware on a board, its Python prompt, one command line.

The prompt is the board's own, in mpremote's terminal, with the mount as m (mountfw/repl.py); the firmware is
interrupted meanwhile and started again after it. What `send` prints on stdout are the board's answers; how a motion
ended goes to stderr.
"""

import argparse
import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from mirrormount.cli.arguments import Command, board_port, open_mount, port_of, port_options
from mirrormount.cli.motion import place, watched
from mirrormount.deploy import prompt
from mirrormount.device.axis import Axis
from mirrormount.device.mount import Mount
from mirrormount.device.session import LONGEST, keep_alives_ms, starts_motion, with_keep_alive
from mirrormount.device.status import Status
from mirrormount.errors import (
    REASONS,
    AtPrompt,
    BadAddress,
    BadValue,
    BoardError,
    FirmwareMissing,
    MountError,
    NoAnswer,
    NotAMount,
    PortBusy,
)
from mirrormount.terminal import ended_in_order, python_module
from mirrormount.transport.discovery import find_one
from mirrormount.transport.link import TAKEN, Link
from mirrormount.transport.ports import open_port
from mirrormount.transport.stop_socket import SENT, StopListener, supported
from mountfw import codes as wire

_GET_M = "from mountfw.repl import m"
_HELP = """\
m is the mount: m.x.step(5)  m.x.move_to(0)  m.y.jog(-0.3, ms=800)  m.drive(0, 255, ms=500)  m.status()  m.stop()
Ctrl-C stops a move. Ctrl-] (or Ctrl-x) leaves, and the firmware starts again."""
_START_S = 10.0  # the longest time until the firmware runs, after a soft reset
_POLL_S = 0.05  # between two questions whether a motion is over


# ---- deploy, undeploy


def board_options(parser: argparse.ArgumentParser) -> None:
    """Which board, and whether its motors may be stopped: for deploy and undeploy."""
    board_port(parser)
    parser.add_argument(
        "--drive", type=Path, metavar="PATH", help="a CircuitPython board's drive (default: the one there is)"
    )
    parser.add_argument("--stop", action="store_true", help="stop the motors first if they move")


def deploy_arguments(parser: argparse.ArgumentParser) -> None:
    """Which board, which firmware, and whether another program on the board may be replaced."""
    board_options(parser)
    parser.add_argument("--source", action="store_true", help="plain .py files instead of compiled ones")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--board", metavar="NAME", help="use mountfw/boards/NAME.py instead of the board's own")
    which.add_argument("--pins", type=Path, metavar="FILE", help="use this board file (see mountfw/boards/pico.py)")
    parser.add_argument(
        "--replace-main", action="store_true", help="replace somebody else's main.py or code.py (a copy stays)"
    )


def run_deploy(args: argparse.Namespace) -> None:
    """Deploy, and print the outcome in one line. Raises MountError; the board then has the firmware that it had."""
    from mirrormount.deploy.micropython import deploy
    from mirrormount.deploy.prompt import Options

    options = Options(port_of(args), args.stop, args.source, args.board, args.pins, args.replace_main, args.drive)
    with ended_in_order():
        print(deploy(options))


def run_undeploy(args: argparse.Namespace) -> None:
    """Remove the files that deploy has put there, and print the outcome in one line. Raises MountError."""
    from mirrormount.deploy.micropython import undeploy
    from mirrormount.deploy.prompt import Options

    with ended_in_order():
        print(undeploy(Options(port_of(args), args.stop, drive=args.drive)))


# ---- repl


def run_repl(args: argparse.Namespace) -> None:
    """Open the prompt in this terminal; the firmware starts again after it. Raises MountError."""

    with ended_in_order():
        _open_prompt(port_of(args))


def _open_prompt(address: str | None) -> None:
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


# ---- send


def send_arguments(parser: argparse.ArgumentParser) -> None:
    """LINE, and whether the motion that it starts is awaited."""
    port_options(parser)
    parser.add_argument("line", metavar="LINE")
    parser.add_argument(
        "--no-wait",
        dest="wait",
        action="store_false",
        help="do not wait for its motion: it goes on without this program",
    )


def run_send(args: argparse.Namespace) -> None:
    """Send the line, print its answers, and wait for the motion that it starts. Raises MountError."""
    mount = open_mount(args)
    # a stop that comes before the line is for its motion, too
    with mount if args.wait else contextlib.closing(mount), mount.unless_stopped(since_open=True):
        (_send_line if args.wait else _start_line)(mount, args.line)


def _send_line(mount: Mount, line: str) -> None:
    """Send the line, print what it answers, and wait until nothing that it started moves any more.

    Raises BoardError for the first command of it that cannot be done, MountError if something moved then, or if a
    motion did not end as done.
    """
    _check_length(line)
    moves = starts_motion(line)
    keep_alives = keep_alives_ms(line)
    if moves and not keep_alives:
        line = with_keep_alive(line)
    poll_s = min([_POLL_S, *(ms / 5000 for ms in keep_alives if ms)])
    with watched(mount, list(mount.by_name.values())) as shown:
        status = _sent(mount, line)
        axes = _moving(mount, status)
        while status.moving:
            shown.show(", ".join(place(axis, status.by_name[axis.name]) for axis in axes) + "; Ctrl-C stops")
            mount.link.sleep(poll_s)
            status = mount.status()
    errors = mount.errors()
    reasons = {axis.name: axis.last_move().reason for axis in axes}
    failed = [f"{name}: {REASONS.get(reason, reason)}" for name, reason in reasons.items() if reason != wire.DONE]
    if failed or errors:
        ended = MountError("; ".join([*failed, *(f"the board says {error}" for error in errors)]))
        ended.codes = tuple(error.code for error in errors)
        raise ended
    if moves:
        moved = axes or list(mount.by_name.values())
        print("done; " + ", ".join(place(axis, status.by_name[axis.name]) for axis in moved), file=sys.stderr)


def _start_line(mount: Mount, line: str) -> None:
    """Send the line and print what it answers; what it starts goes on without this program, and that is said.

    Its only bounds are the board's limits, and a keep-alive that the line sets. Raises as send() does; then, and
    when it is interrupted, both motors are stopped.
    """
    if hasattr(mount.link.port, "simulation"):
        raise BadValue("this virtual board ends with this program, and its motion too: leave --no-wait out")
    _check_length(line)
    try:
        if axes := _moving(mount, _sent(mount, line)):
            names = " and ".join(axis.name for axis in axes)
            print(f"{names}: still moving; {_bounds(mount, keep_alives_ms(line))}", file=sys.stderr)
    except BaseException:
        with contextlib.suppress(MountError):
            mount.stop()
        raise


def _check_length(line: str) -> None:
    if len(line) > LONGEST:
        raise BadValue(f"a command line has at most {LONGEST} characters here, not {len(line)}")


def _send(mount: Mount, line: str) -> Status:
    if answers := mount.send(line, keep_alive=False):
        print(answers, flush=True)
    return mount.status()


def _sent(mount: Mount, line: str) -> Status:
    """As _send(). If a command is refused, what those before it have started is stopped, and that is told."""
    try:
        return _send(mount, line)
    except BoardError as e:
        if not (axes := _moving(mount, mount.status())):
            raise
        mount.stop()
        status = mount.status()
        places = ", ".join(place(axis, status.by_name[axis.name]) for axis in axes)
        ended = MountError(f"{e}; what the line had started before was stopped at {places}")
        ended.codes = e.codes
        raise ended from e


def _moving(mount: Mount, status: Status) -> list[Axis]:
    return [axis for axis in mount.by_name.values() if status.by_name[axis.name].moving]


def _bounds(mount: Mount, keep_alives: list[int]) -> str:
    """What ends a motion that nobody waits for."""
    if keep_alives and keep_alives[-1]:
        return f"the board stops it {keep_alives[-1]} ms after the last byte of this program (keep-alive)"
    run_s, search_s = (max(axis.ask_whole(query)[0] for axis in mount.axes) / 1000 for query in ("XM?", "XT?"))
    return (
        "it goes on without this program, except on CircuitPython boards, which see the port close, and behind"
        f" mirrormount serve without --on-leave finish: a run for {run_s:g} s at most, a search for a switch for"
        f" {search_s:g} s under drive at most, a move until its steps are made; mirrormount stop ends it"
    )


COMMANDS = (
    Command(
        "deploy", "put the firmware on a board that runs MicroPython or CircuitPython", run_deploy, deploy_arguments
    ),
    Command("undeploy", "take off a board what deploy has put there", run_undeploy, board_options),
    Command("repl", "the board's own Python prompt, with the mount at it as m", run_repl, board_port),
    Command("send", "send one command line of docs/protocol.md, for instance 2XI1 or 2TP?", run_send, send_arguments),
)
