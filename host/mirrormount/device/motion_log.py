"""The log of motions: what moved on which board, by whom, from where to where, and how it ended.

A session shows each status that it reads to its MotionLog, which finds there the motions of an axis from one rest to
the next. A thread of its own writes them, so that no motion and no stop waits for a disk; what cannot be written is
told once. A virtual board in lockstep has no time of its own, and is not logged.
"""

import contextlib
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mirrormount.device import records
from mirrormount.device.status import AxisStatus, Status
from mirrormount.errors import REASONS, MountError
from mirrormount.terminal import printable
from mountfw import codes as wire

FILE = "motions.sqlite"
MOST = 200_000  # motions that are kept, about 30 MB
_SCHEMA = """create table if not exists motions (
    id integer primary key, begun real, ended real, board text, axis integer, name text,
    "from" real, "to" real, how text, certainty text, who text)"""
JITTER = 0.5  # steps: an encoder's position changes by less at rest, too
_CLOSE_S = 2.0  # longest wait for the disk when a session is closed


class LoggedMotion(NamedTuple):
    """A motion of an axis, from one rest to the next. Times in seconds since 1970 (UTC), positions in steps.

    axis: the board's number; name: what it was called. how: why it ended.
    """

    begun: float
    ended: float
    board: str
    axis: int
    name: str
    from_steps: float
    to_steps: float
    how: str
    certainty: str
    who: str


COLUMNS = LoggedMotion._fields


