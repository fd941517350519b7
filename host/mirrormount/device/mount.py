"""Mount and its two axes: what a program says to a mirror mount.

    with Mount.open() as mount:      # stops on the way out, whatever happens
        mount.x.step(5)              # five steps to the right; returns when they are done
        mount.y.jog(-0.3)            # downwards at 30 %, until told otherwise
        mount.stop()

Every line that starts a motion sets the board's keep-alive, and the client feeds it while the
motion lasts: a client that dies stops the mount. Positions are in steps of the axis.
"""

import contextlib
import logging
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Self

from mirrormount.common.errors import (
    BadValue,
    BoardError,
    ConnectionLost,
    MountError,
    MoveEnded,
    NoAnswer,
    NotAMount,
    PortBusy,
)
from mirrormount.common.keep_alive import KEEP_ALIVE_MS
from mirrormount.common.printable import printable
from mirrormount.common.validation import whole_number
from mirrormount.device import settings
from mirrormount.device.axis import Axis
from mirrormount.device.handshake import identify
from mirrormount.device.status import (
    AxisStatus,
    Ended,
    Homed,
    Limits,
    QueuedError,
    Status,
    parse_error,
    parse_status,
    table,
)
from mirrormount.transport.find import find_one
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_port
from mirrormount.transport.refusals import TAKEN
from mirrormount.transport.stop_socket import SENT, STOPPED, Stoppable, held_here
from mountfw import codes as wire
from mountfw.wire.frame import encode

__all__ = ["TAKEN", "Axis", "AxisStatus", "Ended", "Homed", "Limits", "Mount", "QueuedError", "Status"]

_FEED_S = 0.1
_ANSWER_S = 1.0
_GATE_S = 0.05  # how long a stop waits for another thread to write its line
_SLACK_S = 2.0  # on top of what a move must take, before it is called stuck
_LONGEST_ANSWER = 4096
_COMMAND_LINE = re.compile(r" *([A-Za-z*1-9]|0[0-9]*>)")  # the table of first bytes in docs/protocol.md

_log = logging.getLogger("mirrormount")

RESET_CAUSES = {
    str(wire.POWER): "power, or its reset pin",
    str(wire.ASKED): "it was told to",
    str(wire.WATCHDOG): "its watchdog: the firmware had hung",
}


