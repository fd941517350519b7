"""Virtual optical tables, what `virtual-table://` stands for: boards, a laser that drifts and cameras on one clock.

virtual-table://                 two mounts, each on a board of its own, and two cameras; as fast as it goes
…?mounts=1|2  &cameras=1|2  &encoder=motor|shaft
…&profile=smooth|rough|hardware  &seed=N  &supply=VOLTAGE, of the nominal one
…&off=MILLIMETRES, by which the laser is displaced
…&window=0|1  (1: a window or a lamp in each camera's view)  &emi=0|1  &speed=max|1  (1: in real time)

A test may ask the table for the truth (spots_mm, mirrors_urad); the product sees it through cameras only, and moves it
by pins only. Units: millimetres in the cameras' planes, microradians of a mirror, seconds of the table's time.

In lockstep all boards have reached the same time whenever an event happens or a call returns, to the few microseconds
that a board's processor needs for one instruction more.
"""

import heapq
import itertools
import math
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from mirrormount.device import mount as device
from mirrormount.transport.link import Link
from mirrormount_beam.camera import Controls, Image, Limits, Picture, Size, checked
from mirrormount_beam.cameras import SpotCamera
from mirrormount_beam.errors import CameraGone
from mirrormount_beam.scale import Scale
from mirrormount_beam.selection import WHOLE
from mirrormount_sim.beams import draw_beam, draw_defects, draw_window
from mirrormount_sim.bench import INCIDENCE, POWER
from mirrormount_sim.board import (
    LockstepPort,
    Options,
    RealtimePort,
    make_simulation,
    profile_named,
    seed_of,
    wrong_option,
)
from mirrormount_sim.clocks import Lockstep
from mirrormount_sim.mechanics import KINDS
from mirrormount_sim.optics import DEFAULT, BeamPath, Day, Drift, Fibre, Geometry, Sensor, Spot
from mirrormount_sim.profiles import SMOOTH, Profile
from mirrormount_sim.simulation import START_US, BoardGone, Simulation

Event = Callable[[], None]
_MOST_S = 3600.0  # of one wait of the thread


# ---- the clocks of a table


class Clock(Protocol):
    """The table's time in seconds, from 0 on."""

    def now_s(self) -> float: ...

    def sleep(self, seconds: float) -> None:
        """Let the table's time pass."""
        ...

    def at(self, time_s: float, event: Event) -> None:
        """Call event() at a time; it must not let time pass. One that is in the past comes at once."""
        ...

    def close(self) -> None: ...


class _Agenda:
    """Events in the order of their times (in whole microseconds), and of their coming where the times are equal."""

    def __init__(self) -> None:
        self._events: list[tuple[int, int, Event]] = []
        self._count = itertools.count()

    def add(self, time_s: float, event: Event) -> None:
        heapq.heappush(self._events, (round(time_s * 1e6), next(self._count), event))

    def next_us(self) -> int | None:
        return self._events[0][0] if self._events else None

    def due(self, us: int) -> Event | None:
        return heapq.heappop(self._events)[2] if self._events and self._events[0][0] <= us else None


