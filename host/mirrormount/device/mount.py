"""`Mount`: the public face of a mirror mount, a board with its axes.

    with Mount.open() as mount:      # stops at the end of the block, whatever happens
        mount.x.step(5)              # five steps to the right; returns when they are done
        mount.y.jog(-0.3)            # downwards at 30 %, until stopped
        mount.stop()

A motion is kept alive while it lasts: a program that dies stops the mount. Positions are in steps of the axis.
"""

import contextlib
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping
from typing import Self

from mirrormount.device import settings
from mirrormount.device.axis import Axis
from mirrormount.device.presets import Presets
from mirrormount.device.session import Session, not_begun
from mirrormount.device.status import AxisStatus, Ended, Homed, Limits, QueuedError, Status, table
from mirrormount.device.table_file import MountPort, find_port, x_axis_of
from mirrormount.errors import BadValue, MountError, NotSupported, PortBusy
from mirrormount.terminal import on_interrupted_cell, printable
from mirrormount.transport.discovery import find_one
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_port
from mirrormount.transport.stop_socket import held_here
from mirrormount.values import whole_number

__all__ = ["Axis", "AxisStatus", "Ended", "Homed", "Limits", "Mount", "QueuedError", "Status"]

_OTHERS_S = 0.1  # a mount whose port hangs lets the stop of others wait for no longer, after an interrupted cell


