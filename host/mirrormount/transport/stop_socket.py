"""Stops a board whose port another program has open.

A program that opens a port holds a Stoppable as long as it is open: a socket in a folder of this user only, on which
any program of this user may request a stop. `mirrormount stop` does.

    owner = Stoppable([address], write_stop)   # Mount.open and `serve` do this
    owner.close()

    ask_all(owners(address))                  # `mirrormount stop` does this
    held_here(address)                         # True if this process has the port open (Mount.open)

A Stoppable calls write_stop() in its own thread: it must write the stop without waiting for a lock that a hanging
thread may hold. Unix sockets are needed: without them (Windows; see supported()) only the program that has a port
open can stop it.
"""

import contextlib
import errno
import hashlib
import os
import socket
import stat
import struct
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from mirrormount.common.errors import MountError, NoAnswer
from mirrormount.common.keep_alive import KEEP_ALIVE_MS
from mirrormount.common.printable import printable
from mirrormount.transport.processes import Owner, command_of

ANSWER_S = 2.0  # longest time in which an owner confirms

STOPPED = "stopped"  # the board has confirmed that all motors are off
SENT = "sent"  # the stop was written to the port, without a confirmation
_FAILED = "failed: "
_REQUEST_S = 0.2  # longest time from a connection to its request: the next one waits meanwhile
_AGAIN_S = 0.02  # between two attempts while the queue is full
_PASSING = (
    errno.EMFILE,
    errno.ENFILE,
    errno.ENOMEM,
    errno.ECONNABORTED,
)  # too many files, or the client has gone
_ENDING = ".stop"
_FOLDER_MOST = 68  # bytes: with its name a socket's path may have 103 on macOS, 107 on Linux

_held: dict[str, int] = {}  # ports that this process has open, with their counts
_held_lock = threading.Lock()
_count = 0  # Stoppables that this process has made


def supported() -> bool:
    """True if this system has Unix sockets."""
    return hasattr(socket, "AF_UNIX")


def real_name(address: str) -> str:
    """The one name of a port: a device's path without symlinks, else the address, with a number for this computer."""
    if "://" in address:
        return address.rstrip("/").replace("://localhost:", "://127.0.0.1:")
    return os.path.realpath(address)


def held_here(address: str) -> bool:
    """True if this process has the port open. Each virtual:// board is a new one: False."""
    return not address.startswith("virtual://") and real_name(address) in _held


class Stoppable:
    """The owner's side: accepts stops for a port that is open in this process, until close().

    names: the addresses of the port. stop: writes the stop, and returns STOPPED or SENT; it may raise
    MountError. Without a socket the port works all the same, and `why_not` has the reason.
    """

    def __init__(self, names: Sequence[str], stop: Callable[[], str]) -> None:
        global _count
        self._names = [real_name(name) for name in names]
        self._stop = stop
        self.why_not: str | None = None
        self._server: socket.socket | None = None
        self._paths: list[Path] = []
        with _held_lock:
            _count += 1
            number = _count
            for name in self._names:
                _held[name] = _held.get(name, 0) + 1
        if supported():
            try:
                self._listen(number)
            except (OSError, MountError) as e:  # a full disk, a home without a runtime folder: the port works
                self.why_not = str(e)
                self._remove()
        else:
            self.why_not = "this system has no Unix sockets"

    def close(self) -> None:
        """Accept no more stops."""
        with _held_lock:
            for name in self._names:
                _held[name] = _held.get(name, 1) - 1
                if _held[name] <= 0:
                    del _held[name]
            self._names = []
        if self._server:
            self._remove()
            with contextlib.suppress(OSError):
                self._server.shutdown(socket.SHUT_RDWR)  # ends accept() on Linux; the thread is a daemon elsewhere
            self._server.close()

    def _remove(self) -> None:
        for path in self._paths:
            path.unlink(missing_ok=True)

    def _listen(self, number: int) -> None:
        folder = make_folder()
        first = folder / f"{_key(self._names[0])}.{os.getpid()}.{number}{_ENDING}"
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._paths = [first]
        _clear(first)
        self._server.bind(str(first))
        first.chmod(0o600)
        self._server.listen(8)
        for name in self._names[1:]:
            other = folder / f"{_key(name)}.{os.getpid()}.{number}{_ENDING}"
            self._paths.append(other)
            _clear(other)
            os.link(first, other)
        threading.Thread(target=self._serve, args=(self._server,), name="stop socket", daemon=True).start()

    def _serve(self, server: socket.socket) -> None:
        while True:
            try:
                asker, _ = server.accept()
            except OSError as e:
                if e.errno not in _PASSING:
                    return  # closed
                time.sleep(_REQUEST_S)  # no event shows that there is room again
                continue
            with asker, contextlib.suppress(OSError):  # it has disconnected
                asker.settimeout(_REQUEST_S)
                if _user(asker) in (None, os.getuid(), 0) and asker.recv(16).startswith(b"stop"):
                    asker.sendall(self._answer().encode() + b"\n")

    def _answer(self) -> str:
        try:
            return self._stop()
        except Exception as e:  # of any kind: it is sent to the program that requested the stop
            return _FAILED + (str(e) or type(e).__name__)


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
        raise NoAnswer(f"{owner} has the port and could not stop: {answer.removeprefix(_FAILED) or 'no reason given'}")
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


def _clear(path: Path) -> None:
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


def _user(connection: socket.socket) -> int | None:
    """The peer's user id; None if the system does not show it (the folder's mode protects the socket there)."""
    if not hasattr(socket, "SO_PEERCRED"):
        return None
    return struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))[1]
