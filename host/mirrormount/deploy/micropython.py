"""`mirrormount deploy` and `undeploy`: the firmware onto a MicroPython board, and off it.

A CircuitPython board has its own way, through its drive: circuitpython.py. Here the one or the other is chosen.
mpremote.py does the work on the board, in two calls of mpremote: survey, then upload, commit and reset.
micropython_plan.py decides what has to be done; on_board.py says why a power cut leaves one whole firmware.
"""

import dataclasses
import os
import sys
import time
from collections.abc import Callable
from typing import Any

from serial.tools import list_ports

from mirrormount.common.errors import DeployError, NoBoardFound, SeveralBoardsFound, WrongDrive
from mirrormount.common.printable import printable
from mirrormount.common.progress import Progress
from mirrormount.common.supported import MICROPYTHON, text
from mirrormount.deploy import circuitpython, prompt
from mirrormount.deploy.board_file import check_board_file, read_pins
from mirrormount.deploy.fileset import THIS, board_choice, boards, firmware, firmware_hash
from mirrormount.deploy.handshake import STATUS, Options, quiet
from mirrormount.deploy.micropython_plan import Plan, plan
from mirrormount.deploy.micropython_trial import before, settle, try_it
from mirrormount.deploy.mpremote import Mpremote
from mirrormount.deploy.stop_answer import StopAnswer, stop_answered
from mirrormount.transport.circuitpy_drives import Drive, drive_at, find_bootloaders, find_drives
from mirrormount.transport.circuitpy_ports import serial_number
from mirrormount.transport.find import find_micropython, find_one
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_port

FLASH_IT = (
    "MicroPython goes on first: hold BOOTSEL while plugging in and drop the .uf2 for the board on the drive that"
    " appears (micropython.org/download), or run: uvx mpflash flash"
)
OR_CIRCUITPYTHON = "; or CircuitPython in the same way (circuitpython.org/downloads)"
_SPARE_BLOCKS = 4  # room that the file system needs to rename and to write the journal


def deploy(options: Options, progress: Progress | None = None) -> str:
    """Put the firmware on the board. Returns one line for the user.

    Raises DeployError, CannotOpen, ConnectionLost: the board then has what it had, or says so at the next boot.
    """
    progress = progress or Progress()
    this = _board_choice(options)
    if drive := choose(options):
        return circuitpython.deploy(drive, this, options, progress)
    port = _find(options.port)
    with stop_answered(port) as answer:
        return _deploy(port, this, options, progress, answer)


def _deploy(port: str, this: dict[str, bytes], options: Options, progress: Progress, stop_answer: StopAnswer) -> str:
    started = time.monotonic()
    progress.phase("looking at the board")
    answered = _approach(port, options.stop, stop_answer)
    board = Mpremote(port)
    with board.reset_if_it_fails():
        there = board.survey()
        _check_version(there["version"], progress)
        if there["undo"]:  # a deploy was cut before its firmware had answered
            board.forget() if answered else board.revert()
            there = board.survey()
        progress.phase("compiling")
        wanted = firmware(None if options.source else there["mpy"]) | this
        if options.board and options.board not in (known := boards([*wanted, *there["files"]])):
            raise DeployError(f"there is no board file {options.board!r}, only {', '.join(known)}")
        check_board_file(there["machine"], {*wanted, *there["files"]})
        todo = plan(wanted, there["files"], there["manifest"], may_replace(options), there["aside"])
        _check_room(todo, there)
        board.install(todo, progress)
    progress.phase("restarting")
    runs = {firmware_hash(todo.after)}
    identity, axes = try_it(board, port, runs, before(there), progress)
    left = settle(board, port, runs) if todo.journal or there["kept"] else ""
    files = f"{len(wanted)} files ({len(wanted) - todo.changed} unchanged)"
    kept = f"; the main.py that was there is now {todo.backup}" if todo.backup else ""
    return f"OK: {identity}, {axes} axes, {files} in {time.monotonic() - started:.1f} s{kept}{left}"


def undeploy(options: Options, progress: Progress | None = None) -> str:
    """Take off the board what deploy has put there, and nothing else. Returns one line for the user."""
    progress = progress or Progress()
    if drive := choose(options):
        return circuitpython.undeploy(drive, options, progress)
    port = _find(options.port)
    with stop_answered(port) as answer:
        _approach(port, options.stop, answer)
        progress.phase("looking for what deploy has put there, to remove it")
        board = Mpremote(port)
        with board.reset_if_it_fails():
            done = board.undeploy()
    if not done["found"]:
        raise DeployError("this board has no firmware that deploy has put there: nothing was removed")
    back = f"; there again: {printable(', '.join(done['restored']))}" if done["restored"] else ""
    kept = f"; kept, because changed since: {printable(', '.join(done['kept']))}" if done["kept"] else ""
    return f"OK: {len(done['removed'])} files removed{back}{kept}"


