"""What a table is going to hold: the loop itself holds a model of it, which does what the calibration has measured.

In the model a pulse moves its screw by the curve's way, with the curve's scatter; a gap's width is drawn anew at each
reversal; a step moves the spots by the response matrix; and the spots drift and tremble as they did at rest. What a
calibration does not measure is not in it: a screw whose pitch varies along its turn, creep, the room's temperature.
"""

import math
from collections.abc import Iterator, Sequence
from copy import deepcopy

import numpy as np

from mirrormount_beam.camera import Controls, Image
from mirrormount_beam.control.backlash import Gap
from mirrormount_beam.control.hold import Hold
from mirrormount_beam.control.response import Response
from mirrormount_beam.runlog import Rms
from mirrormount_beam.selection import WHOLE
from mirrormount_beam.spot.find import Spot
from mirrormount_beam.table import TargetCamera

# So often the model is held, for so long: the middle one counts, for once in a while a reversal throws the beam.
_RUNS, _RUN_S = 3, 100.0
_LATENCY_S = 0.05  # From an exposure to the image, as usual for a webcam.
_NEVER = Rms(math.inf, math.inf)
_BLANK = np.zeros((1, 1), np.uint8)


def promise_of(response: Response, cameras: Sequence[TargetCamera], frame_s: float) -> Rms | None:
    """What the loop makes of the model; None if an interlock ends that. frame_s: from one image to the next."""
    held: list[Rms] = []
    for number in range(_RUNS):
        model = _Model(response, cameras, frame_s, np.random.default_rng(number))
        summary = Hold(model, deepcopy(response), model.gaps()).run(_RUN_S)
        held.append(_NEVER if summary.interlocks else summary.held.rms)
    middle = sorted(held, key=lambda rms: rms.um if rms.urad is None else rms.urad)[_RUNS // 2]
    return None if middle is _NEVER else middle


class _Model:
    """The table, as LoopTable is. errors_um: where the spots are."""

    taken_over = lost_board = ""

    def __init__(
        self, response: Response, cameras: Sequence[TargetCamera], frame_s: float, chance: np.random.Generator
    ) -> None:
        self.response, self.chance = response, chance
        self.errors_um = np.zeros(len(response.noise_um))
        self.actuators = [_Shaft(self, i, *each) for i, each in enumerate(response.belongs["actuators"])]
        self.cameras = [_Eye(self, number, each, frame_s).as_target() for number, each in enumerate(cameras)]
        self._drift = np.linalg.cholesky(response.drift_um2_s)
        self._now_s = 0.0

    def gaps(self) -> list[Gap]:
        """As they are known at the begin: each shaft has met its screw in its positive way."""
        gaps = [Gap(deepcopy(widths)) for widths in self.response.widths]
        for gap in gaps:
            gap.followed(1)
        return gaps

    def now_s(self) -> float:
        return self._now_s

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            self._now_s += seconds
            self.errors_um += self._drift @ self.chance.standard_normal(len(self.errors_um)) * math.sqrt(seconds)

    def stop(self) -> None:
        pass

    def take_control(self) -> None:
        pass


class _Shaft:
    """One actuator. Its place in the gap is a part of the gap's width: 1 where it meets its screw in the way 1."""

    def __init__(self, model: _Model, number: int, name: str, board_id: str, step_us: int) -> None:
        self.name, self.board_id, self.step_us = name, board_id, step_us
        self._model, self._number = model, number
        self._place = self._wide = 1.0  # the gap's width, relative to its mean one
        self._until_s = 0.0

    def pulse(self, us: int) -> None:
        curve = self._model.response.curve
        self._turn(us, curve.steps_of(abs(us)), curve.scatter_of(abs(us)))

    def step(self, n: int) -> None:
        curve = self._model.response.curve
        for _ in range(abs(n)):
            self._turn(int(math.copysign(self.step_us, n)), curve.steps[-1], curve.scatter[-1])

    def is_moving(self) -> bool:
        return self._until_s > self._model.now_s()

    def stop(self) -> None:
        pass

    def _turn(self, us: int, mean: float, scatter: float) -> None:
        model, way = self._model, 1 if us > 0 else -1
        self._until_s = max(self._until_s, model.now_s()) + abs(us) * 1e-6
        # A pulse turns no shaft backwards: a gamma distribution has this mean and scatter, and nothing below 0.
        steps = float(model.chance.gamma((mean / scatter) ** 2, scatter**2 / mean))
        width = model.response.widths[self._number][way]
        free = (1 - self._place if way > 0 else self._place) * self._wide * width.mean
        moved = max(0.0, steps - free)
        if not moved:
            self._place += way * steps / (self._wide * width.mean)
            return
        self._place = 1.0 if way > 0 else 0.0
        self._wide = max(0.1, 1 + width.spread / width.mean * float(model.chance.standard_normal()))
        model.errors_um += model.response.column(self._number, way) * way * moved


class _Eye:
    """One camera; its images are blank, and their spot is where the model's is."""

    selection, controls = WHOLE, Controls(None, None)

    def __init__(self, model: _Model, number: int, camera: TargetCamera, frame_s: float) -> None:
        self.name, self.size = camera.name, camera.size
        self._model, self._like, self._frame_s = model, camera, frame_s
        self._number = 0
        self._errors = slice(2 * number, 2 * number + 2)
        noise = model.response.noise_um[self._errors, self._errors]
        self._noise = np.linalg.cholesky(noise)
        self._sigma_px = [float(each) for each in np.sqrt(np.diag(noise)) / camera.um_per_px]

    def as_target(self) -> TargetCamera:
        """As the loop knows it."""
        like = self._like
        return TargetCamera(self.name, self, like.target_px, like.um_per_px, like.distance_m, find=self.spot)

    def frames(self) -> Iterator[Image]:
        model = self._model
        while True:
            number = max(math.floor((model.now_s() - _LATENCY_S) / self._frame_s + 1e-9), self._number + 1)
            model.sleep(number * self._frame_s + _LATENCY_S - model.now_s())
            self._number = number
            yield Image(_BLANK, number * self._frame_s, number)

    def monotonic(self) -> float:
        return self._model.now_s()

    def close(self) -> None:
        pass

    def spot(self, _: Image) -> Spot:
        """Where the spot is now, with the noise of one image."""
        right, up = self._model.errors_um[self._errors] + self._noise @ self._model.chance.standard_normal(2)
        (x, y), (um_x, um_y) = self._like.target_px, self._like.um_per_px
        return Spot(
            x + float(right) / um_x,
            y - float(up) / um_y,
            self._sigma_px[0],
            self._sigma_px[1],
            12.0,
            12.0,
            180.0,
            0.0,
            0,
            600.0,
        )
