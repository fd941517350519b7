"""One open board: handshake, exchanges, stop, keep-alive.

A Mount, the worker of a panel, a loop with a camera and a server on the network all use a Session. Any thread may call
any method of it. Three rules hold:

- A stop waits for no other thread's exchange.
- No motion starts after a stop that came later than the motion's request (StopCounter).
- Every line that starts a motion sets the board's keep-alive, and a thread feeds it with status queries (KeepAlive). A
  program that dies feeds it no more, so the board stops by itself.

docs/protocol.md has the grammar of the lines.
"""

import contextlib
import itertools
import re
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Self

from mirrormount.device.motion_log import MotionLog
from mirrormount.device.status import RESET_CAUSES, Board, QueuedError, Status, check_x_axis
from mirrormount.errors import (
    AllowNeeded,
    AtPrompt,
    BadValue,
    BoardError,
    ConnectionLost,
    FirmwareMissing,
    MountError,
    MoveEnded,
    NoAnswer,
    NotAMount,
    PortAbsent,
    PortBusy,
)
from mirrormount.terminal import printable
from mirrormount.transport.link import AT_PROMPT, GREETING, NO_BOARD, NOT_ALLOWED, TAKEN, Link
from mirrormount.transport.ports import open_port
from mirrormount.transport.stop_socket import SENT, STOPPED, StopListener
from mirrormount.values import KEEP_ALIVE_MS
from mountfw import codes as wire

# ---- command lines

LONGEST = 128 - len(f"XK{KEEP_ALIVE_MS};;TB?")  # a line of the board has 128 characters

_COMMAND_LINE = re.compile(r" *([A-Za-z*1-9]|0[0-9]*>)")  # by the table of first bytes in docs/protocol.md
_ADDRESS = re.compile(r" *[0-9]+ *>")
_STARTS_MOTION = re.compile(r"[ 0-9]*(PR|PA|XU|MV|MT|OR)(?!.*\?)", re.IGNORECASE)
_KEEP_ALIVE = re.compile(r"XK *([0-9]+)", re.IGNORECASE)


def check_line(line: str) -> None:
    """Raises BadValue for a text that is no command line, one with nothing behind a ; included."""
    if not isinstance(line, str):
        raise BadValue(f"a command line is text, not {line!r}")
    if not line.strip(" "):
        raise BadValue("the command line is empty")
    if not (line.isascii() and line.isprintable()):
        raise BadValue(f"a command line is printable ASCII, not {line!r}")
    if not _COMMAND_LINE.match(line):
        raise BadValue(f"{line!r} is no command line: a frame is sent by drive, a stop by stop")
    if not all(command.strip(" ") for command in line.split(";")):
        raise BadValue("a ; stands between two commands: leave out the one that has nothing behind it")


def check_query(query: str) -> None:
    """Raises BadValue for a text that is no query, or starts a motion."""
    if not (isinstance(query, str) and query.isascii() and query.isprintable()):
        raise BadValue(f"a query is printable ASCII, not {query!r}")
    if starts_motion(query):
        raise BadValue(f"{query!r} starts a motion: send() does that, and keeps it alive")


def starts_motion(line: str) -> bool:
    """True if a command of the line may start a motion."""
    return any(map(_STARTS_MOTION.match, line[_begin(line) :].split(";")))


def keep_alives_ms(line: str) -> list[int]:
    """The keep-alives that the line sets itself."""
    return [int(ms) for ms in _KEEP_ALIVE.findall(line)]


def with_keep_alive(line: str) -> str:
    """The line, with the host's keep-alive before its first command. Raises BadValue if it is too long for that."""
    if len(line) > LONGEST:
        raise BadValue(f"a command line that starts a motion has at most {LONGEST} characters, not {len(line)}")
    at = _begin(line)
    return f"{line[:at]}XK{KEEP_ALIVE_MS};{line[at:]}"


def _begin(line: str) -> int:
    """Where the first command begins: behind the address, if there is one."""
    address = _ADDRESS.match(line)
    return address.end() if address else 0


# ---- the order of stops and starts


def not_begun() -> MoveEnded:
    """The error for a motion that a stop has kept from starting."""
    return MoveEnded("mount", wire.ABORTED, 0, None, ["stopped before it began"])


class StopCounter:
    """Held while a stop is written, and while a line that starts a motion is written.

    stops = gate.last_stop()           # when the motion is requested
    with gate.starting(stops): ...     # MoveEnded if there was a stop since
    with gate.stopping(): ...          # around the writing of a stop
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._numbers = itertools.count(1)
        self._last = 0  # each stop has its own number, so that none is lost between two threads
        self._blocks = threading.local()  # since: the last stop before this thread's outermost unless_stopped() began

    def last_stop(self) -> int:
        """The number of the last stop: in a block of unless_stopped() the last one before the block."""
        since: int | None = getattr(self._blocks, "since", None)
        return self._last if since is None else since

    @contextlib.contextmanager
    def starting(self, last_stop: int) -> Iterator[None]:
        """Inside, no other thread writes a stop. Raises MoveEnded if there was one after last_stop."""
        with self._lock:
            if last_stop != self._last:
                raise not_begun()
            yield

    @contextlib.contextmanager
    def stopping(self, longest_s: float | None = None) -> Iterator[None]:
        """Register a stop; inside, it is written. Waits longest_s at most for another thread's line, then goes on."""
        self._last = next(self._numbers)
        is_alone = self._lock.acquire(timeout=-1 if longest_s is None else longest_s)
        try:
            yield
        finally:
            if is_alone:
                self._lock.release()

    @contextlib.contextmanager
    def unless_stopped(self) -> Iterator[None]:
        """A motion of this thread inside starts only if no thread has stopped since the outermost such block began."""
        before: int | None = getattr(self._blocks, "since", None)
        self._blocks.since = self._last if before is None else before
        try:
            yield
        finally:
            self._blocks.since = before


