"""`mirrormount deploy` and `undeploy` for a CircuitPython board: files to its drive, commands to its serial ports.

circuitpython_plan.py computes the steps, circuitpython_copy.py executes them. Before that the program is interrupted on
the console: at its prompt CircuitPython does not restart a program whose files change.
"""

import contextlib
import re
import sys
import time
from collections.abc import Callable, Iterator

from serial.tools import list_ports

from mirrormount.common.errors import (
    CannotOpen,
    ConnectionLost,
    DeployError,
    DriveFailed,
    FirmwareFailed,
    MountError,
    NoAnswer,
    NotSeenRunning,
    WrongDrive,
)
from mirrormount.common.printable import printable
from mirrormount.common.progress import Progress
from mirrormount.common.supported import CIRCUITPYTHON
from mirrormount.deploy import circuitpython_console
from mirrormount.deploy.board_file import check_board_file
from mirrormount.deploy.circuitpython_copy import (
    WayBack,
    check_room,
    check_writable,
    install,
    kept_sources,
    remove,
    survey,
)
from mirrormount.deploy.circuitpython_plan import CODE, belongs, drive_plan, motor_library
from mirrormount.deploy.fileset import boards, sources
from mirrormount.deploy.handshake import Options, ask, check, quiet
from mirrormount.deploy.known import answers
from mirrormount.deploy.on_board import MANIFEST
from mirrormount.transport import volumes
from mirrormount.transport.circuitpy_drives import Drive, check_version, find_drives, untried
from mirrormount.transport.circuitpy_files import Files
from mirrormount.transport.circuitpy_ports import Channels, channels, namesakes, unproven
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_port

_BACK_S = 30.0  # for a reset: 1 s of safe-mode wait, 1 s before boot_out.txt, USB, and the imports
_BY_HAND_S = 60.0  # for a person to find and press the reset button
_AGAIN_S = 0.2
_IDENTITY = re.compile(r"mirrormount,([^,]*),[^,]*,([^\s,]+)")


def deploy(drive: Drive, this: dict[str, bytes], options: Options, progress: Progress) -> str:
    """Put the firmware on the drive, with the files `this`, which choose the board file. Returns one line for the user.

    Raises DeployError, CannotOpen, ConnectionLost; the message says what is on the drive then.
    """
    started = time.monotonic()
    check_version(drive)
    if untried(drive):
        progress.phase(f"CircuitPython {drive.version} is newer than any that was tried ({CIRCUITPYTHON.span})")
    _check_claims(drive)
    wanted = sources("circuitpython") | motor_library() | this
    files = Files(drive.path)
    progress.phase(f"looking at {drive}")
    there, sizes, old = survey(files)
    if old.damage:
        progress.phase(f"{MANIFEST} on the drive is not as deploy writes it, so it does not count: {old.damage}")
    if options.board and options.board not in (known := boards([*wanted, *there])):
        raise DeployError(f"there is no board file {options.board!r}, only {', '.join(known)}")
    check_board_file(drive.board_id, {*wanted, *there})
    todo = drive_plan(wanted, there, old, may_replace(options))
    check_room(todo, sizes, _room(drive))
    expected = answers(wanted | kept_sources(files, todo, wanted))
    if todo.nothing:
        told = _already(drive, options.stop, expected)
    else:
        with _at_prompt(drive, options.stop) as ports:
            back = WayBack(files, todo)
            install(files, todo, progress)
            longest_s = _restart(ports, progress)
        try:
            told = _listen(drive, expected, longest_s)
        except FirmwareFailed as e:
            ours = belongs(CODE, there, old)
            raise FirmwareFailed(f"{e}; {_put_back(drive, back, ports, ours, progress)}") from e
    count = f"{len(wanted)} files ({len(wanted) - todo.changed} unchanged)"
    kept = "".join(f"; the {path} that was there is now {copy}" for path, copy in todo.aside.items())
    return f"OK: {told}, {count} in {time.monotonic() - started:.1f} s{kept}"


def undeploy(drive: Drive, options: Options, progress: Progress) -> str:
    """Remove what deploy has put on the drive, and nothing else. Returns one line for the user.

    Raises DeployError, CannotOpen, ConnectionLost.
    """
    files = Files(drive.path)
    _check_claims(drive)
    old = survey(files)[2]
    if not old.files:
        why = f" ({MANIFEST} there is not as deploy writes it: {old.damage})" if old.damage else ""
        raise DeployError(f"{drive} has no firmware that deploy has put there{why}: nothing was removed")
    check_writable(_room(drive))
    with _at_prompt(drive, options.stop) as ports:
        progress.phase("removing")
        removed, kept, restored = remove(files)
        if ports.console:
            circuitpython_console.reset(ports.console)
    again = "" if ports.console else "; now press the board's reset button"
    back = f"; there again: {', '.join(restored)}" if restored else ""
    changed = f"; kept, because changed since: {', '.join(kept)}" if kept else ""
    return f"OK: {len(removed)} files removed{back}{changed}{again}"