class Mount:
    """An open mount. Use open(); close() it, or let `with` do so.

    x is the horizontal axis and y the vertical one; x_axis is the board's number of x, and the
    other axis of that pair (1 and 2, 3 and 4) is y. axes has all axes in the board's order; by_name has them as x, y,
    and the others by number: axis3 … presets has the named positions.
    """

    def __init__(self, link: Link, *, x_axis: int = 2) -> None:
        self.link = link
        self.session = Session(link, x_axis=x_axis)
        self.by_name = {name: Axis(self.session, name, number) for name, number in self.session.board.numbers.items()}
        self.axes = tuple(sorted(self.by_name.values(), key=lambda axis: axis.number))
        self.x, self.y = self.by_name["x"], self.by_name["y"]
        on_interrupted_cell(weakref.WeakMethod(self._cell_interrupted))  # a jog goes on while its cell only sleeps

    def _cell_interrupted(self) -> None:
        thread = threading.Thread(target=self._halt_if_open, daemon=True)
        thread.start()
        thread.join(_OTHERS_S)

    def _halt_if_open(self) -> None:
        with contextlib.suppress(MountError):  # it is closed, or its board has gone
            self.halt()

    @property
    def presets(self) -> Presets:
        """The named positions. Made anew each time: a mount that refers to itself outlives its owner, and drives on."""
        return Presets(self)

    @classmethod
    def open(cls, address: str | None = None, *, x_axis: int | None = None) -> Self:
        """Open a mount: the one that is plugged in, or a port, socket://HOST:PORT or virtual://, or a name.

        A name is that of a mount in table.toml (table_file.py). x_axis: unless that says otherwise, 2.

        Without an address only boards with a known USB id are considered, so that nothing is
        ever written to another instrument. All motion on the board is stopped.

        Raises CannotOpen, BadAddress, BadFile, or NotAMount if something else answers.
        """
        if not isinstance(address, str | None):
            raise BadValue(f"a port's address is text, not {address!r}")
        place = MountPort(find_one()) if address is None else find_port(address)
        address = place.address
        try:
            link = Link(open_port(address))
            try:
                mount = cls(link, x_axis=x_axis_of(place, x_axis))
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
        self.session.close()

    def __repr__(self) -> str:
        """The last status; the board is not asked."""
        last = self.session.board.last
        return f"<Mount {self.identity}: {last[1] if last else 'not seen yet'}; {self.session.age()}>"

    def _repr_html_(self) -> str:
        last = self.session.board.last
        return table(last[1].by_name if last else {}, f"{self.identity}: {self.session.age()}")

    def __enter__(self) -> Self:
        self.session.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        self.session.__exit__(kind, *rest)

    @property
    def identity(self) -> str:
        """The board's answer to *IDN?."""
        return self.session.board.identity

    @property
    def board_id(self) -> str:
        """The board's unique id, under which its scales are stored."""
        return self.session.board.id

    def axis(self, name: str) -> Axis:
        """The axis called x, y, axis3 … Raises BadValue."""
        if name not in self.by_name:
            raise BadValue(f"there is no axis {name!r}: this mount has {', '.join(self.by_name)}")
        return self.by_name[name]

    # ---- motion

    def stop(self) -> None:
        """All motors off, at once; returns when the board has confirmed it.

        Sent without waiting for any other thread's exchange. Raises ConnectionLost, NoAnswer.
        """
        self.session.stop()

    def halt(self) -> None:
        """Send the stop and return at once, whatever other threads do; stop() also confirms it.

        A motion that another thread is about to start does not start after it. Raises ConnectionLost.
        """
        self.session.halt()

    @contextlib.contextmanager
    def unless_stopped(self, *, since_open: bool = False) -> Iterator[None]:
        """A motion of this thread in the block starts only if no thread has stopped the mount since the block began.

        In a block within a block it is since the outer one began. since_open: MoveEnded at once if another program has
        stopped the mount since it was opened.
        """
        with self.session.gate.unless_stopped():
            if since_open and self.session.stops_by_others:  # asked in the block: of a later one the gate knows
                raise not_begun()
            yield

    def accept_stops(self, address: str, also: Callable[[], None] | None = None) -> None:
        """Let `mirrormount stop` of this user stop this mount until it is closed; open() does this.

        also is called after each such stop, in a thread of its own: for a program that has motions in a queue.
        """
        self.session.accept_stops(address, also)

    def drive(self, m1: int, m2: int, *, feed: bool = True) -> None:
        """Drive motor 1 (vertical) and motor 2 (horizontal) at -255 ... 255, 0 is off.

        Both change together; their earlier motion is superseded. The board's run limit (10 s unless
        set otherwise) ends it, and so does the death of this program. Without feed the caller keeps
        it alive: with a status() every KEEP_ALIVE_MS at least, for instance. Raises BadValue, NotSupported.
        """
        if self.session.board.x_axis > 2:
            raise NotSupported("a frame drives motors 1 and 2 of a board, and this mount has others: use jog()")
        frame = encode_frame(whole_number(m1, 255, "m1"), whole_number(m2, 255, "m2"))
        session = self.session
        last_stop = session.gate.last_stop()
        session.keep_alive.check()
        limit_s = max(self.x.run_limit_s, self.y.run_limit_s)
        with session.stopped_by_interrupt():
            status = session.start_frame(frame, last_stop)
        if status.moving:
            for axis in (self.x, self.y):
                axis.expect_end(limit_s)
            if feed:
                session.keep_alive.start()
        if status.errors_waiting:
            self.stop()
            raise session.board.exception(self.take_errors()[0])

    def sleep(self, seconds: float) -> None:
        """Let time pass (the board's own, on a virtual board in lockstep) with the motion kept alive.

        An interrupt (Ctrl-C) stops all motors.
        """
        self.session.sleep(seconds)

    # ---- state and commands

    def status(self) -> Status:
        """Ask the board. Raises NoAnswer, ConnectionLost (also if the board has restarted since)."""
        return self.session.status()

    def take_errors(self) -> list[str]:
        """The board's queued errors, oldest first, taken from its queue: "62, KEEP-ALIVE LOST" …"""
        return self.session.take_errors()

    def errors(self) -> list[QueuedError]:
        """The same as take_errors(), each with its number and its text. They are taken from the board's queue."""
        return self.session.errors()

    def power(self) -> int:
        """The voltage of the board's analog input, 0 … 65535. Raises BoardError (70) if its board file names none."""
        return int(self.ask("XW?"))

    def ask(self, query: str) -> str:
        """Send a command line with a query; returns the board's one line of answers (docs/protocol.md)."""
        return self.session.ask(query)

    def send(self, line: str, *, keep_alive: bool = True) -> str:
        """Send a command line of any kind; returns its answers, "" without a query.

        A motion that it starts is kept alive while this program lives, unless the line sets a keep-alive itself (`XK`),
        which you then feed, or keep_alive is False: then it outlives this program.
        Raises BoardError for the first of its commands that is refused; errors that waited from before are logged.
        Raises BadValue if the line is not printable ASCII, or a frame or a stop; MoveEnded, NoAnswer.
        """
        return self.session.send(line, keep_alive=keep_alive)

    # ---- settings

    def settings(self) -> dict[str, dict[str, int | float]]:
        """All settings that the board can save: {"x": {"pulse_us": 200000, …}, "y": {…}}; see settings.py."""
        return settings.read(self.session)

    def apply(self, wanted: Mapping[str, Mapping[str, int | float]]) -> None:
        """Change settings: all that are named, or none. They last until the board restarts, unless saved.

        Raises BadValue for an impossible one (nothing was sent), SettingRefused if the board refuses one.
        """
        settings.write(self.session, wanted)

    def save(self) -> None:
        """Save the present settings on the board, for its next start. Raises BoardError (n14: it moves; 67)."""
        self.send("SM")

    def recall(self, *, factory: bool = False) -> None:
        """Restore the saved settings, or the factory's. Raises BoardError (n14: it moves; 63: damaged)."""
        settings.recall(self.session, factory=factory)

    def undo_settings(self) -> dict[str, int | float]:
        """Put back the settings from before the last change, also by recall(): all, or none. Twice changes them again.

        Returns what was changed: {"x.pulse_us": 200000}. Raises NotKept if this computer knows of no change.
        """
        return settings.undo(self.session)

    def reset(self) -> None:
        """Re-initialise the board in place: off, all as at power-up, an emergency stop released. Raises BoardError."""
        self.send("*RST")


def encode_frame(m1: int, m2: int) -> bytes:
    """The frame that drives motor 1 at m1 and motor 2 at m2, -255 … 255. Raises ValueError outside that range."""
    for n in (m1, m2):
        if not -255 <= n <= 255:
            raise ValueError("a frame's speed must be within -255 ... 255")
    return b"".join(b"%s%03d" % (b"-" if n < 0 else b"0", abs(n)) for n in (m1, m2))
