"""A table without boards and pictures: actuators of the virtual bench, the virtual beam, and spots with noise.

It does what a loop needs (mirrormount_beam/control/interfaces.py) in a thousandth of the time. The faults that
a test orders are attributes. It knows the truth: truth_um() is where the beam is.
"""

import math
from collections.abc import Iterator

import numpy as np

from mirrormount.errors import MoveEnded
from mirrormount_beam.camera import Image, Size
from mirrormount_beam.errors import CameraGone
from mirrormount_beam.spot.find import NoSpot, NoSpotReason, Spot
from mirrormount_beam.table import TargetCamera
from mirrormount_sim.bench import LEVER_X_MM, LEVER_Y_MM
from mirrormount_sim.mechanics import Drivetrain, mirror_angles
from mirrormount_sim.optics import DEFAULT, Geometry
from mirrormount_sim.profiles import PROFILES
from mirrormount_sim.table import Table

FRAME_S = 1 / 30
LATENCY_S = 0.05
REST_S = 0.05  # of a pulse, after it
AIR_MM = 0.003
FIT_PX = 0.02
PX_MM = 0.05
SIZE = Size(640, 480)
EDGE_PX = 24.0


class FastActuator:
    """One axis. sign: -1 with its wires reversed. ended: why its next move ends early. refuses: what a pulse raises."""

    def __init__(self, table: "FastTable", name: str, board_id: str, train: Drivetrain) -> None:
        self.table, self.name, self.board_id, self.train = table, name, board_id, train
        self.step_us = 200_000
        self.sign = 1
        self.ended = ""
        self.refuses: Exception | None = None
        self.pulses = 0
        self.busy_s = 0.0
        self.at_s = 0.0

    def pulse(self, us: int) -> None:
        if self.refuses:
            raise self.refuses
        assert 200 <= abs(us) <= 2_000_000 and isinstance(us, int)
        self._drive(us)

    def step(self, n: int) -> None:
        if self.refuses:
            raise self.refuses
        for _ in range(abs(n)):
            self._drive(int(math.copysign(self.step_us, n)))

    def _drive(self, us: int) -> None:
        self.pulses += 1
        self.follow(self.table.now_s())
        drive = math.copysign(1.0, us) * self.sign
        now_s, others = self.table.now_s(), [a for a in self.table.actuators if a.board_id == self.board_id]
        self.train.begin(drive, self.table.noise, sum(a.busy_s > now_s for a in others if a is not self))
        self.train.advance(abs(us) * 1e-6, drive)
        self.train.advance(REST_S, None)
        self.at_s += abs(us) * 1e-6 + REST_S
        self.busy_s = self.at_s

    def follow(self, time_s: float) -> None:
        if time_s > self.at_s:
            self.train.advance(time_s - self.at_s, None)
            self.at_s = time_s

    def is_moving(self) -> bool:
        if self.ended:
            reason, self.ended = self.ended, ""
            raise MoveEnded(self.name, 4, 0, None, [reason])
        return self.busy_s > self.table.now_s()

    def stop(self) -> None:
        self.busy_s = 0.0