class MotionLog:
    """The motions of one session. client: for whom the program moves, if for somebody else."""

    def __init__(self, board: str) -> None:
        self.client = ""
        self._board = board
        self._rest: dict[int, float] = {}  # the position at which each axis was seen at rest last
        self._begun: dict[int, tuple[float, str]] = {}  # of the axes that move: when, and for whom
        self._last: Status | None = None
        self._started = False
        self._set: set[int] = set()  # the axes whose position is being defined
        self._homing: set[int] = set()  # the axes that search their home
        self._beginning: set[int] = set()  # those of them whose search is not begun yet
        self._stopped = ""  # why this program has stopped what moves, "" if it has not
        self._lock = threading.Lock()  # never held while a disk is waited for
        self._rows: list[LoggedMotion] = []
        self._writer: threading.Thread | None = None
        self._has_warned = False

    def started(self) -> None:
        """A motion was started: it may be over before the next status."""
        self._started = True
        self._stopped = ""

    def stopping(self, cause: str) -> None:
        """All motion is stopped now; the first cause counts. No lock: a signal handler may call it."""
        self._stopped = self._stopped or cause

    def see(self, status: Status) -> None:
        """Find what has ended since the status before."""
        now = time.time()
        with self._lock:
            self._last = status
            for number, axis in enumerate(status.axes, 1):
                if axis.moving:
                    self._begun.setdefault(number, (now, self.client))
                    continue
                before, begun = self._rest.get(number), self._begun.pop(number, None)
                jitters = axis.certainty == "measured" and not begun and number not in self._set
                if before is not None and (begun or abs(axis.position - before) >= (JITTER if jitters else 0.001)):
                    if number in self._set:
                        how = "set, not moved"
                    elif begun or self._started:
                        how = self._end_of(number, axis)
                    else:
                        how = "changed at rest: set, or turned by hand"
                    ours = begun or self._started or number in self._set
                    self._add(number, begun or (now, self.client if ours else ""), before, axis.position, how)
                if number not in self._beginning:
                    self._homing.discard(number)  # a search at rest is over, also one that was stopped at once
                if before is None or not jitters or abs(axis.position - before) >= JITTER:
                    self._rest[number] = axis.position
            self._started = self._started and status.moving

    def _end_of(self, number: int, axis: AxisStatus) -> str:
        """How a motion ended, in words."""
        how = REASONS.get(axis.reason, str(axis.reason))
        if axis.reason == wire.ABORTED and self._stopped:
            how = f"stopped: {self._stopped}"
        if number in self._homing:  # a search that is over has another 0 than it began with
            return "homed: 0 is there since" if axis.reason == wire.DONE else f"search for home: {how}"
        return how

    @contextlib.contextmanager
    def setting(self, number: int) -> Iterator[None]:
        """Inside, the position of that axis is defined anew: nothing moves."""
        self._set.add(number)
        try:
            yield
        finally:
            self._set.discard(number)

    @contextlib.contextmanager
    def homing(self, number: int) -> Iterator[None]:
        """Inside, that axis begins to search its home."""
        self._homing.add(number)
        self._beginning.add(number)
        try:
            yield
        except BaseException:
            self._homing.discard(number)
            raise
        finally:
            self._beginning.discard(number)

    def lose(self) -> None:
        """The board has restarted: the end of what moved was not seen, and the positions from before count no more."""
        with self._lock:
            for number, begun in self._begun.items():
                if self._last and number in self._rest:
                    at = self._last.axes[number - 1].position
                    self._add(number, begun, self._rest[number], at, "its end was not seen")
            self._begun.clear()
            self._homing.clear()
            self._rest.clear()
            self._started = False

    def close(self) -> None:
        """Write what is left, with what nobody has seen the end of."""
        self.lose()
        with self._lock:
            writer = self._writer
        if writer:
            writer.join(_CLOSE_S)

    def _add(self, number: int, begun: tuple[float, str], before: float, after: float, how: str) -> None:
        if self._last is None:
            return
        name = next(name for name, axis in self._last.by_name.items() if axis is self._last.axes[number - 1])
        certainty = self._last.axes[number - 1].certainty
        now, who = time.time(), f"{begun[1]}, " if begun[1] else ""
        who = printable(f"{who}{_program()}", 200)
        self._rows.append(LoggedMotion(begun[0], now, self._board, number, name, before, after, how, certainty, who))
        if not self._writer:
            self._writer = threading.Thread(target=self._write, name="motion log", daemon=True)
            self._writer.start()

    def _write(self) -> None:
        while True:
            with self._lock:
                rows, self._rows = self._rows, []
                if not rows:
                    self._writer = None
                    return
            try:
                with records.opened(FILE, _SCHEMA, write=True) as file:
                    file.executemany(f"insert into motions values (null{', ?' * len(COLUMNS)})", rows)
                    file.execute("delete from motions where id <= (select max(id) from motions) - ?", (MOST,))
            except MountError as e:
                if not self._has_warned:
                    self._has_warned = True
                    import logging

                    logging.getLogger("mirrormount").warning("what moves is not being logged: %s", e)


def _program() -> str:
    """This program, with the command of `mirrormount`, and its user."""
    import getpass

    name = Path(sys.argv[0]).name if sys.argv else ""
    if name in ("__main__.py", "mirrormount", "mirrormount.exe"):
        name = " ".join(["mirrormount", *[word for word in sys.argv[1:] if not word.startswith("-")][:1]])
    try:
        user = getpass.getuser()
    except (OSError, KeyError, ImportError):  # ImportError: Windows without USERNAME, up to Python 3.12
        user = f"user {os.getuid()}" if hasattr(os, "getuid") else "somebody"
    return f"{'Python' if name in ('', '-c') else name} of {user}"


def read(since: float = 0.0, board: str = "", most: int = -1) -> Iterator[LoggedMotion]:
    """The motions that ended since then, oldest first; board: how its id begins. most: only so many, the latest.

    Raises BadFile, CannotWrite.
    """
    with records.opened(FILE, _SCHEMA) as file:
        rows = file.execute(
            "select * from motions where ended >= ? and substr(board, 1, ?) = ? order by id desc limit ?",
            (since, len(board), board, most),
        ).fetchall()
    yield from (LoggedMotion(*row[1:]) for row in reversed(rows))