class LockstepClock:
    """Time passes in sleep() and run() only, for all boards alike."""

    def __init__(self, simulations: list[Simulation]) -> None:
        self._boards = {simulation: Lockstep(simulation) for simulation in simulations}
        self._gone: list[Simulation] = []
        self._agenda = _Agenda()
        self.now_us = START_US
        self.run(max((simulation.now_us for simulation in simulations), default=START_US) - START_US)

    def board(self, simulation: Simulation) -> Lockstep:
        """What sends to a board and receives from it; its time passes by run() of this clock."""
        return self._boards[simulation]

    def now_s(self) -> float:
        """Seconds since power-up."""
        return (self.now_us - START_US) * 1e-6

    def sleep(self, seconds: float) -> None:
        """Let the table's time pass."""
        self.run(round(seconds * 1e6))

    def at(self, time_s: float, event: Event) -> None:
        """As Clock.at()."""
        self._agenda.add(time_s, event)

    def run(self, us: int, simulation: Simulation | None = None, until: Callable[[], bool] = lambda: False) -> bool:
        """Let microseconds pass, or fewer if until(), which a byte from that board may change, comes true; then True.

        Raises BoardGone if that board has ended. Another one that ends is powered off, and the others go on.
        """
        if simulation is not None and simulation not in self._boards:
            raise BoardGone
        end_us = self.now_us + us
        while True:
            event_us = self._agenda.next_us()
            stop_us = end_us if event_us is None else min(end_us, START_US + event_us)
            came, reached_us = False, max(self.now_us, stop_us)
            if simulation is not None:
                came = self._boards[simulation].follow(reached_us, until)
                if came:
                    reached_us = max(self.now_us, self._boards[simulation].at_us)
            for other, board in list(self._boards.items()):
                if other is not simulation:
                    try:
                        board.follow(reached_us)
                    except BoardGone:
                        self.power_off(other)
            self._happen(reached_us)
            if came or self.now_us >= end_us:
                return came

    def _happen(self, reached_us: int) -> None:
        """The table has reached a time: what is due happens."""
        self.now_us = reached_us
        for simulation in self._gone:
            simulation.bench.advance(reached_us)
        while event := self._agenda.due(self.now_us - START_US):
            event()

    def power_off(self, simulation: Simulation) -> None:
        """End a board: its pins go off, and its mount stays as it is."""
        if board := self._boards.pop(simulation, None):
            simulation.now_us = board.at_us
            simulation.close()
            self._gone.append(simulation)

    def power_on(self, simulation: Simulation, before: Simulation) -> None:
        """A board that was switched on again, on the bench of the one before."""
        self._gone.remove(before)
        self._boards[simulation] = Lockstep(simulation)
        self.run(0)

    def close(self) -> None:
        """Power all boards off."""
        for simulation in list(self._boards):
            self.power_off(simulation)


