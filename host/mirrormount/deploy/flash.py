"""`mirrormount flash`: an empty board, or one with another program, becomes a mount: MicroPython, then a deploy.

The boot loader of an RP2040 and an RP2350 is in ROM: it shows a drive (held BOOTSEL while plugging in), takes a .uf2
that is copied there, and restarts the board, whereupon the drive goes. So a cut at any moment can be repaired by doing
it again. Once MicroPython runs, micropython.deploy() does the rest.
"""

import contextlib
import errno
import hashlib
import logging
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from mirrormount.deploy import esp, uf2
from mirrormount.deploy.micropython import Mpremote, chosen_board, deploy
from mirrormount.deploy.prompt import STATUS, Options, quiet, restarted_on_interruption, stop_answered, takes_programs
from mirrormount.errors import (
    CannotOpen,
    DeployError,
    DriveFailed,
    DriveFull,
    DriveReadOnly,
    ImageMissing,
    MountError,
    MpremoteError,
    NoBoardFound,
    NoBootloader,
    NotSeenAgain,
    SeveralBoardsFound,
    WrongDrive,
    WrongImage,
)
from mirrormount.files import cache
from mirrormount.supported import DOWNLOADS, Download, text
from mirrormount.terminal import Progress, printable
from mirrormount.transport.discovery import (
    Bootloader,
    find_bootloaders,
    find_micropython,
    read_bootloader,
    room,
    serial_ports,
    unmounted_bootloaders,
)
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_port

_USUAL = "RP2040"  # the chip of a board that has yet to go to its boot loader
_NAME = "mirrormount.uf2"  # of the copy on the drive; a boot loader asks for none
_PIECE = 1 << 16  # bytes that are written at once
_DRIVE_S = 30.0  # until the drive of a board that was sent to its boot loader is mounted
_PORT_S = 30.0  # until the port of MicroPython comes: about 2 s, at its first start after it has made a file system
_AGAIN_S = 0.1  # between two looks: no event that all systems have shows that a drive or a port has come
_READ_ONLY = (errno.EROFS, errno.EACCES, errno.EPERM)


def flash(
    options: Options, image: Path | None, offline: bool, ask: Callable[[str], bool], progress: Progress | None = None
) -> tuple[str | None, str]:
    """Make a board a mount. Returns its port, and one line for the user; no port where the deploy is left to him.

    options: those of the deploy; port is the board's now, or where it will be, drive that of its boot loader. image:
    None for the one that is known for the chip. ask: may what runs on a board be replaced?
    Raises DeployError, CannotOpen.
    """
    progress = progress or Progress()
    chosen_board(options)  # its faults are told before anything is written
    if options.port and "://" in options.port:
        raise DeployError(f"flash needs a serial port, not {printable(options.port)}: mirrormount ports lists them")
    if image is not None and esp.is_image(image):
        return None, esp.write(image, options.port, progress)
    board = _drive(options) or _port(options.port)
    path = image or fetch(_USUAL if isinstance(board, str) else board.chip, offline, progress)
    found = uf2.read_image(path)
    tried = "" if found.family == uf2.RP2040 else ", not tried on hardware"
    progress.phase(f"MicroPython {text(found.version)} for a {found.machine or found.chip}{tried}")
    drive = _sent(board, options.stop, ask, progress) if isinstance(board, str) else board
    check_chip(found, drive)
    before = {port.device for port in serial_ports()}
    failed = copy(path.read_bytes(), drive, progress)
    port = _back(options.port, before, drive, failed, progress)
    return port, deploy(replace(options, port=port, drive=None), progress)


# ---- the board


def _drive(options: Options) -> Bootloader | None:
    """The drive of the board in its boot loader that is meant; None: a board at a port is. Raises MountError."""
    if options.drive is not None:
        if drive := read_bootloader(options.drive):
            return _checked(drive)
        raise WrongDrive(f"{options.drive} is no boot loader's drive: there is no INFO_UF2.TXT on it")
    if options.port and _is_there(options.port):
        return None
    drives = find_bootloaders()
    if len(drives) > 1:
        names = ", ".join(f"--drive {drive}" for drive in drives)
        raise SeveralBoardsFound(f"several boards are in their boot loader, name one: {names}")
    return _checked(drives[0]) if drives else None


