"""The board at one address as it comes and goes: opened, lost, opened again. For the worker's thread."""

import contextlib
from collections.abc import Callable

from mirrormount.common.errors import BadValue, ConnectionLost, MountError
from mirrormount.device.mount import Mount
from mirrormount.device.named import Place, place_of, x_axis_of
from mirrormount.supervise.wire_log import WireLog
from mirrormount.transport.find import find_one
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_port
from mirrormount.transport.port import Port
from mirrormount.transport.tap import TappedPort

Address = str | Callable[[], Port] | None
_OF_TABLE = "virtual-table://"  # for `mirrormount stop`


class Connection:
    """mount: None while there is no board. trouble: why there is none, "" if there is one.

    address: a port, a mount's name, None for the only board, or what opens the port (of a virtual table). log: takes
    in the traffic. on_stop(): called behind each stop that another program of this user asks for (`mirrormount stop`),
    in a thread of its own.
    """

    def __init__(self, address: Address, log: WireLog, on_stop: Callable[[], None]) -> None:
        self._address = address
        self._log = log
        self._on_stop = on_stop
        self.port: Port | None = None
        self.mount: Mount | None = None
        self.trouble = "not connected yet"
        self._closed = False

    def open(self) -> Mount:
        """Connect; motors that moved are stopped. Raises MountError, and notes why."""
        try:
            return self._open()
        except MountError as e:
            self.trouble = str(e)
            raise

    def _open(self) -> Mount:
        place, port = self._open_port()
        try:
            if port.lockstep:
                raise BadValue("the panel needs a board at its own pace: speed=max is for use in one process")
            mount = Mount(Link(TappedPort(port, self._log)), x_axis=x_axis_of(place, None))
        except BaseException:
            port.close()
            raise
        mount.accept_stops(place.address, also=self._on_stop)
        self.port, self.mount, self.trouble = port, mount, ""
        if self._closed:  # meanwhile: nobody else closes what was opened since
            self.close()
            raise ConnectionLost("the port was closed again: it opened only after close()")
        return mount

    def _open_port(self) -> tuple[Place, Port]:
        if callable(self._address):
            return Place(_OF_TABLE), self._address()
        place = Place(find_one()) if self._address is None else place_of(self._address)
        return place, open_port(place.address)

    def lose(self, why: MountError) -> None:
        """The board has gone, or does not answer: motors off if it still can be reached, port closed."""
        mount, self.mount = self.mount, None
        self.trouble = str(why)
        if mount:
            for last in (mount.halt, mount.close):
                with contextlib.suppress(MountError, OSError):  # OSError: the driver of a port that has gone
                    last()

    def close(self) -> None:
        """Motors off, port closed, also if another thread is in open(). Raises MountError if they did not stop."""
        self._closed = True  # first: what open() opens is closed by open() from here on
        mount, self.mount = self.mount, None
        self.trouble = "closed"
        if mount:
            try:
                mount.stop()
            finally:
                mount.close()

    def spot_mm(self) -> tuple[float, float] | None:
        """The spot on a virtual board's screen: (right, up) in mm. None with a real board."""
        simulation = getattr(self.port, "simulation", None)
        return simulation.bench.spot_mm() if simulation and self.mount else None
