"""Stops a board whose port another program has open.

A program that opens a port holds a Stoppable (stoppable.py) as long as it is open: a socket in a folder of this user
only, on which any program of this user may request a stop. `mirrormount stop` does:

    ask_all(owners(address))

Unix sockets are needed: without them (Windows; see supported()) only the program that has a port open can stop it.
"""

import contextlib
import hashlib
import os
import socket
import stat
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from mirrormount.common.errors import MountError, NoAnswer
from mirrormount.common.keep_alive import KEEP_ALIVE_MS
from mirrormount.common.printable import printable
from mirrormount.transport.processes import Owner, command_of

ANSWER_S = 2.0  # longest time in which an owner confirms

STOPPED = "stopped"  # the board has confirmed that all motors are off
SENT = "sent"  # the stop was written to the port, without a confirmation
FAILED = "failed: "
_AGAIN_S = 0.02  # between two attempts while the queue is full
_ENDING = ".stop"
_FOLDER_MOST = 68  # bytes: with its name a socket's path may have 103 on macOS, 107 on Linux


def supported() -> bool:
    """True if this system has Unix sockets."""
    return hasattr(socket, "AF_UNIX")


def real_name(address: str) -> str:
    """The one name of a port: a device's path without symlinks, else the address, with a number for this computer."""
    if "://" in address:
        return address.rstrip("/").replace("://localhost:", "://127.0.0.1:")
    return os.path.realpath(address)


def owners(address: str | None = None) -> list[Owner]:
    """The programs of this user that accept stops, for one port or for any. Removes the sockets of ended ones."""
    if not supported():
        return []
    try:
        folder = make_folder()
    except (OSError, MountError):
        return []
    found: dict[int, Owner] = {}
    pattern = f"{_key(real_name(address)) if address else '*'}.*{_ENDING}"
    for path in sorted(folder.glob(pattern)):
        with contextlib.suppress(OSError, ValueError):  # removed meanwhile, or no stop socket
            pid = int(path.name.split(".")[1])
            if _is_left(path):
                path.unlink(missing_ok=True)
            else:
                found.setdefault(path.stat().st_ino, Owner(pid, command_of(pid), path))
    return list(found.values())


def why_none() -> str | None:
    """The reason why no program of this user can be asked for a stop; None if they can."""
    try:
        if supported():
            make_folder()
    except (OSError, MountError) as e:
        return str(e)
    return None


def ask_all(asked: Sequence[Owner], timeout_s: float = ANSWER_S) -> list[str | NoAnswer]:
    """Ask all at the same time: one without an answer delays no other's stop. Returns the answers in their order."""
    answers: list[str | NoAnswer] = [NoAnswer(f"{owner} was not asked") for owner in asked]

    def ask_one(i: int) -> None:
        try:
            answers[i] = ask(asked[i], timeout_s)
        except NoAnswer as e:
            answers[i] = e

    threads = [threading.Thread(target=ask_one, args=(i,), daemon=True) for i in range(len(asked))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return answers


def ask(owner: Owner, timeout_s: float = ANSWER_S) -> str:
    """Ask an owner for a stop. Returns STOPPED or SENT. Raises NoAnswer, naming the process."""
    assert owner.path
    try:
        with _connect(owner.path, timeout_s) as connection:
            connection.settimeout(timeout_s)
            connection.sendall(b"stop\n")
            with connection.makefile("rb") as answers:
                answer = printable(answers.readline(1000).decode("utf-8", "replace").strip())
    except OSError as e:
        raise NoAnswer(
            f"{owner} has the port and does not answer: the board's keep-alive ends what moves within"
            f" {KEEP_ALIVE_MS / 1000:g} s if that program hangs; to be sure, end it or cut the motors' supply"
        ) from e
    if answer not in (STOPPED, SENT):
        raise NoAnswer(f"{owner} has the port and could not stop: {answer.removeprefix(FAILED) or 'no reason given'}")
    return answer


def make_folder() -> Path:
    """The folder of the sockets, this user's alone. Raises MountError if it is not, OSError if it cannot be made."""
    runtime = os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{os.getuid()}"
    if os.access(runtime, os.W_OK):
        folder = Path(runtime, "mirrormount")
    else:
        folder = Path(tempfile.gettempdir(), f"mirrormount-{os.getuid()}")
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        raise MountError(f"{folder} belongs to somebody else")
    if found.st_mode & 0o077:
        folder.chmod(0o700)
    if len(os.fsencode(folder)) > _FOLDER_MOST:
        raise MountError(f"{folder}: too long a name for a socket")
    return folder


def path_of(folder: Path, name: str, number: int) -> Path:
    """The path of the socket of this process for a port. number: of the Stoppable."""
    return folder / f"{_key(name)}.{os.getpid()}.{number}{_ENDING}"


def _key(name: str) -> str:
    return hashlib.sha256(name.encode("utf-8", "surrogateescape")).hexdigest()[:16]


def _connect(path: Path, patience_s: float = 0.0) -> socket.socket:
    """Raises BlockingIOError if the owner's queue stays full for patience_s."""
    end = time.monotonic() + patience_s
    while True:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.settimeout(ANSWER_S)
        try:
            connection.connect(str(path))
            return connection
        except BlockingIOError:
            connection.close()
            if time.monotonic() > end:
                raise
            time.sleep(_AGAIN_S)
        except BaseException:
            connection.close()
            raise


def clear(path: Path) -> None:
    """Remove the socket of an ended program whose process number this one has now (common in a container)."""
    with contextlib.suppress(OSError):
        if _is_left(path):
            path.unlink(missing_ok=True)


def _is_left(path: Path) -> bool:
    """True for the socket of an ended program. Raises OSError if it is no socket."""
    if not stat.S_ISSOCK(path.lstat().st_mode):
        raise FileNotFoundError(f"{path}: no socket")
    try:
        with _connect(path):  # a frozen program's socket still accepts,
            return False
    except BlockingIOError:  # until its queue is full
        return False
    except ConnectionRefusedError:
        return True