class RealtimeClock:
    """The wall clock from now on. Events happen in a thread."""

    def __init__(self) -> None:
        self._start_s = time.monotonic()
        self._agenda = _Agenda()
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="optical table", daemon=True)
        self._thread.start()

    def now_s(self) -> float:
        """Seconds since the table was opened."""
        return time.monotonic() - self._start_s

    def sleep(self, seconds: float) -> None:
        """Wait: here the wall's time is the table's."""
        time.sleep(max(0.0, seconds))

    def at(self, time_s: float, event: Event) -> None:
        """As Clock.at(); events come late by what the computer is busy."""
        with self._changed:
            self._agenda.add(time_s, event)
            self._changed.notify()

    def _work(self) -> None:
        while not self._closed:
            with self._changed:
                event = self._agenda.due(round(self.now_s() * 1e6))
                if event is None and not self._closed:
                    next_us = self._agenda.next_us()
                    self._changed.wait(_MOST_S if next_us is None else max(0.0, next_us * 1e-6 - self.now_s()))
            if event:
                event()

    def close(self) -> None:
        """No event happens any more."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(5)


FRAMES_S = 30.0  # frames in a second of the table's time; webcams of 640 x 480 have 30
AIR_MM = 0.003  # spread of the spot from frame to frame by moving air; assumed
LATENCY_S = 0.05  # from the middle of the exposure to the arrival; assumed
STAMP_S = 0.001  # spread of a time stamp's error; assumed
_IDLE_S = 1.0  # without a reader, no more exposures
_LIMITS = Limits(rate_hz=1e-6)  # a program in lockstep may look as seldom as it likes
_KEPT = 8  # exposures on their way, or waiting for a reader

Place = tuple[float, float]


@dataclass(frozen=True)
class Timing:
    """When frames come. Fractions are of all frames."""

    phase_s: float = 0.0  # of the first exposure: two cameras do not expose together
    latency_spread_s: float = 0.0
    dropped: float = 0.0
    repeated: float = 0.0


# ---- cameras


@dataclass(frozen=True)
class _Exposure:
    number: int
    time_s: float
    due_s: float
    spots: list[Place]
    repeated: bool


class TableCamera:
    """A mirrormount_beam.camera.Camera. look: returns the spots (mm) in the camera's plane at a time in s.

    distance_m: from the last mirror, along the beam. scale: what is known of it here; with that distance, where one
    mirror turns the beam. Set black, frozen and plugged to order a fault, more_mm for further spots in the plane.
    """

    def __init__(
        self,
        name: str,
        sensor: Sensor,
        timing: Timing,
        look: Callable[[float], list[Place]],
        clock: Clock,
        distance_m: float = 1.0,
    ) -> None:
        self.name = name
        self.sensor = sensor
        self.size = Size(sensor.width, sensor.height)
        self.distance_m = distance_m
        self.scale: Scale | None = None
        self.selection = WHOLE
        self.plugged = True
        self.black = False
        self.frozen = False
        self.more_mm: list[Place] = []
        self._timing = timing
        self._look = look
        self.clock = clock
        self._noise = np.random.default_rng([sensor.seed, 1])
        self._stamps = np.random.default_rng([sensor.seed, 2])
        self._queue: deque[_Exposure] = deque(maxlen=_KEPT)
        self._exposing = False
        self._asked_s = 0.0
        self._next_s = 0.0
        self._number = -1
        self._image: NDArray[Any] | None = None

    @property
    def controls(self) -> Controls:
        """Those of the sensor."""
        return Controls(True, True, self.sensor.exposure_s, "s", self.sensor.gain)

    def monotonic(self) -> float:
        """The table's time."""
        return self.clock.now_s()

    def frames(self) -> Iterator[Image]:
        """Each time the newest frame that has not been returned. Raises CameraError, as a webcam does."""
        self.size = Size(self.sensor.width, self.sensor.height)
        self._image = None
        numbers: deque[int] = deque()
        counted = iter(numbers.popleft, None)
        return checked(
            self._pictures(numbers), self.name, self.size, _LIMITS, numbers=counted, selection=self.selection
        )

    def _pictures(self, numbers: deque[int]) -> Iterator[Picture]:
        """Pictures as they arrive; each one's number is put into numbers. Raises CameraGone."""
        while True:
            now_s = self._asked_s = self.clock.now_s()
            if not self.plugged:
                raise CameraGone(f"{self.name} was unplugged")
            self._expose_from(now_s)
            newest = None
            while self._queue and self._queue[0].due_s <= now_s:
                newest = self._queue.popleft()
            if newest:
                numbers.append(newest.number)
                yield self._developed(newest)
            else:
                next_s = min((exposure.due_s for exposure in self._queue.copy()), default=self._next_s)
                self.clock.sleep(max(1e-4, next_s - now_s))

    def truth_px(self, spot_mm: Place) -> Place:
        """Where in the picture a place in the plane is. For tests."""
        return self.sensor.place(spot_mm)

    def close(self) -> None:
        """No more frames are exposed."""
        self._asked_s = -_IDLE_S
        self._queue.clear()

    def _expose_from(self, now_s: float) -> None:
        """Begin to expose, unless that goes on."""
        if not self._exposing:
            self._exposing = True
            self._queue.clear()  # what was exposed before the pause is no fresh frame
            self._schedule(int(max(0.0, now_s - self._timing.phase_s) * FRAMES_S) + 1)

    def _schedule(self, period: int) -> None:
        self._next_s = self._timing.phase_s + period / FRAMES_S
        self.clock.at(self._next_s, lambda: self._expose(period))

    def _expose(self, period: int) -> None:
        time_s, timing = self._next_s, self._timing
        if time_s - self._asked_s > _IDLE_S:
            self._exposing = False
            return
        self._number += 1
        dropped, repeated = self._noise.random(2)
        air = self._noise.standard_normal(2) * AIR_MM
        late_s = abs(float(self._noise.standard_normal())) * timing.latency_spread_s
        if dropped >= timing.dropped:
            spots = [(right + float(air[0]), up + float(air[1])) for right, up in (*self._look(time_s), *self.more_mm)]
            due_s = max(time_s + LATENCY_S + late_s, self._queue[-1].due_s if self._queue else 0.0)
            self._queue.append(_Exposure(self._number, time_s, due_s, spots, repeated < timing.repeated))
        self._schedule(period + 1)

    def _developed(self, exposure: _Exposure) -> Picture:
        if self._image is None or not (self.frozen or exposure.repeated):
            self._image = self.sensor.picture(exposure.spots, exposure.time_s)
            if self.black:
                self._image[:] = 0
        return Picture(self._image, exposure.time_s + STAMP_S * float(self._stamps.standard_normal()))


_MOST_ROTATION_DEG = 3.0  # of a camera that was put up by hand
_MOST_OFF_PX = 25.0  # of its middle from the beam
REAL_BEAMS = True  # of all profiles but smooth: beams and sensors as real ones are, not Gaussians with noise


