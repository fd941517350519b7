"""The board as it comes and goes, and its last known state.

Connection opens the port at one address, loses the board and opens it again; only the worker's thread uses it. State is
for display: the worker's thread writes it, any thread reads it. It has the scale of each axis, too, so that angles and
lengths can be shown beside steps.
"""

import contextlib
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from mirrormount import values
from mirrormount.device import calibration
from mirrormount.device.mount import Mount
from mirrormount.device.status import Status, check_same_board
from mirrormount.device.table_file import MountPort, find_port, x_axis_of
from mirrormount.errors import BadFile, BadValue, ConnectionLost, MountError, NotCalibrated
from mirrormount.supervise.log import WireLog
from mirrormount.transport.discovery import find_one
from mirrormount.transport.link import Link
from mirrormount.transport.ports import Port, TappedPort, open_port
from mountfw import codes as wire

# ---- scales


@dataclass(frozen=True, slots=True)
class AxisScale:
    """One step in mrad of the mirror, of the beam, mm on the screen: the means of both directions. None: not known.

    beam_mrad and screen_mm need the angle of incidence and the distance of the screen beside the mirror's scale.
    """

    mirror_mrad: float
    beam_mrad: float | None = None
    screen_mm: float | None = None

    def per_step(self, unit: str) -> float | None:
        """One step in a unit of values.UNITS other than steps; None: not known."""
        thousand = {"urad": "mrad", "beam-urad": "beam-mrad", "um": "mm"}
        known = {"mrad": self.mirror_mrad, "beam-mrad": self.beam_mrad, "mm": self.screen_mm}
        amount = known[thousand.get(unit, unit)]
        return amount * 1e3 if amount is not None and unit in thousand else amount


Scales = dict[str, AxisScale | None]


def read_scales(mount: Mount) -> Scales:
    """The scale of each axis; None if not measured for the present step. Raises MountError."""
    return {name: _of_axis(mount, name) for name in mount.by_name}


def _of_axis(mount: Mount, name: str) -> AxisScale | None:
    axis = mount.axis(name)
    step = calibration.Step(*axis.ask_whole("XP?", "XD?", "XI?"))
    try:
        (scale, positive), (_, negative) = (
            calibration.scale_of(mount.board_id, axis.number, name, way, step) for way in (1, -1)
        )
    except (NotCalibrated, BadFile):
        return None
    mirror_mrad = (positive + negative) / 2
    beam_mrad, screen_mm = (_converted(scale, mirror_mrad, unit, name) for unit in ("beam-mrad", "mm"))
    return AxisScale(mirror_mrad, beam_mrad, screen_mm)


def _converted(scale: calibration.Scale, mirror_mrad: float, unit: str, name: str) -> float | None:
    try:
        return values.per_step(scale, mirror_mrad, unit, name)
    except NotCalibrated:
        return None


# ---- the last known state

POLL_S = 0.05  # period of the status polls, and of the positions that are kept
MOVING_POLL_S = 0.02  # the same while something moves: its end is told so much later at most
_KNOWN_S = 0.6  # An older status is not shown as the present one.
_KEPT_S = 120.0  # positions of so long are kept for the plot

Point = tuple[float, tuple[float, ...] | None]  # when; the position of each axis, None where not known