class Mount:
    """An open mount. Use open(); close() it, or let `with` do so.

    x is the horizontal axis and y the vertical one; x_axis tells which the board calls 1 and 2.
    """

    def __init__(self, link: Link, *, x_axis: int = 2) -> None:
        if x_axis not in (1, 2):
            raise BadValue(f"x_axis is 1 or 2, not {x_axis!r}")
        self.link = link
        self.identity = identify(link)
        self.x = Axis(self, "x", x_axis)
        self.y = Axis(self, "y", 3 - x_axis)
        self._feeder: threading.Thread | None = None
        self._feeding = threading.Event()
        self._feed_lock = threading.Lock()
        self._feeds = 0  # motions started: a feeder that ends looks whether one came meanwhile
        self._stops = 0  # stops asked for: a motion that began before one must not start after it
        self._since: int | None = None  # what they were when unless_stopped() began
        self._gate = threading.Lock()  # held for the writing of a stop, and of what starts a motion
        self._lost: MountError | None = None
        self._seen: tuple[float, Status] | None = None  # when the last status came, and what it was
        self._closed = False
        self._boot_id: int | None = None
        self._stoppable: Stoppable | None = None
        self.status()

    @classmethod
    def open(cls, address: str | None = None, *, x_axis: int = 2) -> Self:
        """Open a mount: the one that is plugged in, or a port, socket://HOST:PORT or virtual://.

        Without an address only boards with a known USB id are considered, so that nothing is
        ever written to another instrument. What may be moving on the board is stopped.

        Raises CannotOpen, BadAddress, or NotAMount if something else answers.
        """
        if not isinstance(address, str | None):
            raise BadValue(f"a port's address is text, not {address!r}")
        address = find_one() if address is None else address
        try:
            link = Link(open_port(address))
            try:
                mount = cls(link, x_axis=x_axis)
                mount.accept_stops(address)
                return mount
            except BaseException:
                link.close()
                raise
        except PortBusy as e:
            if held_here(address):
                raise PortBusy(
                    f"{printable(address)}: this program has this port open already: go on with that Mount, or"
                    " close() it first"
                ) from e
            raise

    def close(self) -> None:
        """Close the port. Does not stop: the board's keep-alive will."""
        self._closed = True
        self._feeding.clear()
        feeder = self._feeder
        if feeder:
            feeder.join()
        if self._stoppable:
            self._stoppable.close()
        self.link.close()

    def __repr__(self) -> str:
        """What the board last said; the board is not asked."""
        axes = self._seen[1] if self._seen else "not seen yet"
        return f"<Mount {self.identity}: {axes}; {self._age()}>"

    def _repr_html_(self) -> str:
        axes = [("x", self._seen[1].x), ("y", self._seen[1].y)] if self._seen else []
        return table(axes, f"{self.identity}: {self._age()}")

    def _age(self) -> str:
        """How old the last status is, for a text."""
        if self._closed:
            return "closed"
        return f"as it was {self.link.monotonic() - self._seen[0]:.1f} s ago" if self._seen else "not seen yet"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            # a stop that fails must not hide what brought us here; the keep-alive stands behind it
            hidden = kind is not None and kind is not KeyboardInterrupt
            with contextlib.suppress(MountError) if hidden else contextlib.nullcontext():
                self.stop()
        finally:
            self.close()

    def stop(self) -> None:
        """Both motors off, at once; returns when the board has said so.

        Sent without waiting for any other thread's exchange. Raises ConnectionLost, NoAnswer.
        """
        self.halt()
        with self.link.lock:
            self.link.write(b"!\n")  # again: another thread may have been in the middle of starting
            self.link.drain(0.02)
            if self.status().moving:
                raise NoAnswer("the board still moves after a stop: cut the motors' supply")

    def halt(self) -> None:
        """Send the stop and return at once, whatever another thread is doing; stop() also makes sure of it.

        A motion that another thread is about to start does not start after it. Raises ConnectionLost.
        """
        self._check_open()
        with self._gate:
            self._stops += 1
            self._feeding.clear()
            self.link.port.write(b"!\n")

    @contextlib.contextmanager
    def unless_stopped(self) -> Iterator[None]:
        """What is started inside starts only if there was no stop since this block began, by any thread."""
        self._since = self._stops
        try:
            yield
        finally:
            self._since = None

    def accept_stops(self, address: str, also: Callable[[], None] | None = None) -> None:
        """Let `mirrormount stop` of this user stop this mount until it is closed; open() does this.

        also is called behind each such stop, in a thread of its own: for a program that has motions in a queue.
        """
        if not self.link.lockstep and self._stoppable is None:
            self._stoppable = Stoppable([address], lambda: self._stop_for_another_program(also))

    def _stop_for_another_program(self, also: Callable[[], None] | None = None) -> str:
        """Write the stop without waiting for what a hanging thread may hold, then look whether it was obeyed."""
        self._stops += 1
        self._feeding.clear()
        alone = self._gate.acquire(timeout=_GATE_S)
        try:
            self.link.port.write(b"!\n")
        finally:
            if alone:
                self._gate.release()
        if also:
            also()
        if not self.link.lock.acquire(timeout=_ANSWER_S):
            return SENT
        try:
            if self.status().moving:
                raise NoAnswer("the board moves again: end that program")
            return STOPPED
        finally:
            self.link.lock.release()

    def drive(self, m1: int, m2: int, *, feed: bool = True) -> None:
        """Drive motor 1 (vertical) and motor 2 (horizontal) at -255 ... 255, 0 is off.

        Both change together; what moved before is superseded. The board's run limit (10 s unless
        set otherwise) ends it, and so does the death of this program. Without feed the caller keeps
        it alive: by asking for status(), say, every KEEP_ALIVE_MS at least. Raises BadValue.
        """
        frame = encode(whole_number(m1, 255, "m1"), whole_number(m2, 255, "m2"))
        stops = self._count_stops()
        self._check_lost()
        limit_s = max(self.x.run_limit_s, self.y.run_limit_s)
        with self._stopped_by_interrupt(), self.link.lock:
            self._take_old_errors()
            line = self._exchange(b"XK%d\n%s\nXS?\n" % (KEEP_ALIVE_MS, frame), self._open_gate(stops))
            if line == frame.decode():
                for _ in range(4):
                    self.link.read_line(_ANSWER_S)
                line = self.link.read_line(_ANSWER_S)
            status = self._parse_status(line)
        if status.moving:
            for axis in (self.x, self.y):
                axis._deadline = self.link.monotonic() + limit_s + _SLACK_S
            if feed:
                self._feed()
        if status.errors_waiting:
            self.stop()
            raise self._board_error(self.take_errors()[0])

    def status(self) -> Status:
        """Ask the board. Raises NoAnswer, ConnectionLost (also if the board has restarted since)."""
        return self._parse_status(self.ask("XS?"))

    def take_errors(self) -> list[str]:
        """The board's queued errors, oldest first, taken from its queue: "62, KEEP-ALIVE LOST" …"""
        errors = []
        while not (line := self.ask("TB?")).startswith("0,"):
            errors.append(line)
            if len(errors) > 20:
                raise NotAMount(f"the error queue does not end: {line!r}")
        return errors

    def errors(self) -> list[QueuedError]:
        """The same as take_errors(), each with its number and its text. They are taken from the board's queue."""
        return [parse_error(line, self.x.number) for line in self.take_errors()]

    @property
    def board_id(self) -> str:
        """The board's unique id: what its scales are filed under."""
        return self.identity.rsplit(",", 2)[1]

    def settings(self) -> dict[str, dict[str, int | float]]:
        """All settings that the board can save: {"x": {"pulse_us": 200000, …}, "y": {…}}; see settings.py."""
        return settings.read(self)

    def apply(self, wanted: Mapping[str, Mapping[str, int | float]]) -> None:
        """Change settings: all that are named, or none. They last until the board restarts, unless saved.

        Raises BadValue if one cannot be (nothing was sent), SettingRefused if the board takes one not.
        """
        settings.write(self, wanted)

    def save(self) -> None:
        """Keep the present settings on the board, for its next start. Raises BoardError (n14: it moves; 67)."""
        self.send("SM")

    def recall(self, *, factory: bool = False) -> None:
        """Go back to the saved settings, or to the factory's. Raises BoardError (n14: it moves; 63: damaged)."""
        self.send("*RCL0" if factory else "*RCL1")

    def reset(self) -> None:
        """Re-initialise the board in place: off, all as at power-up, an emergency stop released. Raises BoardError."""
        self.send("*RST")

    def sleep(self, seconds: float) -> None:
        """Let time pass (the board's own, on a virtual board in lockstep) with the motion kept alive.

        An interrupt (Ctrl-C) stops both motors.
        """
        if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not seconds >= 0:
            raise BadValue(f"a time to sleep is a number of seconds, not {seconds!r}")
        end = self.link.monotonic() + seconds
        with self._stopped_by_interrupt():
            while (left := end - self.link.monotonic()) > 0:
                if self.link.lockstep and self._feeding.is_set():
                    self.status()
                self._check_lost()
                self.link.sleep(min(left, _FEED_S))

    def ask(self, query: str) -> str:
        """One command line with a query to the board, its one line of answers back (docs/protocol.md)."""
        return self._exchange(query.encode("ascii") + b"\n")

    def send(self, line: str) -> str:
        """One command line of any kind to the board; returns its answers, "" if it asked nothing.

        Raises BoardError for the first of its commands that cannot be done; errors that waited from
        before are logged. A motion that it starts is not kept alive. Raises BadValue if the line is not
        printable ASCII, or a frame or a stop; NoAnswer.
        """
        if not (line.isascii() and line.isprintable() and line.strip()):
            raise BadValue(f"a command line is printable ASCII, not {line!r}")
        if not _COMMAND_LINE.match(line):
            raise BadValue(f"{line!r} is no command line: a frame is sent by drive, a stop by stop")
        return self._send(line)

    # ---- for the axes

    def _exchange(self, data: bytes, gate: contextlib.AbstractContextManager[object] | None = None) -> str:
        """Send, and return the board's next line, safe to print."""
        self._check_open()
        return printable(self.link.ask(data, _ANSWER_S, gate), _LONGEST_ANSWER)

    def _check_open(self) -> None:
        if self._closed:
            raise ConnectionLost("this Mount was closed: open it again")

    def _send(self, line: str, gate: contextlib.AbstractContextManager[object] | None = None) -> str:
        with self.link.lock:
            self._take_old_errors()
            try:
                *answers, error = self._exchange(f"{line};TB?\n".encode("ascii"), gate).split("; ")
            except NoAnswer:
                if errors := self.errors():  # a malformed line is not executed, its TB? included
                    raise BoardError(errors[0].code, errors[0].text) from None
                raise
            if "*RST" in line.upper():
                self._boot_id = None  # the next status tells the new one
            if not error.startswith("0,"):
                self.take_errors()
                raise self._board_error(error.rpartition(">")[2])
            return "; ".join(answers)

    def _start(self, command: str, stops: int) -> None:
        """Send a command that starts a motion, with its keep-alive. Raises BoardError if refused.

        stops is what _count_stops() said when the caller began: after a stop since then, it does not start.
        """
        self._check_lost()
        self._send(f"XK{KEEP_ALIVE_MS};{command}", self._open_gate(stops))

    @contextlib.contextmanager
    def _stopped_by_interrupt(self) -> Iterator[None]:
        """Inside, an interrupt (KeyboardInterrupt) stops both motors before it goes on its way."""
        try:
            yield
        except KeyboardInterrupt:
            with contextlib.suppress(MountError):  # the keep-alive stands behind it
                self.stop()
            raise

    def _count_stops(self) -> int:
        return self._stops if self._since is None else self._since

    @contextlib.contextmanager
    def _open_gate(self, stops: int) -> Iterator[None]:
        """Inside, no other thread sends a stop. Raises MoveEnded if one has since they were counted."""
        with self._gate:
            if stops != self._stops:
                raise MoveEnded("mount", wire.ABORTED, 0, None, ["stopped before it began"])
            yield

    def _take_old_errors(self) -> None:
        """Those that waited from before must not be taken for a refusal of what comes now."""
        if self.status().errors_waiting:
            for error in self.errors():
                _log.warning("the board reports %s", error)

    def _feed(self) -> None:
        """Keep the motion that was just started alive until it ends."""
        with self._feed_lock:
            self._feeds += 1
            self._feeding.set()
            if self.link.lockstep or self._feeder:
                return
            self._feeder = threading.Thread(target=self._feed_until_done, name="keep-alive", daemon=True)
            self._feeder.start()

    def _feed_until_done(self) -> None:
        while True:
            feeds, moving = self._feeds, False
            try:
                moving = self._feeding.is_set() and self.status().moving
            except MountError as e:
                self._lost = e
            with self._feed_lock:
                if not moving and feeds == self._feeds:
                    self._feeding.clear()
                    self._feeder = None
                    return
            time.sleep(_FEED_S)

    def _check_lost(self) -> None:
        lost, self._lost = self._lost, None
        if lost:
            raise lost

    def _why_restarted(self) -> str:
        health = self.ask("XH?").split(",")
        return RESET_CAUSES.get(health[-1], "it does not say why")

    def _parse_status(self, line: str) -> Status:
        status = parse_status(line, self.x.number)
        boot_id = status.boot_id
        self._seen = self.link.monotonic(), status
        if self._boot_id is None:
            self._boot_id = boot_id
        elif boot_id != self._boot_id:
            self._boot_id = boot_id
            raise ConnectionLost(
                f"the board has restarted ({self._why_restarted()}): what was moving has stopped, positions start anew"
            )
        return status

    def _board_error(self, line: str) -> BoardError:
        error = parse_error(line, self.x.number)
        return BoardError(error.code, error.text)