def new_webcam(profile: Profile, noise: np.random.Generator, real: bool | None = None) -> tuple[Sensor, Timing]:
    """A camera of the table of this profile, as it stands there. real: other than REAL_BEAMS."""
    seed, phase_s = int(noise.integers(1 << 31)), float(noise.uniform(0, 1 / FRAMES_S))
    if profile.name == SMOOTH.name:
        return Sensor(seed=seed), Timing(phase_s=phase_s)
    sensor = Sensor(seed=seed, ambient_wave=4.0, lamp=10.0, ghost=0.04, hot_pixels=12)
    sensor.rotation_deg = float(noise.uniform(-_MOST_ROTATION_DEG, _MOST_ROTATION_DEG))
    (x, y), (off_x, off_y) = sensor.centre_px, noise.uniform(-_MOST_OFF_PX, _MOST_OFF_PX, 2)
    sensor.centre_px = x + float(off_x), y + float(off_y)
    if REAL_BEAMS if real is None else real:
        _make_real(sensor)
    return sensor, Timing(phase_s=phase_s, latency_spread_s=0.008, dropped=0.01, repeated=0.005)


def _make_real(sensor: Sensor) -> None:
    """A beam that a person takes for one, and a sensor with small defects; its hot pixels it has already."""
    noise = np.random.default_rng([sensor.seed, 4])
    sensor.spot_sigma_mm *= float(noise.uniform(0.85, 1.25))
    sensor.beam = draw_beam(noise, sensor.spot_sigma_mm / sensor.pixel_mm)
    sensor.defects = replace(draw_defects(noise), hot=0)


_APART_PX = 150.0  # of a window from the middle of the picture


def _add_window(sensor: Sensor) -> None:
    noise, shape = np.random.default_rng([sensor.seed, 5]), (sensor.height, sensor.width)
    sensor.window = draw_window(noise, shape, sensor.width / 2, sensor.height / 2, _APART_PX)


LASER_DRIFT_URAD = 3.0  # of the beam's direction after one second, either way, growing as its root; assumed
LASER_JITTER_URAD = 1.0  # of the beam's direction; assumed
MOUNT_DRIFT_URAD = 0.1  # of a mirror after one second; assumed
READING_S = 0.01  # a reading of the virtual power meter; assumed
ADC_FULL = 50_000  # of 65535, with all light in the fibre: an amplifier as a person sets it
FIBRE_START = 0.01  # of all light, in the fibre when its light is asked for first
MOUNT_JITTER_URAD = 0.3  # of a mirror, from the table's vibration; assumed
_MOST_ON_MIRROR_MM = 7.0  # from a mirror's middle: the rest of its radius is for what the mounts do
Mount = Callable[[], list[tuple[float, float]]]
_OFF_MM, _OFF_MRAD = 1.0, 0.8  # a laser that was put down by hand: its offset and angle, before they are scaled


# ---- the table


class Laser:
    """The beam's source. Set blocked to stop the beam; offset_mm and angle_urad to displace it."""

    def __init__(self, drift: Drift) -> None:
        self.drift = drift
        self.blocked = False
        self.offset_mm = (0.0, 0.0)
        self.angle_urad = (0.0, 0.0)

    def angle_rad(self, time_s: float) -> tuple[float, float]:
        """The beam's direction, right and up."""
        right, up = self.drift.at(time_s)
        return right + self.angle_urad[0] * 1e-6, up + self.angle_urad[1] * 1e-6


