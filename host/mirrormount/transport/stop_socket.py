"""Stops a board whose port another program has open: both sides.

A program that opens a port holds a StopListener as long as it is open: a socket in a folder of this user only, on
which any program of this user may request a stop. `mirrormount stop` does:

    for owner in owners(address):
        ask_for(owner, board)

The question is "stop" and the id of the board that is meant, "?" if only its port is known. The owner stops the board
that it has, whichever was meant, for a stop is never refused; its answer names that board, if it knows its id.

Unix sockets are needed: without them (Windows; see supported()) only the program that has a port open can stop it.
`mirrormount stop` imports this before anything is stopped, so it imports little.
"""

import contextlib
import errno
import itertools
import os
import socket
import stat
import struct
import threading
import time
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from mirrormount.errors import MountError, NoAnswer
from mirrormount.terminal import printable
from mirrormount.values import KEEP_ALIVE_MS

ANSWER_S = 2.0  # longest time in which an owner confirms

STOPPED = "stopped"  # the board has confirmed that all motors are off
SENT = "sent"  # the stop was written to the port, without a confirmation
FAILED = "failed: "
_AGAIN_S = 0.02  # between two attempts while the queue is full
_ENDING = ".stop"
_FOLDER_MOST = 68  # bytes: with its name a socket's path may have 103 on macOS, 107 on Linux

_PRESENT_S = 2.0  # between two checks whether the socket still has its name
_REQUEST_S = 0.2  # longest time from a connection to its request: the next one waits meanwhile
_PASSING = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ECONNABORTED)  # too many files, or the client has gone

_held: dict[int, list[str]] = {}  # the open StopListeners of this process: their numbers, with the names of their ports
_numbers = itertools.count(1)


# ---- programs that have a port open


class Owner(NamedTuple):
    """A program that has a port open. pid is 0 if the system does not show it. path: its stop socket."""

    pid: int
    command: str
    path: Path | None = None

    def __str__(self) -> str:
        return f"process {self.pid} ({self.command})" if self.pid else "another program"


def who_has(port: str) -> Owner | None:
    """The other process that has a device open, if this system shows it (Linux, and a process of this user)."""
    target = os.path.realpath(port)
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            for fd in (folder / "fd").iterdir():
                if int(folder.name) != os.getpid() and os.readlink(fd) == target:
                    return Owner(int(folder.name), _command_of(int(folder.name)))
    return None


def _command_of(pid: int) -> str:
    """The beginning of a process's command line; safe to print."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return "command not known"
    names = [os.path.basename(w.decode("utf-8", "replace")) for w in words[:1]]
    names += [w.decode("utf-8", "replace") for w in words[1:4] if w]
    return printable(" ".join(names).strip(), 60) or "command not known"


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
        folder = _make_folder()
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
                found.setdefault(path.stat().st_ino, Owner(pid, _command_of(pid), path))
    return list(found.values())


def why_none() -> str | None:
    """The reason why no program of this user can be asked for a stop; None if they can."""
    try:
        if supported():
            _make_folder()
    except (OSError, MountError) as e:
        return str(e)
    return None


# ---- asking for a stop


def ask(owner: Owner, timeout_s: float = ANSWER_S) -> str:
    """Ask an owner for a stop. Returns STOPPED or SENT. Raises NoAnswer, naming the process."""
    return ask_for(owner, "", timeout_s)[0]


def ask_for(owner: Owner, board: str, timeout_s: float = ANSWER_S) -> tuple[str, str]:
    """As ask(), and which board has stopped: its id, "" if the owner does not say it. board: the one that is meant.

    Raises NoAnswer if another one has stopped, too.
    """
    assert owner.path
    try:
        with _connect(owner.path, timeout_s) as connection:
            connection.settimeout(timeout_s)
            connection.sendall(f"stop {board or '?'}\n".encode())
            with connection.makefile("rb") as answers:
                answer = printable(answers.readline(1000).decode("utf-8", "replace").strip())
    except OSError as e:
        raise NoAnswer(
            f"{owner} has the port and does not answer: the board's keep-alive ends what moves within"
            f" {KEEP_ALIVE_MS / 1000:g} s if that program hangs; to be sure, end it or cut the motors' supply"
        ) from e
    done, _, stopped = answer.partition(" ")
    if done not in (STOPPED, SENT):
        raise NoAnswer(f"{owner} has the port and could not stop: {answer.removeprefix(FAILED) or 'no reason given'}")
    if board and stopped and board.upper() != stopped.upper():
        raise NoAnswer(f"{owner} has the port, and has stopped the board {stopped}, not {board}: that may still move")
    return done, stopped


def _make_folder() -> Path:
    """The folder of the sockets, this user's alone. Raises MountError if it is not, OSError if it cannot be made."""
    runtime = os.environ.get("XDG_RUNTIME_DIR") or f"/run/user/{os.getuid()}"
    if os.access(runtime, os.W_OK):
        folder = Path(runtime, "mirrormount")
    else:
        import tempfile

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
    return f"{zlib.crc32(name.encode('utf-8', 'surrogateescape')):08x}"


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


