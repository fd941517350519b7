"""A virtual board's port on a pseudo-terminal."""

import contextlib
import os
import select
from pathlib import Path

from mirrormount.transport.lines import refusal_line
from mirrormount.virtual.ports import WAITING_MOST, Waiting


class PtyPort:
    """A pseudo-terminal of this user alone, under a symlink if one is asked for. POSIX only.

    The bytes that the system would buffer (64 KB) are read at once and wait here, so that a stop overtakes them.
    """

    prompt = True

    def __init__(self, link: Path | None = None) -> None:
        import pty
        import tty

        self._openpty, self._setraw = pty.openpty, tty.setraw
        self._link = link
        self._refused = False
        self._master = -1
        self._waiting = Waiting()
        self._open()
        self.address = str(link or self._name)

    def _open(self) -> None:
        self._master, slave = self._openpty()
        self._setraw(slave)
        self._name = os.ttyname(slave)
        os.fchmod(slave, 0o600)  # the board's prompt is behind it
        os.close(slave)
        os.set_blocking(self._master, False)
        self._poll = select.poll()
        self._poll.register(self._master, select.POLLIN)
        if self._link:
            with contextlib.suppress(FileNotFoundError):
                if self._link.is_symlink():
                    self._link.unlink()
            self._link.symlink_to(self._name)

    def plug(self, there: bool) -> None:
        if there and self._master < 0:
            self._open()
        elif not there and self._link:  # without a link a new name would be unknown
            self.close()

    def watched(self) -> list[int]:
        return [self._master] if self.connected() else []

    def connected(self) -> bool:
        if self._master < 0:
            return False
        # a client that wrote and left at once counts: its bytes may be a stop
        here = all(event & select.POLLIN or not event & select.POLLHUP for _, event in self._poll.poll(0))
        self._refused = self._refused and here
        return here or self.waits

    @property
    def waits(self) -> bool:
        return bool(self._waiting.bytes)

    def take(self, most: int, *, at_prompt: bool = False) -> bytes:
        if at_prompt:
            return self._waiting.take(most) or self._read(most)
        while len(self._waiting.bytes) <= WAITING_MOST and (data := self._read(1 << 16)):
            self._waiting.add(data)
        if len(self._waiting.bytes) > WAITING_MOST:  # too much to find a stop behind it in time
            self._waiting.bytes[:] = b"!?"  # malformed: the rest of a message that is cut here is not executed
        return self._waiting.take(most)

    def _read(self, most: int) -> bytes:
        try:
            return os.read(self._master, most)
        except OSError:  # no bytes, or the client has just left
            return b""

    def give(self, data: bytes) -> int:
        try:
            return os.write(self._master, data)
        except OSError:
            return 0

    def refuse(self, text: str) -> None:
        while self._read(4096):  # or it would be executed later
            pass
        self._waiting = Waiting()
        if not self._refused and self.connected():
            self.give(refusal_line(text))
            self._refused = True

    def waits_in_vain(self) -> None:
        if any(event & select.POLLHUP for _, event in self._poll.poll(0)):
            while data := self._read(1 << 16):
                self._waiting.add(data)
            self._waiting.keep_stop()

    def close(self) -> None:
        if self._link and self._link.is_symlink() and os.readlink(self._link) == self._name:
            self._link.unlink()
        self._waiting = Waiting()
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