class FastCamera(TargetCamera):
    """One camera, its own source of frames.

    reason, gone, frozen: faults. left: frames with that reason. stale_s: added to the age of each frame.
    """

    def __init__(self, table: "FastTable", number: int, rotation: float, centre: tuple[float, float]) -> None:
        self.table, self.number = table, number
        self.size = SIZE
        um = PX_MM * 1000
        super().__init__(f"camera {number + 1}", self, (319.5, 239.5), (um, um), table.truth.geometry.cameras_m[number])
        del self.view  # no page looks on, and a table is copied as it stands
        self.rotation, self.centre = rotation, centre
        self.reason: NoSpotReason | None = None
        self.left = math.inf
        self.gone = self.frozen = False
        self.stale_s = 0.0
        self._count = 0
        self._tick = -1
        self._place: tuple[float, float] | None = None

    def monotonic(self) -> float:
        return self.table.now_s()

    def px(self, spot_mm: tuple[float, float]) -> tuple[float, float]:
        right, up = spot_mm[0] / PX_MM, spot_mm[1] / PX_MM
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        return self.centre[0] + right * c + up * s, self.centre[1] + right * s - up * c

    def frames(self) -> Iterator[Image]:
        while True:
            if self.gone:
                raise CameraGone(f"{self.name} was unplugged")
            phase = 0.4 * self.number * FRAME_S
            tick = math.floor((self.table.now_s() - LATENCY_S - phase) / FRAME_S + 1e-9)
            if tick <= self._tick:
                tick = self._tick + 1
                self.table.sleep(tick * FRAME_S + phase + LATENCY_S - self.table.now_s())
            self._tick, time_s = tick, tick * FRAME_S + phase
            repeated = self.frozen
            if not repeated:  # the beam of now stands for that of LATENCY_S ago: the loop waits for rest
                spot = self.table.spots_mm()[self.number]
                self._place = spot and self.px((spot[0], spot[1]))
            self._count += 1
            yield Image(np.zeros((1, 1), np.uint8), time_s - self.stale_s, self._count, repeated)

    def find(self, frame: Image) -> Spot | NoSpot:
        if self.reason and self.left > 0:
            self.left -= 1
            return NoSpot(self.reason)
        if self._place is None:
            return NoSpot(NoSpotReason.NOTHING)
        air = self.table.noise.standard_normal(2) * math.hypot(AIR_MM / PX_MM, FIT_PX)
        x, y = self._place[0] + air[0], self._place[1] + air[1]
        if min(x, SIZE.width - 1 - x, y, SIZE.height - 1 - y) < EDGE_PX:
            return NoSpot(NoSpotReason.EDGE)
        return Spot(float(x), float(y), FIT_PX, FIT_PX, 12.0, 12.0, 180.0, 0.0, 0, 600.0)


class FastTable:
    """Two mounts and two cameras, or fewer."""

    def __init__(
        self, profile: str, seed: int, off_mm: float = 0.0, mounts: int = 2, geometry: Geometry = DEFAULT
    ) -> None:
        self.noise = np.random.default_rng([seed, 77])
        self.taken_over = self.lost_board = ""
        self._now_s = 0.0
        self._events: list = []
        kind = PROFILES[profile]
        self.actuators = []
        for mount in ("first", "second")[:mounts]:
            for axis, lever in (("x", LEVER_X_MM), ("y", LEVER_Y_MM)):
                train = Drivetrain.new(lever, kind, self.noise)
                self.actuators.append(FastActuator(self, f"{mount}.{axis}", f"board of {mount}", train))
        self.wired = list(self.actuators)  # whose motors turn the mirrors: x and y of the first, x and y of the second
        self.truth = Table([self._mirrors], mounts, geometry, seed, kind.day_urad)
        if off_mm:
            self.truth.misalign(off_mm, self.noise)
        self.cameras = []
        for number in range(len(geometry.cameras_m)):
            rough = profile != "smooth"
            rotation = math.radians(self.noise.uniform(-3, 3)) if rough else 0.0
            off = self.noise.uniform(-25, 25, 2) if rough else (0.0, 0.0)
            self.cameras.append(FastCamera(self, number, rotation, (319.5 + off[0], 239.5 + off[1])))

    def _mirrors(self):
        for actuator in self.actuators:
            actuator.follow(self._now_s)
        trains = [actuator.train for actuator in self.wired]
        return [mirror_angles(x, y) for x, y in zip(trains[::2], trains[1::2], strict=True)]

    def spots_mm(self):
        return self.truth.spots_mm(self._now_s)

    def truth_um(self) -> np.ndarray:
        """Errors against the targets, without any noise: x and y (up) of each camera."""
        found = []
        for eye, spot in zip(self.cameras, self.spots_mm(), strict=True):
            x, y = eye.px(spot)
            found += [(x - eye.target_px[0]) * PX_MM * 1000, -(y - eye.target_px[1]) * PX_MM * 1000]
        return np.array(found)

    def at(self, time_s: float, action) -> None:
        """Call action() at a time."""
        self._events.append((time_s, action))
        self._events.sort(key=lambda event: event[0])

    def now_s(self) -> float:
        return self._now_s

    def sleep(self, seconds: float) -> None:
        end = self._now_s + max(seconds, 0.0)
        while self._events and self._events[0][0] <= end:
            time_s, action = self._events.pop(0)
            self._now_s = max(self._now_s, time_s)
            action()
        self._now_s = end

    def stop(self) -> None:
        for actuator in self.actuators:
            actuator.stop()

    def take_control(self) -> None:
        self.taken_over = self.lost_board = ""