# ---- accepting stops


def held_here(address: str) -> bool:
    """True if this process has the port open. Each virtual:// board is a new one: False."""
    if address.startswith("virtual://"):
        return False
    name = real_name(address)
    return any(name in names for names in list(_held.values()))


class StopListener:
    """The owner's side: accepts stops for a port that is open in this process, until close().

    names: the addresses of the port. stop: called in a thread of its own; it writes the stop without waiting for a
    lock that a hanging thread may hold, and returns STOPPED or SENT; it may raise MountError. board: the id of the
    board at the port, "" if it is not known. Without a socket the port works all the same, and `why_not` has the
    reason.
    """

    def __init__(self, names: Sequence[str], stop: Callable[[], str], board: str = "") -> None:
        self._board = board
        self._names = [real_name(name) for name in names]
        self._stop = stop
        self.why_not: str | None = None
        self._server: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._paths: list[Path] = []
        self._number = next(_numbers)
        _held[self._number] = self._names
        if supported():
            try:
                self._server = self._bound()
                self._thread = threading.Thread(
                    target=self._serve, args=(self._server,), name="stop socket", daemon=True
                )
                self._thread.start()
            except (OSError, MountError) as e:  # a full disk, a home without a runtime folder: the port works
                self.why_not = str(e)
                self._remove()
        else:
            self.why_not = "this system has no Unix sockets"

    def why_deaf(self) -> str:
        """Why no stop gets in any more; "" if one does, or never did (why_not). Whoever drives must not go on then."""
        if self._thread is None:
            return ""
        if not self._thread.is_alive():
            return "the thread that takes the stops of other programs has ended"
        try:
            os.close(os.open(os.devnull, os.O_RDONLY))  # a connection takes a file, too
        except OSError as e:
            return f"no file is left for the stop of another program ({os.strerror(e.errno or 0).lower()})"
        return ""

    def close(self) -> None:
        """Accept no more stops."""
        _held.pop(self._number, None)  # first: a socket that is made anew is closed again by its thread from here on
        self._remove()
        if server := self._server:
            with contextlib.suppress(OSError):
                server.shutdown(socket.SHUT_RDWR)  # ends accept() on Linux; the thread is a daemon elsewhere
            server.close()

    def _remove(self) -> None:
        for path in self._paths:
            path.unlink(missing_ok=True)

    def _bound(self) -> socket.socket:
        """A socket that listens under all names."""
        folder = _make_folder()
        own = f"{os.getpid()}.{self._number}{_ENDING}"
        self._paths = [folder / f"{_key(name)}.{own}" for name in self._names]
        for path in self._paths:  # of an ended program whose process number this one has now (common in a container)
            with contextlib.suppress(OSError):
                if _is_left(path):
                    path.unlink(missing_ok=True)
        server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            server.settimeout(_PRESENT_S)
            server.bind(str(self._paths[0]))
            self._paths[0].chmod(0o600)
            server.listen(8)
            for other in self._paths[1:]:
                os.link(self._paths[0], other)
        except BaseException:
            server.close()
            raise
        return server

    def _present(self, server: socket.socket) -> socket.socket:
        """The socket; a new one if a name of it is gone, as with its folder when the user has logged out."""
        if self._number not in _held or all(path.exists() for path in self._paths):
            return server
        with contextlib.suppress(OSError, MountError):  # no folder yet: the next look tries again
            self._remove()
            self._server = anew = self._bound()
            server.close()
            if self._number not in _held:  # closed meanwhile
                self.close()
            return anew
        return server

    def _serve(self, server: socket.socket) -> None:
        while True:
            try:
                asker, _ = server.accept()
            except TimeoutError:
                server = self._present(server)
                continue
            except OSError as e:
                if e.errno not in _PASSING:
                    return  # closed
                time.sleep(_REQUEST_S)  # no event shows that there is room again
                continue
            with asker, contextlib.suppress(OSError):  # it has disconnected
                asker.settimeout(_REQUEST_S)
                if _user(asker) in (None, os.getuid(), 0) and (asked := asker.recv(100)).startswith(b"stop"):
                    asker.sendall(self._answer(tell_board=b" " in asked).encode() + b"\n")

    def _answer(self, *, tell_board: bool) -> str:
        """tell_board: False for an asker of version 0.2, which would take the id for a failure."""
        try:
            return f"{self._stop()} {self._board if tell_board else ''}".strip()
        except Exception as e:  # of any kind: it is sent to the program that requested the stop
            return FAILED + (str(e) or type(e).__name__)


def _user(connection: socket.socket) -> int | None:
    """The peer's user id; None if the system does not show it (the folder's mode protects the socket there)."""
    if not hasattr(socket, "SO_PEERCRED"):
        return None
    return struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))[1]