def _checked(drive: Bootloader) -> Bootloader:
    if not drive.chip:
        who = drive.board_id or "without a Board-ID"
        raise WrongDrive(f"{drive} is the boot loader of another chip ({who}), not of an RP2040 or RP2350")
    return drive


def _is_there(port: str) -> bool:
    return os.path.exists(port) or port in [found.device for found in serial_ports()]


def _port(named: str | None) -> str:
    """The port of the board that runs something. Raises NoBoardFound, SeveralBoardsFound."""
    if named is not None and _is_there(named):
        return named
    if named is not None:
        raise NoBoardFound(f"there is no port {named}, and no drive of a board in its boot loader")
    ports = [device for device, _ in find_micropython()]
    if len(ports) > 1:
        raise SeveralBoardsFound(f"several boards found, name one: {', '.join(ports)}")
    if not ports:
        waiting = "".join(f"; {path} is one, and has to be mounted" for path in unmounted_bootloaders())
        raise NoBoardFound(f"no board found: hold BOOTSEL while plugging in, so that its drive comes{waiting}")
    return ports[0]


def _sent(port: str, stop: bool, ask: Callable[[str], bool], progress: Progress) -> Bootloader:
    """Send the board at a port to its boot loader, at rest and if that is allowed. Returns its drive.

    Raises NoBootloader, DeployError if a motor moves, CannotOpen.
    """
    if not ask(f"Replace what runs on the board at {port} by MicroPython and the firmware?"):
        raise NoBootloader(f"nobody said yes (--yes), so the board at {port} goes on as it was")
    before = {drive.path for drive in find_bootloaders()}
    progress.phase("sending the board to its boot loader")
    with stop_answered(port) as stop_answer:
        link = Link(open_port(port))
        try:
            stop_answer.asking(link)
            link.drain(0.1)
            answer = quiet(link, stop)
            stop_answer.found(at_rest=bool(STATUS.search(answer)))
            with restarted_on_interruption(link):
                has_python, _ = takes_programs(link)
        finally:
            link.close()
        if has_python:
            with contextlib.suppress(MpremoteError):  # the port often goes before mpremote has ended
                Mpremote(port).start_bootloader()
        else:
            _touch(port)
    end = time.monotonic() + _DRIVE_S
    while time.monotonic() < end:
        if new := [drive for drive in find_bootloaders() if drive.path not in before]:
            return _checked(new[0])
        time.sleep(_AGAIN_S)
    if has_python:
        with contextlib.suppress(MountError):  # where it did not go, what was interrupted starts again
            Mpremote(port).reset()
    waiting = "".join(f"; {path} has to be mounted" for path in unmounted_bootloaders())
    raise NoBootloader(f"the board at {port} shows no drive: hold BOOTSEL while plugging in, then again{waiting}")


def _touch(port: str) -> None:
    """Open and close a port at 1200 baud: Arduino's programs, and those with the SDK's stdio, go to BOOTSEL then."""
    import serial

    with contextlib.suppress(OSError, ValueError), serial.Serial(port, 1200) as opened:
        opened.dtr = False


# ---- the image


def fetch(chip: str, offline: bool, progress: Progress) -> Path:
    """The image that is known for a chip, fetched unless it is there. Raises ImageMissing."""
    if chip not in DOWNLOADS:
        raise ImageMissing(f"for an {chip} no image is known here: name one of micropython.org/download with --image")
    download, folder = DOWNLOADS[chip], cache() / "uf2"
    path = folder / download.name
    if _is_it(path, download):
        return path
    by_hand = f"put it there as {path} (SHA-256 {download.sha256}), or name it with --image"
    if offline:
        raise ImageMissing(f"--offline, and there is no {path}: fetch {download.url}, {by_hand}")
    import pooch

    progress.phase(f"fetching {download.url}")
    pooch.get_logger().setLevel(logging.ERROR)
    try:
        pooch.retrieve(download.url, f"sha256:{download.sha256}", download.name, folder)
    except OSError as e:  # all of requests' errors are
        raise ImageMissing(f"{download.url} cannot be fetched here ({type(e).__name__}): {by_hand}") from e
    except ValueError as e:
        raise ImageMissing(f"what came from {download.url} is not that image, and was not used: {by_hand}") from e
    return path