class Table:
    """Laser, mirrors, planes.

    mounts: for each board, in the order of the beam, what returns yaw and pitch of its mirrors now, in radians;
    mirrors: how many they are together. day_urad: amplitude of each mirror's drift over a day.
    """

    def __init__(
        self, mounts: Sequence[Mount], mirrors: int, geometry: Geometry, seed: int, day_urad: float = 0.0
    ) -> None:
        sources = [np.random.default_rng(source) for source in np.random.SeedSequence(seed).spawn(1 + mirrors)]
        self._mounts = mounts
        self.geometry = geometry
        self.laser = Laser(Drift(sources[0], LASER_DRIFT_URAD, LASER_JITTER_URAD))
        self.vibrations = [Drift(source, MOUNT_DRIFT_URAD, MOUNT_JITTER_URAD) for source in sources[1:]]
        self._knocked = [(0.0, 0.0)] * mirrors
        phases = np.random.default_rng([seed, 0xDA]).uniform(0, 2 * math.pi, (mirrors, 2))
        self._days = [(Day(day_urad, float(yaw)), Day(day_urad, float(pitch))) for yaw, pitch in phases]
        self._path = BeamPath(mirrors, geometry)
        self._fibre = Fibre(mirrors, geometry, FIBRE_START, np.random.default_rng([seed, 0xF1]))

    def bump(self, mirror: int, yaw_urad: float, pitch_urad: float) -> None:
        """Knock a mount: its mirror is turned by so much, at once and for good."""
        yaw, pitch = self._knocked[mirror]
        self._knocked[mirror] = yaw + yaw_urad * 1e-6, pitch + pitch_urad * 1e-6

    def misalign(self, off_mm: float, noise: np.random.Generator) -> None:
        """Displace the laser at random, so that the farthest spot is off_mm from its centre, right or up.

        Offset and angle that nearly cancel at the cameras would be so large that the beam nearly misses a mirror:
        others are drawn then.
        """
        self._displace(off_mm, noise)
        while self._off_mirrors_mm() > _MOST_ON_MIRROR_MM:
            self._displace(off_mm, noise)

    def _off_mirrors_mm(self) -> float:
        """How far from a mirror's middle the displaced beam hits, for small angles."""
        ways_m = (self.geometry.laser_m, self.geometry.laser_m + self.geometry.between_m)[: len(self.vibrations)]
        pairs = zip(self.laser.offset_mm, self.laser.angle_urad, strict=True)
        return max(abs(mm + urad * 1e-3 * way_m) for mm, urad in pairs for way_m in ways_m)

    def _displace(self, off_mm: float, noise: np.random.Generator) -> None:
        drawn = noise.standard_normal(4)
        offset, angle = drawn[:2] * _OFF_MM, drawn[2:] * _OFF_MRAD * 1e-3
        rest = [(0.0, 0.0)] * len(self.vibrations)
        small = 0.1  # of the angle: the beam must not miss a mirror
        spots = self._path.spots(tuple(offset * small), tuple(angle * small), rest)
        scale = small * off_mm / max(abs(x) for spot in spots if spot is not None for x in spot)
        self.laser.offset_mm = float(offset[0] * scale), float(offset[1] * scale)
        self.laser.angle_urad = float(angle[0] * scale * 1e6), float(angle[1] * scale * 1e6)

    def mirrors_rad(self, time_s: float) -> list[tuple[float, float]]:
        """Yaw and pitch of each mirror."""
        driven = [angles for mount in self._mounts for angles in mount()]
        angles = []
        for (yaw, pitch), knocked, drift, day in zip(driven, self._knocked, self.vibrations, self._days, strict=True):
            shaken = drift.at(time_s)
            yaw += knocked[0] + shaken[0] + day[0].at(time_s)
            pitch += knocked[1] + shaken[1] + day[1].at(time_s)
            angles.append((yaw, pitch))
        return angles

    def spots_mm(self, time_s: float) -> list[Spot]:
        """The spot in each camera's plane, (right, up) of its centre; None where no light comes."""
        angle, mirrors = self.laser.angle_rad(time_s), self.mirrors_rad(time_s)
        if self.laser.blocked:
            return [None] * len(self.geometry.cameras_m)
        return self._path.spots(self.laser.offset_mm, angle, mirrors)

    def fibre_light(self, time_s: float) -> tuple[float, float]:
        """The share of the light that is in the fibre, and the largest that the mounts can bring into it now."""
        angle, mirrors = self.laser.angle_rad(time_s), self.mirrors_rad(time_s)
        light, most = self._fibre.light(self.laser.offset_mm, angle, mirrors)
        return (0.0 if self.laser.blocked else light), most

    def fibre_reading(self, time_s: float) -> float:
        """What a power meter at the fibre shows, of 1 for all light, with its noise."""
        return self._fibre.reading(self.fibre_light(time_s)[0])

    def mirrors_urad(self, time_s: float) -> list[tuple[float, float]]:
        """Yaw and pitch of each mirror in microradians."""
        return [(yaw * 1e6, pitch * 1e6) for yaw, pitch in self.mirrors_rad(time_s)]


MOST_OFF_MM = 12.0  # half of the picture's height
_SCHEME = "virtual-table://"


# ---- virtual-table://


@dataclass(frozen=True)
class Kind:
    """Which table. encoder: a kind of mechanics.KINDS on the motors of each board."""

    mounts: int = 2
    cameras: int = 2
    profile: Profile = SMOOTH
    seed: int = 1
    off_mm: float = 0.0
    realtime: bool = False
    encoder: str | None = None
    geometry: Geometry = DEFAULT
    window: bool = False
    emi: bool = False