class State:
    """status: None while it is not known; last: the last that was known; seen_s: when that came, monotonic.

    board_id: "" before the first board. axes: the names of the mount's axes. positions: of the last two minutes.
    targets: of moves under way. scales: of each axis, None if not measured. stopped_by: of each axis whose last motion
    was aborted, why.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.board_id = ""
        self.axes: tuple[str, ...] = ("x", "y")
        self.status: Status | None = None
        self.last: Status | None = None
        self.seen_s = 0.0
        self.positions: deque[Point] = deque(maxlen=round(_KEPT_S / POLL_S))
        self.targets: dict[str, float | None] = {}
        self.scales: Scales = {}
        self.stopped_by: dict[str, str] = {}

    def connect(self, mount: Mount) -> None:
        """A board has come. Raises MountError."""
        self.read_scales(mount)
        self.board_id = mount.board_id
        self.axes = tuple(mount.by_name)
        self.targets = {}
        self.stopped_by = {}

    def read_scales(self, mount: Mount) -> None:
        """Look the scales up for the board's present settings. Raises MountError."""
        self.scales = read_scales(mount)

    def began(self, axis: str | None) -> None:
        """A motion of this axis has begun; None: of all."""
        for name in [name for name in self.stopped_by if axis in (None, name)]:
            del self.stopped_by[name]

    def update(self, status: Status, stop_cause: str = "") -> None:
        """A status has come. stop_cause: of the last stop; a later one says nothing of an axis that is at rest."""
        for name, axis in status.by_name.items():
            if axis.moving or axis.reason != wire.ABORTED:
                self.began(name)
            else:
                self.stopped_by.setdefault(name, stop_cause)
        self.seen_s = self._clock()
        kept_s = self.positions[-1][0] if self.positions else float("-inf")
        if self.seen_s - kept_s >= POLL_S:
            self.positions.append((self.seen_s, tuple(axis.position for axis in status.by_name.values())))
        self.status = self.last = status

    def lose(self) -> None:
        """The board has gone."""
        self.status = None
        self.positions.append((self._clock(), None))

    @property
    def is_known(self) -> bool:
        """True while the status is recent."""
        return self.status is not None and self._clock() - self.seen_s < _KNOWN_S

    @property
    def seen_at(self) -> str:
        """When the last status came, in wall-clock time."""
        return time.strftime("%H:%M:%S", time.localtime(time.time() - (self._clock() - self.seen_s)))

    def angle_text(self, name: str, steps: float) -> str:
        """A position in mrad of the mirror, and in mm on the screen if that is known; "" where no scale is known."""
        scale = self.scales.get(name)
        if scale is None:
            return ""
        screen = "" if scale.screen_mm is None else f", {steps * scale.screen_mm:+.2f} mm"
        return f"≈ {steps * scale.mirror_mrad:+.2f} mrad{screen}".replace("-", "−")

    def step_text(self) -> str:
        """What a step of each axis is, in units of mirror, beam and screen; in steps where no scale is known."""
        of_axes = " ".join(_step_text(name, self.scales.get(name)) for name in self.axes)
        lacking = any(self.scales.get(name) is None for name in self.axes)
        return of_axes + " mirrormount setup measures a scale." * lacking


def _step_text(name: str, scale: AxisScale | None) -> str:
    if scale is None:
        return f"{name}: no scale, so steps only."
    parts = [f"{scale.mirror_mrad * 1e3:.3g} µrad of the mirror"]
    if scale.beam_mrad is not None:
        parts.append(f"{scale.beam_mrad * 1e3:.3g} µrad of the beam")
    if scale.screen_mm is not None:
        parts.append(f"{scale.screen_mm:.3g} mm on the screen")
    return f"{name}: a step is about {', '.join(parts)}."


# ---- the board as it comes and goes

Address = str | Callable[[], Port] | None
_OF_TABLE = "virtual-table://"  # the name under which `mirrormount stop` finds the boards of a virtual table


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
        self._identity = ""  # of the board that was opened first: no other one is driven after a loss
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
            check_same_board(self._identity or mount.identity, mount.identity)
        except BaseException:
            port.close()
            raise
        mount.accept_stops(place.address, also=self._on_stop)
        self.port, self.mount, self.trouble = port, mount, ""
        self._identity = mount.identity
        if self._closed:  # close() was called meanwhile, and nobody else closes what was opened since
            self.close()
            raise ConnectionLost("the port was closed again: it opened only after close()")
        return mount

    def _open_port(self) -> tuple[MountPort, Port]:
        if callable(self._address):
            return MountPort(_OF_TABLE), self._address()
        place = MountPort(find_one()) if self._address is None else find_port(self._address)
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