def _is_it(path: Path, download: Download) -> bool:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest() == download.sha256
    except OSError:
        return False


def check_chip(image: uf2.Image, drive: Bootloader) -> None:
    """Raise WrongImage unless the image is for the chip whose drive that is."""
    if image.chip != drive.chip:
        which = f"{image.name} is for an {image.chip} ({image.family:#010x}), and {drive} is an {drive.chip}"
        raise WrongImage(f"{which}: nothing was written; plugged in again, the board runs what it had")


# ---- the copy


def copy(data: bytes, drive: Bootloader, progress: Progress) -> OSError | None:
    """Write the image to the drive. Returns an error with which it ended: the drive may go before the system is done.

    Raises DriveReadOnly, DriveFull, DriveFailed: then the board is in its boot loader.
    """
    try:
        there = room(drive.path)
    except OSError as e:
        raise DriveFailed(f"{drive}: {e.strerror}; nothing was written") from e
    if there.read_only:
        raise DriveReadOnly(f"{drive} cannot be written to; nothing was written")
    need = f"{len(data) >> 10} KB are needed, {there.free * there.cluster_bytes >> 10} KB are free"
    if there.clusters(len(data)) > there.free:
        raise DriveFull(f"{drive} is full: {need}; nothing was written")
    progress.phase(f"copying {len(data) >> 10} KB to {drive}")
    try:
        with (drive.path / _NAME).open("wb") as file:
            for at in range(0, len(data), _PIECE):
                progress.bar(at, len(data), "")
                file.write(data[at : at + _PIECE])
            file.flush()
            os.fsync(file.fileno())
    except OSError as e:
        if e.errno in _READ_ONLY:
            raise DriveReadOnly(f"{drive} cannot be written to ({e.strerror})") from e
        if e.errno == errno.ENOSPC:
            raise DriveFull(f"{drive} is full: the image was cut, and the board is still in its boot loader") from e
        return e
    finally:
        progress.end()
    return None


def _back(named: str | None, before: set[str], drive: Bootloader, failed: OSError | None, progress: Progress) -> str:
    """The port at which MicroPython has come. before: the ports while the board was in its boot loader.

    failed: how the copy ended. Raises NotSeenAgain, DriveFailed, CannotOpen.
    """
    progress.phase("waiting for its port")
    end = time.monotonic() + _PORT_S
    refused: CannotOpen | None = None
    while time.monotonic() < end:
        new = [device for device, _ in find_micropython() if device not in before]
        if named is not None and named not in before and _is_there(named):
            new = [named]
        if len(new) > 1:
            raise NotSeenAgain(f"several new ports: {', '.join(new)}; go on with mirrormount deploy PORT")
        if new:
            try:
                open_port(new[0]).close()
                return new[0]
            except CannotOpen as e:  # the system may still be at work on it
                refused = e
        time.sleep(_AGAIN_S)
    if refused:
        raise refused
    if read_bootloader(drive.path):
        why = (
            f"gives an error ({failed.strerror})" if failed else "has all of the image, and the board does not take it"
        )
        raise DriveFailed(f"{drive} {why}; the board is still in its boot loader")
    if failed:
        raise DriveFailed(
            f"the drive went while the image was copied ({failed.strerror}): unplugged, or without power. Hold BOOTSEL"
            " while plugging in, then again: the boot loader is in ROM"
        )
    raise NotSeenAgain(
        "the image was copied, and no port of MicroPython came: plug the board in again, then mirrormount deploy PORT"
    )