def may_replace(options: Options) -> Callable[[dict[str, str]], bool]:
    """The question of drive_plan() about other people's files, answered by --replace-main or at the terminal."""

    def ask_user(aside: dict[str, str]) -> bool:
        if options.replace_main:
            return True
        if not (sys.stdin and sys.stdin.isatty()):
            return False
        names, copies = ", ".join(sorted(aside)), ", ".join(sorted(aside.values()))
        question = f"The drive has files of somebody else: {names}. Replace them (copies stay as {copies})? [y/N] "
        print(question, end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    return ask_user


def _room(drive: Drive) -> volumes.Room:
    try:
        return volumes.room(drive.path)
    except OSError as e:
        raise DriveFailed(f"{drive} does not work, or has gone ({e.strerror or e}); nothing was changed") from e


def _channels(drive: Drive) -> Channels:
    return channels(drive, list_ports.comports())


def _check_claims(drive: Drive) -> None:
    """Raise WrongDrive if the drive's serial ports are not certain: another instrument may be connected there."""
    if others := [] if drive.vouched else namesakes(drive, find_drives()):
        names = ", ".join(str(other) for other in others)
        raise WrongDrive(f"{drive} has the same UID as {names}: nothing was changed; unplug all but one")
    if claimed := unproven(drive, list_ports.comports()):
        raise WrongDrive(
            f"{drive} says that {' and '.join(claimed)} is its board's, and nothing else says so: nothing was sent"
            f" there; if it is, name it as well: mirrormount deploy {claimed[0]} --drive {printable(str(drive.path))}"
        )


@contextlib.contextmanager
def _at_prompt(drive: Drive, stop: bool) -> Iterator[Channels]:
    """Check that no motor moves, and interrupt the program. Gives the ports; within, the board is to be restarted.

    Raises DeployError, CannotOpen.
    """
    ports = _channels(drive)
    if drive.has_mountfw and ports.protocol:  # another program must not get this query
        link = Link(open_port(ports.protocol))
        try:
            link.drain(0.1)
            quiet(link, stop)
        finally:
            link.close()
    with _restart_if_it_fails(ports):
        if ports.console:
            circuitpython_console.interrupt(ports.console)
        yield ports


@contextlib.contextmanager
def _restart_if_it_fails(ports: Channels) -> Iterator[None]:
    """If what is done at the prompt fails or is ended, restart the board.

    It then runs its old program, or the code.py that does nothing.
    """
    try:
        yield
    except BaseException:
        if ports.console:
            with contextlib.suppress(MountError):
                circuitpython_console.reset(ports.console)
        raise


def _already(drive: Drive, stop: bool, expected: tuple[str, ...]) -> str:
    """For a drive that needs no change: ask for the hash of what runs, and restart the board only if it differs."""
    with contextlib.suppress(NotSeenRunning):
        return _listen(drive, expected, 0.0)
    with _at_prompt(drive, stop) as ports:
        longest_s = _restart(ports, Progress())
    return _listen(drive, expected, longest_s)


def _restart(ports: Channels, progress: Progress) -> float:
    """Restart the board, or ask the user to. Returns how long it may take to answer, in seconds."""
    if ports.console:
        progress.phase("restarting")
        circuitpython_console.reset(ports.console)
        return _BACK_S
    progress.phase("the files are on the drive; no console of this board is here: press its reset button now")
    return _BY_HAND_S


def _put_back(drive: Drive, back: WayBack, ports: Channels, ours: bool, progress: Progress) -> str:
    """Restore the files that were on the drive. Returns the result in words. ours: it was a firmware of a mount."""
    progress.phase("the new firmware does not start; putting back the files that were there")
    if not ports.console:
        return "the new files are on the drive"
    try:
        with _restart_if_it_fails(ports):
            circuitpython_console.interrupt(ports.console)
            back.go(progress)
            circuitpython_console.reset(ports.console)
    except MountError as e:
        return f"the files that were there could not be put back ({e}): deploy again"
    if not ours:
        return "it was taken off again: what was on the drive before is back"
    try:
        _listen(drive, None, _BACK_S)
    except DeployError:
        return "the firmware that was there before is back, but does not answer"
    return "the firmware that was there before is back and answers"


def _listen(drive: Drive, expected: tuple[str, ...] | None, longest_s: float) -> str:
    """Wait until the board answers XF? with one of the hashes. Returns "board, mountfw version, n axes, …".

    expected: the hashes; None: any. The board's ports disappear meanwhile and may return under other names.
    Raises FirmwareFailed with the board's own error if the firmware does not start, else NotSeenRunning.
    """
    end = time.monotonic() + longest_s
    why = "no port of it was seen"
    while True:
        if device := (ports := _channels(drive)).protocol:
            try:
                return _identity(device, expected)
            except (CannotOpen, ConnectionLost, NoAnswer, DeployError) as e:
                why = str(e)
        if time.monotonic() >= end:
            break
        time.sleep(_AGAIN_S)
    if longest_s and ports.console:
        said = ""
        with contextlib.suppress(MountError), _restart_if_it_fails(ports):
            said = circuitpython_console.last_words(ports.console)
        if said:
            raise FirmwareFailed(f"the firmware on the board does not start; it says: {said}")
    raise NotSeenRunning(
        "the files are on the drive and were read back as sent, but the board has not confirmed that it runs them"
        f" ({why}): press its reset button, then deploy again, which only asks"
    )


def _identity(device: str, expected: tuple[str, ...] | None) -> str:
    link = Link(open_port(device))
    try:
        link.drain(0.1)
        answer = ask(link, b"*IDN?\n")
        found = _IDENTITY.search(answer)  # on a console there may be other text before it
        if not found:
            raise DeployError(f"{device} says {answer.strip()[-60:]!r}" if answer.strip() else f"{device} is silent")
        axes, told = check(link, expected)
        what = "checksum (it has no SHA-256)" if told.startswith("crc32-") else "hash"
        who = printable(f"{found[1]}, mountfw {found[2]}")
        return f"{who}, {axes} axes, the board tells the {what} of what was sent"
    finally:
        link.close()
