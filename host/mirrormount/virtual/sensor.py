"""Renders what a webcam sees of a spot: 8 bits, gain, exposure, noise, hot pixels, a ghost, ambient light.

Grey values are those at gain 1 and at EXPOSURE_S unless a name says otherwise. No number is of a certain camera: all
are assumed, in the range of webcams of 20 to 50 dollars.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EXPOSURE_S = 0.005  # at which the grey values below are true
_BANK = 1 << 21  # normal numbers, drawn once: a frame takes them from a random place on
_REACH = 6.0  # of a spot, in its own standard deviations: beyond, it is below 1e-5 of a grey value
_LAMP_PX = 180.0  # radius of the moving light, one standard deviation


@dataclass
class Sensor:
    """A camera that looks at a screen, or a bare chip. All may be changed at any time, the size by resize()."""

    exposure_s: float = EXPOSURE_S
    gain: float = 1.0
    width: int = 640
    height: int = 480
    pixel_mm: float = 0.05  # of the plane, for one pixel
    rotation_deg: float = 0.0  # of the camera about the beam; positive turns the picture clockwise
    centre_px: tuple[float, float] = (319.5, 239.5)  # where the plane's centre is, (column, row)
    spot_sigma_mm: float = 0.6  # one standard deviation of the beam's intensity
    peak: float = 180.0  # of the spot
    black: float = 6.0  # without light
    read_noise: float = 1.5
    electrons: float = 47.0  # for one grey value: shot noise is the root of their number
    ambient: float = 8.0
    ambient_wave: float = 0.0  # the room's light rises and falls by so much ...
    wave_s: float = 40.0  # ... in this time
    lamp: float = 0.0  # a bright place that moves over the picture, at its middle
    ghost: float = 0.0  # of the spot's light, from the second surface of a window or a beam splitter
    ghost_px: tuple[float, float] = (70.0, -28.0)  # from the spot to its ghost
    hot_pixels: int = 0
    seed: int = 1

    def __post_init__(self) -> None:
        self.noise = np.random.default_rng(self.seed)
        self._new_size()

    def resize(self, width: int, height: int) -> None:
        """Frames of another size; the middle of the picture stays."""
        x, y = self.centre_px
        self.centre_px = x + (width - self.width) / 2, y + (height - self.height) / 2
        self.width, self.height = width, height
        self._new_size()

    def _new_size(self) -> None:
        self._frame = np.empty((self.height, self.width), np.float32)
        fixed = np.random.default_rng(self.seed)  # hot pixels are of the chip, not of the moment
        self.hot_at = fixed.integers(0, self.width * self.height, self.hot_pixels)
        self._hot = fixed.uniform(40, 250, self.hot_pixels).astype(np.float32)

    def place(self, spot_mm: tuple[float, float]) -> tuple[float, float]:
        """Where in the picture a point (right, up) of the plane is: x (column), y (row) in pixels."""
        right, up = spot_mm[0] / self.pixel_mm, spot_mm[1] / self.pixel_mm
        c, s = math.cos(math.radians(self.rotation_deg)), math.sin(math.radians(self.rotation_deg))
        return self.centre_px[0] + right * c + up * s, self.centre_px[1] + right * s - up * c

    def picture(self, spots_mm: list[tuple[float, float]], time_s: float) -> NDArray[np.uint8]:
        """A frame (rows, columns) with these spots, each of full brightness."""
        frame = self._frame
        scale = self.gain * self.exposure_s / EXPOSURE_S
        ambient = self.ambient + self.ambient_wave * math.sin(2 * math.pi * time_s / self.wave_s)
        dark_noise = math.hypot(self.read_noise * self.gain, self._shot(max(0.0, ambient) * scale))
        np.multiply(self._normal(frame.size).reshape(frame.shape), np.float32(dark_noise), out=frame)
        frame += np.float32(self.black + max(0.0, ambient) * scale + 0.5)  # 0.5: rounded, not cut, below
        if self.lamp:
            frame += self._lamp_light(time_s) * np.float32(self.lamp * scale)
        for spot in spots_mm:
            x, y = self.place(spot)
            self._add(frame, x, y, self.peak * scale)
            if self.ghost:
                self._add(frame, x + self.ghost_px[0], y + self.ghost_px[1], self.ghost * self.peak * scale)
        if self.hot_pixels:
            frame.reshape(-1)[self.hot_at] += self._hot * np.float32(scale)
        np.clip(frame, 0, 255, out=frame)
        return frame.astype(np.uint8)

    def _shot(self, grey: float) -> float:
        return math.sqrt(grey * self.gain / self.electrons)

    def _add(self, frame: NDArray[np.float32], x: float, y: float, peak: float) -> None:
        """Add a spot and its shot noise."""
        sigma = self.spot_sigma_mm / self.pixel_mm
        reach = _REACH * sigma
        left, right = max(0, math.ceil(x - reach)), min(self.width, math.floor(x + reach) + 1)
        top, bottom = max(0, math.ceil(y - reach)), min(self.height, math.floor(y + reach) + 1)
        if left >= right or top >= bottom:
            return
        across = np.exp(-((np.arange(left, right) - x) ** 2) / (2 * sigma**2))
        down = peak * np.exp(-((np.arange(top, bottom) - y) ** 2) / (2 * sigma**2))
        light = np.multiply.outer(down, across).astype(np.float32)
        part = frame[top:bottom, left:right]
        part += light
        shot = np.sqrt(light * np.float32(self.gain / self.electrons))
        part += shot * self._normal(light.size).reshape(light.shape)

    def _lamp_light(self, time_s: float) -> NDArray[np.float32]:
        """The moving light's share at each pixel."""
        turn = 2 * math.pi * time_s / self.wave_s
        x, y = self.width * (0.5 + 0.5 * math.sin(turn)), self.height * (0.5 + 0.5 * math.cos(0.7 * turn))
        across = np.exp(-((np.arange(self.width, dtype=np.float32) - x) ** 2) / (2 * _LAMP_PX**2))
        down = np.exp(-((np.arange(self.height, dtype=np.float32) - y) ** 2) / (2 * _LAMP_PX**2))
        return np.multiply.outer(down.astype(np.float32), across.astype(np.float32))

    def _normal(self, count: int) -> NDArray[np.float32]:
        """Normal numbers, not to be written to. Drawing them afresh would take longer than all the rest."""
        bank = _bank()
        start = int(self.noise.integers(0, len(bank) - count))
        return bank[start : start + count]


@functools.cache
def _bank() -> NDArray[np.float32]:
    return np.random.default_rng(0).standard_normal(_BANK, dtype=np.float32)