def choose(options: Options) -> Drive | None:
    """The CircuitPython drive that is meant, or None for a MicroPython board.

    Raises WrongDrive, SeveralBoardsFound.
    """
    if options.drive is not None:
        drive = drive_at(options.drive)
        named = _named(options.port) if options.port is not None else None
        if named is None:
            return drive
        if drive.uid and drive.uid != serial_number(named):
            raise WrongDrive(f"{drive} and {options.port} are not of one board: their serial numbers differ")
        return dataclasses.replace(drive, uid=serial_number(named), vouched=True)
    drives = find_drives()
    if options.port is not None:
        named = _named(options.port) if drives else None
        found = [d for d in drives if named is not None and d.uid and d.uid == serial_number(named)]
        if len(found) > 1:
            raise SeveralBoardsFound(
                f"several drives say that {options.port} is theirs, name one: "
                + ", ".join(f"--drive {drive}" for drive in found)
            )
        return dataclasses.replace(found[0], vouched=True) if found else None
    others = [device for device, _ in find_micropython()] if drives else []
    if len(drives) + len(others) > 1:
        names = [*others, *(f"--drive {drive}" for drive in drives)]
        raise SeveralBoardsFound(f"several boards found, name one: {', '.join(names)}")
    return drives[0] if drives else None


def _named(address: str) -> Any:
    """The port of this name among the system's, or None."""
    port = os.path.realpath(address) if os.path.exists(address) else address
    return next((found for found in list_ports.comports() if found.device == port), None)


def _board_choice(options: Options) -> dict[str, bytes]:
    """The file boards/this.py that --board or --pins stands for, if there is one. Raises DeployError."""
    if options.board:
        if not options.board.isidentifier():
            raise DeployError(
                f"a board's name is that of its file, for instance pico, not '{printable(options.board)}'"
            )
        return {THIS: board_choice(options.board)}
    return {THIS: read_pins(options.pins)} if options.pins else {}


def _check_version(version: list[int], progress: Progress) -> None:
    found = (version[0], version[1])
    if MICROPYTHON.too_old(found):
        raise DeployError(
            f"this board runs MicroPython {text(found)}: {text(MICROPYTHON.lowest)} or later is needed; nothing was"
            f" changed. {FLASH_IT}"
        )
    if MICROPYTHON.untried(found):
        progress.phase(f"MicroPython {text(found)} is newer than any that was tried ({MICROPYTHON.span})")


def _check_room(todo: Plan, there: dict) -> None:
    free, block = there["room"]
    sizes = [*map(len, todo.upload.values()), *(there["sizes"].get(path, 0) for path in todo.keep)]
    need = sum(-(-size // block) * block for size in sizes) + _SPARE_BLOCKS * block
    if todo.upload and need > free:
        raise DeployError(f"the board's flash is full: {need // 1024} KB are needed, {free // 1024} KB are free")


def may_replace(options: Options) -> Callable[[str], bool]:
    """What plan() asks about somebody else's main.py: --replace-main, or whoever sits at the terminal."""

    def ask(copy: str) -> bool:
        if options.replace_main:
            return True
        if not (sys.stdin and sys.stdin.isatty()):
            return False
        print(
            f"The board has a main.py of somebody else. Replace it (a copy stays as {copy})? [y/N] ",
            end="",
            file=sys.stderr,
            flush=True,
        )
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    return ask


def _find(address: str | None) -> str:
    if address is None:
        try:
            return find_one()
        except NoBoardFound as e:
            loaders = "".join(f" The drive {path} is a bootloader, not yet a board." for path in find_bootloaders())
            raise NoBoardFound(f"no board found.{loaders} A new one shows no port: {FLASH_IT}{OR_CIRCUITPYTHON}") from e
    if "://" in address:
        raise DeployError(
            f"deploy and undeploy need a serial port, not {printable(address)}: mirrormount ports lists them"
        )
    return address


def _approach(port: str, stop: bool, stop_answer: StopAnswer) -> bool:
    """See to it that a MicroPython is there and no motor moves. Sends no stop unless told to.

    True if the firmware answered. Raises DeployError. The board is left at its prompt.
    """
    link = Link(open_port(port))
    try:
        stop_answer.asking(link)
        link.drain(0.1)
        heard = quiet(link, stop)
        answered = bool(STATUS.search(heard))
        stop_answer.found(at_rest=answered)
        with prompt.restarted_on_interruption(link):
            if not answered:
                heard += prompt.look(link)
                if "CircuitPython" in heard:
                    raise DeployError(
                        "this board runs CircuitPython, and its drive is not mounted here: mount it, or say --drive"
                    )
                if prompt.SIGN.decode() not in heard:
                    raise DeployError(f"no Python answers on this board. {FLASH_IT}")
            _check_prompt(link)
    finally:
        link.close()
    return answered


def _check_prompt(link: Link) -> None:
    """Interrupt what runs, and see that the prompt takes programs. Raises DeployError; then the firmware goes on."""
    works, heard = prompt.takes_programs(link)
    if works:
        return
    if b"(virtual board)" in heard:
        raise DeployError("this virtual board has no MicroPython prompt: start it with --machine micropython")
    raise DeployError(
        "no MicroPython prompt comes at this port, so nothing was changed: a virtual board has one if it is started"
        " with --machine micropython; a CircuitPython board takes the firmware by its drive"
    )