# ---- keep-alive

FEED_S = 0.1  # between two status queries that feed the keep-alive


class KeepAlive:
    """Feeds the board's keep-alive while something moves.

    is_moving: asks the board whether anything moves; called in the thread. threaded: False in lockstep.

    Without a thread only `active` is kept, and the caller queries the board while it is set.
    """

    def __init__(self, is_moving: Callable[[], bool], threaded: bool) -> None:
        self._is_moving = is_moving
        self._threaded = threaded
        self._active = False
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._starts = 0  # a thread that ends checks whether a motion was started meanwhile
        self._failure: MountError | None = None

    @property
    def active(self) -> bool:
        """True while a motion is kept alive."""
        return self._active

    def start(self) -> None:
        """Keep the motion that was just started alive until it ends."""
        with self._lock:
            self._starts += 1
            self._active = True
            if not self._threaded or self._thread:
                return
            self._thread = threading.Thread(target=self._feed, name="keep-alive", daemon=True)
            self._thread.start()

    def end(self) -> None:
        """Stop feeding. Does not wait for the thread."""
        self._active = False

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for the end of the thread: at the end of the motion, or of end()."""
        thread = self._thread
        if thread:
            thread.join(timeout_s)

    def check(self) -> None:
        """Raise the error that ended the thread, once."""
        failure, self._failure = self._failure, None
        if failure:
            raise failure

    def _feed(self) -> None:
        while True:
            starts, moving = self._starts, False
            try:
                moving = self._active and self._is_moving()
            except MountError as e:
                self._failure = e
            with self._lock:
                if not moving and starts == self._starts:
                    self._active = False
                    self._thread = None
                    return
            time.sleep(FEED_S)


# ---- handshake

ANSWER_S = 2.0  # A board answers in milliseconds, but takes longer while it starts, as a virtual one does.
_SERVED_ANSWER_S = 5.0  # `serve` stops the board before it passes anything on, which may take long on a busy computer.

_STATUS_END = re.compile(r"[0-9,|-]+")  # the rest of an answer to another client's poll, which arrives late


def identify(link: Link) -> str:
    """Stop all motion, drop old answers, and query the identity. Returns the answer to *IDN?.

    Raises NotAMount, AtPrompt, FirmwareMissing, PortBusy, PortAbsent, AllowNeeded.
    """
    try:
        link.write(b"!\n")
        before = link.drain(0.1)
        _check_served(before.decode("ascii", "replace"))
        link.write(b"*IDN?\n")
        answer = link.read_line(_SERVED_ANSWER_S if GREETING in before else ANSWER_S)
        # the board is just starting; or that is the rest of an answer to a client that was killed
        if answer.endswith("soft reboot") or _STATUS_END.fullmatch(answer):
            answer = link.read_line(ANSWER_S)
    except ConnectionLost as e:
        raise NotAMount("it hung up when asked who it is: not a mount") from e
    except NoAnswer as e:
        answer = link.drain(0.05).decode("ascii", "replace")
        if not answer:
            raise NotAMount("nothing answers: not a mount, or its firmware hangs") from e
    _check_served(answer)
    answer = answer.lstrip("\ufffd\x01\x03")  # a greeting that came late
    if not answer.startswith("mirrormount,"):
        link.write(b"\r")  # a prompt in the middle of a line shows only after its end
        answer += link.drain(0.3).decode("ascii", "replace")
    rest = link.drain(0.05).decode("ascii", "replace")
    if answer.startswith("mirrormount,") and not rest:
        answer = printable(answer)
        if answer.count(",") < 3:
            raise NotAMount(f"not the four parts of a mount's identity: {answer[:80]!r}")
        return answer
    if ">>>" in answer + rest:
        link.write(b"\r\x03\r")
        link.drain(0.1)
        if _fails_to_import(link, b"mountfw"):
            raise FirmwareMissing("Python answers, but mountfw is not on this board: deploy it first")
        raise AtPrompt("the board is at its Python prompt: press Ctrl-D there, or reset it, to start mountfw")
    raise NotAMount(f"this is not a mount; it answered {(answer + rest)[:60]!r}")


def _fails_to_import(link: Link, module: bytes) -> bool:
    """Whether a prompt cannot import it. No answer within ANSWER_S: False. Raises ConnectionLost."""
    link.write(b"import " + module + b"\r")
    said, end = b"", link.monotonic() + ANSWER_S
    while b">>> " not in said.partition(module)[2] and link.monotonic() < end:  # after the echo
        said += link.drain(0.05)
    return b"ImportError" in said


def _check_served(received: str) -> None:
    """Raise the error that stands for a refusal of a program that serves the board."""
    if TAKEN in received:
        raise PortBusy("another program drives this board")
    if NO_BOARD in received:
        raise PortAbsent("the program that serves this board has lost it: plug the board in")
    if AT_PROMPT in received:
        raise AtPrompt("the board is at its Python prompt: press Ctrl-D there (on its pty) to start mountfw")
    if NOT_ALLOWED in received:
        raise AllowNeeded("this computer may not drive that board: serve it with --allow, or go through ssh -L")


# ---- session

_LOCK_S = 1.0  # longest wait of another program's stop for the answers of this one
_OWN_STOP, _STOP_BY_OTHERS = "its program asked for it", "mirrormount stop"  # for the log of motions
_GATE_S = 0.05  # longest wait of another program's stop for a thread that writes a line
_ECHO_LINES = 5  # lines that a board sends back for a frame
_LONGEST_ANSWER = 4096  # characters
_PROBE = "#"  # a line before an echo, by which a board learns whether a port returns what it sends
_ERRORS_MOST = 20  # A board's queue of errors is shorter than this.


class Session:
    """An open session. Identifying the board stops it. x_axis: the board's number of the axis called x.

    Attributes: link; board (identity, axes, last status); gate (stops before starts); keep_alive; motion_log (not for a
    board in lockstep).
    A session that nobody refers to any more feeds no keep-alive: its motion ends. Raises what identify() raises.
    """

    def __init__(self, link: Link, *, x_axis: int = 2) -> None:
        check_x_axis(x_axis)
        self.link = link
        self.board = Board(identify(link), x_axis)
        self.gate = StopCounter()
        self.motion_log = None if link.lockstep else MotionLog(self.board.id)
        self._closed = False
        this = weakref.ref(self)  # A thread that held the session would keep its motion alive.
        self.keep_alive = KeepAlive(lambda: (own := this()) is not None and own.status().moving, not link.lockstep)
        self.stop_listener: StopListener | None = None  # takes other programs' stops
        self.stops_by_others = 0  # how many stops other programs have asked for
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
        try:
            # a stop that fails must not hide the exception that is on its way; the keep-alive stands behind it
            hidden = kind is not None and kind is not KeyboardInterrupt
            with contextlib.suppress(MountError) if hidden else contextlib.nullcontext():
                self.stop()
        finally:
            self.close()

    def close(self) -> None:
        """Close the port. Does not stop: the board's keep-alive will."""
        self._closed = True
        self.keep_alive.end()
        self.keep_alive.join()
        if self.stop_listener:
            self.stop_listener.close()
        self.link.close()
        if self.motion_log:
            self.motion_log.close()  # last, for it may wait for a disk

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
            self.link.write(b"!\n")  # again, for another thread may have been starting a motion
            self.link.drain(0.02)
            if self.status().moving:
                raise NoAnswer("the board still moves after a stop: cut the motors' supply")

    def halt(self) -> None:
        """Send the stop and return at once, whatever other threads do; stop() also confirms it.

        A motion that another thread is about to start does not start after it. Raises ConnectionLost.
        """
        self._check_open()
        if self.motion_log:
            self.motion_log.stopping(_OWN_STOP)
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

        if not self.link.lockstep and not self.stop_listener:
            self.stop_listener = StopListener([address], stop, self.board.id)
            weakref.finalize(self, self.stop_listener.close)

    def stop_for_another_program(self, also: Callable[[], None] | None = None) -> str:
        """Write the stop without waiting for a thread that hangs, then confirm it if the link is free.

        Returns STOPPED or SENT. Raises ConnectionLost, NoAnswer.
        """
        self.stops_by_others += 1
        if self.motion_log:
            self.motion_log.stopping(_STOP_BY_OTHERS)
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
        no command line (check_line()); MoveEnded as start(); NoAnswer.
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
            if self.motion_log:
                self.motion_log.started()
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
            if gate and self.motion_log:
                self.motion_log.started()
            return "; ".join(answers)

    def _check_open(self) -> None:
        if self._closed:
            raise ConnectionLost("this Mount was closed: open it again")

    def _log_old_errors(self) -> None:
        """Empty the error queue, so that an old error is not taken for a refusal of the next line."""
        if self.status().errors_waiting:
            import logging  # imported here, because the import takes 5 ms, for which `mirrormount stop` would wait

            for error in self.errors():
                logging.getLogger("mirrormount").warning("the board reports %s", error)

    def _receive_status(self, line: str) -> Status:
        status = self.board.receive_status(line, self.link.monotonic())
        if self.board.has_restarted(status):
            if self.motion_log:
                self.motion_log.lose()
            cause = RESET_CAUSES.get(self.ask("XH?").split(",")[3], "it does not say why")
            raise ConnectionLost(
                f"the board has restarted ({cause}): what was moving has stopped, positions start anew"
            )
        if self.motion_log:
            self.motion_log.see(status)
        return status
