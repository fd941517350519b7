"""Opens virtual optical tables: what `virtual-table://` stands for.

virtual-table://                 two mounts, each on a board of its own, and two cameras; as fast as it goes
…?mounts=1|2  &cameras=1|2|split  &boards=1 (with two mounts: both on one board of four axes)
…&encoder=motor|shaft
…&profile=smooth|rough  &seed=N  &supply=VOLTAGE, of the nominal one  &off=MILLIMETRES, by which the laser is displaced
…&speed=max|1  (1: in real time)
"""

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from urllib.parse import parse_qsl

import numpy as np

from mirrormount.beam.scale import Scale
from mirrormount.common.errors import BadAddress
from mirrormount.common.printable import printable
from mirrormount.virtual.bench import INCIDENCE
from mirrormount.virtual.board import LockstepPort, Options, RealtimePort, make_simulation
from mirrormount.virtual.encoder import KINDS
from mirrormount.virtual.geometry import DEFAULT, Geometry
from mirrormount.virtual.profile import SMOOTH, Profile
from mirrormount.virtual.query import profile_named, seed_of
from mirrormount.virtual.simulation import Simulation
from mirrormount.virtual.table import Table
from mirrormount.virtual.table_camera import TableCamera
from mirrormount.virtual.table_clock import Clock, LockstepClock, RealtimeClock
from mirrormount.virtual.webcams import new_webcam

SPLIT_MM = 8.0  # by which a beam splitter moves the spot of each plane out of the one camera's middle; assumed
MOST_OFF_MM = 12.0  # half of the picture's height
_SCHEME = "virtual-table://"


@dataclass(frozen=True)
class Kind:
    """Which table. cameras: 1, 2, or "split" (one camera that sees both planes through a beam splitter). encoder: a
    kind of encoder.KINDS on motors 1 and 2 of each board."""

    mounts: int = 2
    boards: int = 2
    cameras: str = "2"
    profile: Profile = SMOOTH
    seed: int = 1
    off_mm: float = 0.0
    realtime: bool = False
    encoder: str | None = None
    geometry: Geometry = DEFAULT


