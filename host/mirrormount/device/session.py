"""A session with a board: the link, the stop, the keep-alive, and one exchange at a time.

A Mount, a worker of a panel, a loop with a camera and a server on the network stand on it. Every line that starts a
motion sets the board's keep-alive, so that a program that dies stops the mount. Any thread may call any method; a
stop waits for no other thread's exchange.
"""

import contextlib
import logging
import os
import weakref
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Self

from mirrormount.common.errors import BadValue, BoardError, ConnectionLost, MountError, NoAnswer, NotAMount
from mirrormount.common.keep_alive import KEEP_ALIVE_MS
from mirrormount.common.printable import printable
from mirrormount.device.abandoned import abandon
from mirrormount.device.board import RESET_CAUSES, Board, check_x_axis
from mirrormount.device.command_lines import check_line, check_query, keep_alives_ms, starts_motion, with_keep_alive
from mirrormount.device.handshake import ANSWER_S, identify
from mirrormount.device.keep_alive import FEED_S, KeepAlive
from mirrormount.device.status import QueuedError, Status
from mirrormount.device.stop_gate import StopGate
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_port
from mirrormount.transport.stop_socket import SENT, STOPPED
from mirrormount.transport.stoppable import Stoppable

_LOCK_S = 1.0  # longest wait of another program's stop for the answers of this one
_GATE_S = 0.05  # longest wait of another program's stop for a thread that writes a line
_ECHO_LINES, _LONGEST_ANSWER = 5, 4096  # of a frame; characters
_PROBE = "#"  # a line before an echo, by which a board learns whether a port returns what it sends
_ERRORS_MOST = 20  # of a board's queue

_log = logging.getLogger("mirrormount")