class VirtualTable:
    """An open table: mounts (or their ports, for Mount(Link(port))), cameras, a clock, and the truth.

    In lockstep time passes in a port's read() and sleep(), in a camera's frames(), and in sleep(); on all boards alike.
    """

    def __init__(self, kind: Kind) -> None:
        seeds = np.random.SeedSequence(kind.seed).generate_state(4)
        self._files = tempfile.TemporaryDirectory(prefix="mirrormount-")  # what the boards save
        kept = Path(self._files.name)
        self._boards = [
            Options(
                seed=int(seeds[unit]),
                profile=kind.profile,
                unit=unit,
                files=kept / str(unit),
                encoder=kind.encoder,
                emi=kind.emi,
            )
            for unit in range(kind.mounts)
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
        self.truth = Table(mounts, kind.mounts, _geometry(kind), int(seeds[2]), kind.profile.day_urad)
        noise = np.random.default_rng(int(seeds[3]))
        if kind.off_mm:
            self.truth.misalign(kind.off_mm, noise)
        self.cameras: list[TableCamera] = []
        for number, distance_m in enumerate(self.truth.geometry.cameras_m):
            sensor, timing = new_webcam(kind.profile, noise)
            if kind.window:
                _add_window(sensor)
            look = partial(self._plane, number)
            camera = TableCamera(f"virtual camera {number + 1}", sensor, timing, look, self.clock, distance_m)
            from_mm = 1000 * distance_m if kind.mounts == 1 else None
            camera.scale = Scale(*camera.size, sensor.pixel_mm, 0.0, from_mm, 0.0, math.degrees(INCIDENCE))
            self.cameras.append(camera)

    def mount(self, number: int = 1) -> device.Mount:
        """The first or the second mount, opened. Raises as Mount.open()."""
        return device.Mount(Link(self.ports[number - 1]))

    def camera(self, number: int = 1) -> SpotCamera:
        """The first or the second camera, which is asked for the spot."""
        return SpotCamera(self.cameras[number - 1])

    def power(self) -> float:
        """What a power meter at the fibre shows, of 1 for all light; a reading takes READING_S."""
        self.sleep(READING_S)
        return self.truth.fibre_reading(self.now_s())

    def connect_fibre(self) -> None:
        """Bring the same to the first board's analog input. It is told whenever the board goes on, so it takes time."""
        self.simulations[0].analog[POWER] = self._adc

    def _adc(self) -> int:
        return min(max(round(self.truth.fibre_reading(self.now_s()) * ADC_FULL), 0), 65535)

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
        simulation.analog = before.analog
        if isinstance(self.clock, LockstepClock):
            self.clock.power_on(simulation, before)
        self.ports[number] = self._port(simulation)
        return self.ports[number]

    def _plane(self, number: int, time_s: float) -> list[tuple[float, float]]:
        spot = self.truth.spots_mm(time_s)[number]
        return [] if spot is None else [spot]

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
    if kind.cameras != 1:
        return geometry
    return Geometry(geometry.laser_m, geometry.between_m, geometry.cameras_m[-1:])


_OPTIONS = (
    "mounts=1|2, cameras=1|2, profile=, seed=NUMBER, supply=, encoder=motor|shaft,"
    f" off=0 … {MOST_OFF_MM:g} (mm), window=0|1, emi=0|1, speed=max|1"
)


def open_table(url: str) -> VirtualTable:
    """A new table. Raises BadAddress for an option it has not."""
    given = dict(parse_qsl(url.removeprefix(_SCHEME).removeprefix("?"), keep_blank_values=True))
    profile = profile_named(given.pop("profile", SMOOTH.name), given.pop("supply", None))
    seed, off = seed_of(given.pop("seed", "1")), given.pop("off", "0")
    mounts, cameras, speed = given.pop("mounts", "2"), given.pop("cameras", "2"), given.pop("speed", "max")
    encoder, window, emi = given.pop("encoder", None), given.pop("window", "0"), given.pop("emi", "0")
    off_mm = float(off) if off.isascii() and off.replace(".", "", 1).isdecimal() else math.nan
    if (
        given
        or mounts not in ("1", "2")
        or cameras not in ("1", "2")
        or window not in ("0", "1")
        or emi not in ("0", "1")
        or speed not in ("1", "max")
        or encoder not in (None, *KINDS)
        or not off_mm <= MOST_OFF_MM
    ):
        raise wrong_option(url, _OPTIONS, given)
    options = {"encoder": encoder, "window": window == "1", "emi": emi == "1", "realtime": speed == "1"}
    return VirtualTable(Kind(int(mounts), int(cameras), profile, seed, off_mm, **options))