class VirtualTable:
    """An open table: ports for `Mount(Link(port))`, cameras, a clock, and the truth.

    In lockstep time passes in a port's read() and sleep(), in a camera's frames(), and in sleep(); on all boards alike.
    """

    def __init__(self, kind: Kind) -> None:
        seeds = np.random.SeedSequence(kind.seed).generate_state(4)
        axes = 4 if kind.mounts > kind.boards else 2
        self._files = tempfile.TemporaryDirectory(prefix="mirrormount-")  # what the boards save
        kept = Path(self._files.name)
        self._boards = [
            Options(
                seed=int(seeds[unit]),
                profile=kind.profile,
                axes=axes,
                unit=unit,
                files=kept / str(unit),
                encoder=kind.encoder,
            )
            for unit in range(min(kind.boards, kind.mounts))
        ]
        self.simulations: list[Simulation] = []
        self.ports: list[LockstepPort | RealtimePort] = []
        self.clock: Clock
        try:
            for options in self._boards:
                self.simulations.append(make_simulation(options))
            self.clock = RealtimeClock() if kind.realtime else LockstepClock(self.simulations)
            self.ports += [self._port(simulation) for simulation in self.simulations]
        except BaseException:
            for simulation in self.simulations:
                simulation.close()
            self._files.cleanup()
            raise
        mounts = [partial(self._mirrors, number) for number in range(len(self._boards))]
        self.truth = Table(mounts, kind.mounts, _geometry(kind), int(seeds[2]))
        noise = np.random.default_rng(int(seeds[3]))
        if kind.off_mm:
            self.truth.misalign(kind.off_mm, noise)
        self.cameras: list[TableCamera] = []
        for number, look in enumerate(self._looks(kind)):
            sensor, timing = new_webcam(kind.profile, noise)
            camera = TableCamera(f"virtual camera {number + 1}", sensor, timing, look, self.clock)
            if kind.cameras != "split":  # which shows two planes
                from_mm = 1000 * self.truth.geometry.cameras_m[number] if kind.mounts == 1 else None
                camera.scale = Scale(*camera.size, sensor.pixel_mm, 0.0, from_mm, 0.0, math.degrees(INCIDENCE))
            self.cameras.append(camera)

    def _port(self, simulation: Simulation) -> LockstepPort | RealtimePort:
        if isinstance(self.clock, LockstepClock):
            return _TablePort(simulation, self.clock)
        return RealtimePort(simulation)

    def _mirrors(self, number: int) -> list[tuple[float, float]]:
        """Yaw and pitch of the mirrors on a board, in radians."""
        simulation = self.simulations[number]
        return simulation.bench.mirrors_rad() if isinstance(self.clock, LockstepClock) else simulation.mirrors_now_rad()

    def replug(self, number: int) -> LockstepPort | RealtimePort:
        """Switch a board on again whose port was closed. Returns its new port, which is in `ports`, too.

        What it saved and how its mount stands are as they were.
        """
        before = self.simulations[number]
        self.ports[number].close()
        simulation = self.simulations[number] = make_simulation(self._boards[number], before.bench)
        if isinstance(self.clock, LockstepClock):
            self.clock.power_on(simulation, before)
        self.ports[number] = self._port(simulation)
        return self.ports[number]

    def _looks(self, kind: Kind) -> list[Callable[[float], list[tuple[float, float]]]]:
        """For each camera, what returns the spots in it at a time."""
        if kind.cameras == "split":
            return [self._split]
        return [partial(self._plane, number) for number in range(len(self.truth.geometry.cameras_m))]

    def _plane(self, number: int, time_s: float) -> list[tuple[float, float]]:
        spot = self.truth.spots_mm(time_s)[number]
        return [] if spot is None else [spot]

    def _split(self, time_s: float) -> list[tuple[float, float]]:
        ways = (-SPLIT_MM, SPLIT_MM)
        spots = zip(self.truth.spots_mm(time_s), ways, strict=True)
        return [(spot[0] + way, spot[1]) for spot, way in spots if spot is not None]

    def now_s(self) -> float:
        """The table's time in seconds."""
        return self.clock.now_s()

    def sleep(self, seconds: float) -> None:
        """Let the table's time pass."""
        self.clock.sleep(seconds)

    def close(self) -> None:
        """Power all boards off."""
        self.clock.close()
        for port in self.ports:
            port.close()
        self._files.cleanup()

    def __enter__(self) -> "VirtualTable":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _TablePort(LockstepPort):
    """A board whose time is the table's."""

    def __init__(self, simulation: Simulation, clock: LockstepClock) -> None:
        super().__init__(simulation, clock.board(simulation), lambda us, until: clock.run(us, simulation, until))
        self._clock = clock

    def monotonic(self) -> float:
        """Seconds of the table's time."""
        return self._clock.now_s()

    def close(self) -> None:
        """Power off; the other boards go on."""
        self._clock.power_off(self.simulation)


def _geometry(kind: Kind) -> Geometry:
    """One camera stands at the last place: there the beam moves farthest."""
    geometry = kind.geometry
    if kind.cameras != "1":
        return geometry
    return Geometry(geometry.laser_m, geometry.between_m, geometry.cameras_m[-1:])


def open_table(url: str) -> VirtualTable:
    """A new table. Raises BadAddress for an option it has not."""
    given = dict(parse_qsl(url.removeprefix(_SCHEME).removeprefix("?"), keep_blank_values=True))
    profile = profile_named(given.pop("profile", SMOOTH.name), given.pop("supply", None))
    seed, off = seed_of(given.pop("seed", "1")), given.pop("off", "0")
    mounts, cameras, speed = given.pop("mounts", "2"), given.pop("cameras", "2"), given.pop("speed", "max")
    boards, encoder = given.pop("boards", mounts), given.pop("encoder", None)
    off_mm = float(off) if off.isascii() and off.replace(".", "", 1).isdecimal() else math.nan
    if (
        given
        or (mounts, boards) not in (("1", "1"), ("2", "1"), ("2", "2"))
        or cameras not in ("1", "2", "split")
        or speed not in ("1", "max")
        or encoder not in (None, *KINDS)
        or not off_mm <= MOST_OFF_MM
    ):
        raise BadAddress(
            f"{printable(url)}: options are mounts=1|2, boards=1|2, cameras=1|2|split, profile=, seed=NUMBER, supply=,"
            " encoder=motor|shaft,"
            f" off=0 … {MOST_OFF_MM:g} (mm), speed=max|1"
        )
    return VirtualTable(Kind(int(mounts), int(boards), cameras, profile, seed, off_mm, speed == "1", encoder=encoder))