class Session:
    """An open session. Identifying the board stops it. x_axis: the board's number of the axis called x.

    Attributes: link; board (identity, axes, last status); gate (stops before starts); keep_alive.
    In a forked process it only raises ConnectionLost: the port is the parent's. Raises what identify() raises.
    """

    def __init__(self, link: Link, *, x_axis: int = 2) -> None:
        check_x_axis(x_axis)
        self.link = link
        self.board = Board(identify(link), x_axis)
        self.gate = StopGate()
        self._process = os.getpid()
        self._closed = False
        this = weakref.ref(self)  # threads must not keep it
        self.keep_alive = KeepAlive(lambda: (own := this()) is not None and own.status().moving, not link.lockstep)
        self._stoppables: list[Stoppable] = []
        self.stops_by_others = 0  # how many stops other programs have asked for
        self._end: weakref.finalize | None = None
        self.status()

    @classmethod
    def open(cls, address: str) -> Self:
        """A session with the board at an address. Raises what identify() raises, CannotOpen, BadAddress."""
        link = Link(open_port(address))
        try:
            return cls(link)
        except BaseException:
            link.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._process != os.getpid():
            return
        try:
            # a stop that fails must not hide the exception that is on its way; the keep-alive stands behind it
            hidden = kind is not None and kind is not KeyboardInterrupt
            with contextlib.suppress(MountError) if hidden else contextlib.nullcontext():
                self.stop()
        finally:
            self.close()

    def end_when_forgotten(self) -> None:
        """Stop the board and close the port when nobody refers to this session any more; not at the program's end."""
        self._end = weakref.finalize(self, abandon, self._process, self.link, self.keep_alive, self._stoppables)
        self._end.atexit = False

    def close(self) -> None:
        """Close the port. Does not stop: the board's keep-alive will."""
        if self._process != os.getpid():
            return
        self._closed = True
        if self._end:
            self._end.detach()
        self.keep_alive.end()
        self.keep_alive.join()
        for stoppable in self._stoppables:
            stoppable.close()
        self.link.close()

    @property
    def stoppable(self) -> Stoppable | None:
        """What takes other programs' stops."""
        return self._stoppables[0] if self._stoppables else None

    def age(self) -> str:
        """How old the last status is, for a text. The board is not asked."""
        if self._closed or not self.board.last:
            return "closed" if self._closed else "not seen yet"
        return f"as it was {self.link.monotonic() - self.board.last[0]:.1f} s ago"

    # ---- stops

    def stop(self) -> None:
        """All motors off, at once; returns when the board has confirmed it.

        It waits for no other thread's exchange. Raises ConnectionLost, NoAnswer.
        """
        self.halt()
        with self.link.lock:
            self.link.write(b"!\n")  # again: another thread may have been in the middle of starting
            self.link.drain(0.02)
            if self.status().moving:
                raise NoAnswer("the board still moves after a stop: cut the motors' supply")

    def halt(self) -> None:
        """Send the stop and return at once, whatever other threads do; stop() also confirms it.

        A motion that another thread is about to start does not start after it. Raises ConnectionLost.
        """
        self._check_open()
        with self.gate.stopping():
            self.keep_alive.end()
            self.link.port.write(b"!\n")

    def accept_stops(self, address: str, also: Callable[[], None] | None = None) -> None:
        """Let `mirrormount stop` of this user stop the board until close(). A board in lockstep takes none.

        also is called after each such stop, in a thread of its own: for a program that has motions in a queue.
        """
        this = weakref.ref(self)

        def stop() -> str:
            own = this()
            return own.stop_for_another_program(also) if own else STOPPED

        if not self.link.lockstep and not self._stoppables:
            self._stoppables.append(Stoppable([address], stop))

    def stop_for_another_program(self, also: Callable[[], None] | None = None) -> str:
        """Write the stop without waiting for a thread that hangs, then confirm it if the link is free.

        Returns STOPPED or SENT. Raises ConnectionLost, NoAnswer.
        """
        self.stops_by_others += 1
        with self.gate.stopping(_GATE_S):
            self.keep_alive.end()
            self.link.port.write(b"!\n")
        if also:
            also()
        if not self.link.lock.acquire(timeout=_LOCK_S):
            return SENT
        try:
            if self.status().moving:
                raise NoAnswer("the board moves again: end that program")
            return STOPPED
        finally:
            self.link.lock.release()

    @contextlib.contextmanager
    def stopped_by_interrupt(self) -> Iterator[None]:
        """Inside, an interrupt (KeyboardInterrupt) stops all motors before it propagates."""
        try:
            yield
        except KeyboardInterrupt:
            with contextlib.suppress(MountError):  # the keep-alive stands behind it
                self.stop()
            raise

    # ---- exchanges

    def ask(self, query: str) -> str:
        """Send a line with a query; returns the board's one line of answers. Raises BadValue if it starts a motion."""
        check_query(query)
        return self._exchange(query.encode("ascii") + b"\n")

    def send(self, line: str, *, keep_alive: bool = True) -> str:
        """Send a command line of any kind; returns its answers, "" without a query.

        A motion that it starts is kept alive, unless the line sets a keep-alive itself (`XK`), which the caller then
        feeds, or keep_alive is False: then it outlives this program.
        Raises BoardError for the first command that is refused (errors from before are logged), BadValue if the line is
        no command line (command_lines.py:check_line); MoveEnded as start(); NoAnswer.
        """
        check_line(line)
        gate = self.gate.starting(self.gate.last_stop()) if starts_motion(line) else None
        if not (gate and keep_alive) or keep_alives_ms(line):
            return self._send(line, gate)
        self.keep_alive.check()
        with self.stopped_by_interrupt():
            answers = self._send(with_keep_alive(line), gate)
            self.keep_alive.start()
        return answers

    def start(self, command: str, last_stop: int) -> None:
        """Send a command that starts a motion, with its keep-alive. Raises BoardError if refused.

        last_stop is gate.last_stop() at the time of the request: MoveEnded if there was a stop since.
        """
        self.keep_alive.check()
        self._send(f"XK{KEEP_ALIVE_MS};{command}", self.gate.starting(last_stop))

    def start_frame(self, frame: bytes, last_stop: int) -> Status:
        """Send a frame of the paper's protocol with a keep-alive; returns the status after it. Raises as start()."""
        self._check_open()
        self.keep_alive.check()
        with self.link.lock:
            self._log_old_errors()
            line = self._exchange(b"XK%d\n%s\nXS?\n" % (KEEP_ALIVE_MS, frame), self.gate.starting(last_stop))
            if line == _PROBE:
                line = self.link.read_line(ANSWER_S)
            if line == frame.decode():
                for _ in range(_ECHO_LINES - 1):
                    self.link.read_line(ANSWER_S)
                line = self.link.read_line(ANSWER_S)
            return self._receive_status(line)

    def status(self) -> Status:
        """Ask the board. Raises NoAnswer, ConnectionLost (also if the board has restarted since)."""
        return self._receive_status(self.ask("XS?"))

    def take_errors(self) -> list[str]:
        """The board's queued errors, oldest first, taken from its queue: "62, KEEP-ALIVE LOST" …"""
        errors = []
        while not (line := self.ask("TB?")).startswith("0,"):
            errors.append(line)
            if len(errors) > _ERRORS_MOST:
                raise NotAMount(f"the error queue does not end: {line!r}")
        return errors

    def errors(self) -> list[QueuedError]:
        """The same, each with its number and its text."""
        return [self.board.parse_error(line) for line in self.take_errors()]

    def sleep(self, seconds: float) -> None:
        """Let time pass (the board's own, on a virtual board in lockstep) with the motion kept alive.

        An interrupt (Ctrl-C) stops all motors.
        """
        if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not seconds >= 0:
            raise BadValue(f"a time to sleep is a number of seconds, not {seconds!r}")
        end = self.link.monotonic() + seconds
        with self.stopped_by_interrupt():
            while (left := end - self.link.monotonic()) > 0:
                if self.link.lockstep and self.keep_alive.active:
                    self.status()
                self.keep_alive.check()
                self.link.sleep(min(left, FEED_S))

    def _exchange(self, data: bytes, gate: AbstractContextManager[object] | None = None) -> str:
        """Send, and return the board's next line, safe to print."""
        self._check_open()
        return printable(self.link.ask(data, ANSWER_S, gate), _LONGEST_ANSWER)

    def _send(self, line: str, gate: AbstractContextManager[object] | None = None) -> str:
        self._check_open()
        with self.link.lock:
            self._log_old_errors()
            try:
                *answers, error = self._exchange(f"{line};TB?\n".encode("ascii"), gate).split("; ")
            except NoAnswer:
                if errors := self.errors():  # a malformed line is not executed, its TB? included
                    raise BoardError(errors[0].code, errors[0].text) from None
                raise
            if "*RST" in line.upper():
                self.board.expect_restart()
            if not error.startswith("0,"):
                self.take_errors()
                raise self.board.exception(error.rpartition(">")[2])
            return "; ".join(answers)

    def _check_open(self) -> None:
        if self._process != os.getpid():
            raise ConnectionLost("this Mount was opened by another process: use it there")
        if self._closed:
            raise ConnectionLost("this Mount was closed: open it again")

    def _log_old_errors(self) -> None:
        """Empty the error queue, so that an old error is not taken for a refusal of the next line."""
        if self.status().errors_waiting:
            for error in self.errors():
                _log.warning("the board reports %s", error)

    def _receive_status(self, line: str) -> Status:
        status = self.board.receive_status(line, self.link.monotonic())
        if self.board.has_restarted(status):
            cause = RESET_CAUSES.get(self.ask("XH?").split(",")[3], "it does not say why")
            raise ConnectionLost(
                f"the board has restarted ({cause}): what was moving has stopped, positions start anew"
            )
        return status
