"""A virtual webcam on the optical table: when it exposes, when its frames arrive, and what becomes of them.

It exposes by the table's clock while somebody reads its frames. A test orders faults: unplugged, black, frozen, and
those of the sensor.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mirrormount.beam.camera import Controls, Frame, Size
from mirrormount.beam.checked import Limits, Picture, checked
from mirrormount.beam.scale import Scale
from mirrormount.common.beam_errors import CameraGone
from mirrormount.virtual.sensor import Sensor
from mirrormount.virtual.table_clock import Clock

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


@dataclass(frozen=True)
class _Exposure:
    number: int
    time_s: float
    due_s: float
    spots: list[Place]
    repeated: bool


class TableCamera:
    """A mirrormount.beam.camera.Camera. look: returns the spots (mm) in the camera's plane at a time in s.

    scale: what is known of it here; its distance, where one mirror turns the beam. Set black, frozen and plugged to
    order a fault, more_mm for further spots in the plane.
    """

    def __init__(
        self, name: str, sensor: Sensor, timing: Timing, look: Callable[[float], list[Place]], clock: Clock
    ) -> None:
        self.name = name
        self.sensor = sensor
        self.size = Size(sensor.width, sensor.height)
        self.scale: Scale | None = None
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
        self._image: NDArray[np.uint8] | None = None

    @property
    def controls(self) -> Controls:
        """Those of the sensor."""
        return Controls(True, True, self.sensor.exposure_s, "s", self.sensor.gain)

    def monotonic(self) -> float:
        """The table's time."""
        return self.clock.now_s()

    def frames(self) -> Iterator[Frame]:
        """Each time the newest frame that has not been returned. Raises CameraError, as a webcam does."""
        self.size = Size(self.sensor.width, self.sensor.height)
        self._image = None
        numbers: deque[int] = deque()
        return checked(self._pictures(numbers), self.name, self.size, _LIMITS, numbers=iter(numbers.popleft, None))

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
            if self.black:
                self._image = np.zeros((self.sensor.height, self.sensor.width), np.uint8)
            else:
                self._image = self.sensor.picture(exposure.spots, exposure.time_s)
        return Picture(self._image, exposure.time_s + STAMP_S * float(self._stamps.standard_normal()))
