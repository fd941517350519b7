"""The part of a picture around a blob: valid pixels, bins of them, and the noise measured in it."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount.beam.blobs import Detection
from mirrormount.beam.gaussian import Array, Bins, Fit, evaluate

_BINS_OF_A_WIDTH = 2.5  # bins in one standard deviation of the spot: finer bins add time and no precision
_OUTLIER = 7.0  # standard deviations by which a pixel differs from the median of its neighbours


@dataclass(slots=True)
class Window:
    """left, top: of its first pixel in the picture. pixels: float64. valid: False where saturated, hot or disturbed."""

    left: int
    top: int
    pixels: Array
    valid: NDArray[np.bool_]
    bin: int
    slope: tuple[float, float]  # grey values a pixel along x and y that were subtracted as background
    base: float = 1 / 12  # variance of a pixel without light; at least that of rounding
    gain: float = 0.0  # increase of the variance with a grey value of light

    @property
    def grid(self) -> tuple[Array, Array]:
        """x and y of each pixel, relative to the window."""
        rows, columns = self.pixels.shape
        return np.arange(columns, dtype=float)[None, :], np.arange(rows, dtype=float)[:, None]

    def variance(self, light: Array) -> Array:
        """Variance of a pixel with so much light of the spot."""
        return self.base + self.gain * np.maximum(light, 0)

    def bins(self, p: Array | None, masked: NDArray[np.bool_] | None = None) -> tuple[Bins, NDArray[np.bool_]]:
        """The bins whose pixels are all valid, weighted by the light of the model p; and which these are."""
        b = self.bin
        rows, columns = self.pixels.shape[0] // b, self.pixels.shape[1] // b
        shape = (rows, b, columns, b)
        value = self.pixels.reshape(shape).mean(axis=(1, 3))
        keep = np.asarray(self.valid.reshape(shape).all(axis=(1, 3)), np.bool_)
        if masked is not None:
            keep = keep & ~masked
        y, x = (np.mgrid[:rows, :columns] * b + (b - 1) / 2.0)[:, keep]
        light = evaluate(p, x, y, plane=False) if p is not None else np.zeros(x.shape)
        return Bins(x, y, value[keep], b * b / self.variance(light)), keep

    def left_over(self, found: Fit, bins: Bins, keep: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Significance of a further spot of the same size at each bin of the grid; negative where light is missing."""
        width = max(float(np.linalg.det(found.covariance())) ** 0.25 / self.bin, 0.6)
        weighted, weight = np.zeros(keep.shape, np.float32), np.zeros(keep.shape, np.float32)
        weighted[keep] = bins.weight * found.residual
        weight[keep] = bins.weight
        light = cv2.GaussianBlur(weighted, (0, 0), width, borderType=cv2.BORDER_CONSTANT)
        # a kernel that is squared is narrower by the root of two, and its integral is 1 / (4 pi width²)
        noise = cv2.GaussianBlur(weight, (0, 0), width / 2**0.5, borderType=cv2.BORDER_CONSTANT)
        return light / np.sqrt(np.maximum(noise, 1e-12) / (4 * np.pi * width**2))

    def place(self, row: int, column: int) -> tuple[float, float]:
        """x and y of a bin's centre."""
        return column * self.bin + (self.bin - 1) / 2, row * self.bin + (self.bin - 1) / 2

    def groups(self, keep: NDArray[np.bool_], width: float) -> NDArray[np.intp]:
        """For each kept bin, the number of its square of about `width` pixels."""
        side = max(round(width / self.bin), 1)
        rows, columns = np.nonzero(keep)
        return (rows // side) * (keep.shape[1] // side + 1) + columns // side

    def measure_noise(self, p: Array) -> None:
        """Noise of a pixel from differences of near pixels, which a smooth misfit of the model p leaves small."""
        x, y = self.grid
        light = evaluate(p, x, y, plane=False)
        rest = self.pixels - light
        dark = light < 0.1 * p[0]
        bright = (light > 0.4 * p[0]) & (light < 1.5 * p[0])
        base = max(_variance(rest, dark & self.valid), 1 / 12)
        core = bright & self.valid
        gain = (_variance(rest, core) - base) / float(light[core].mean()) if core.sum() > 20 else 0.0
        self.base, self.gain = base, max(gain, 0.0)

    def drop_outliers(self, p: Array) -> int:
        """Mark single pixels that differ from their neighbours as not valid; how many."""
        x, y = self.grid
        light = evaluate(p, x, y, plane=False)
        rest = (self.pixels - light).astype(np.float32)
        apart = np.abs(rest - cv2.medianBlur(rest, 3)) > _OUTLIER * np.sqrt(self.variance(light))
        found = apart & self.valid
        self.valid = self.valid & ~found
        return int(found.sum())


def _variance(rest: Array, where: NDArray[np.bool_]) -> float:
    """Robust variance of a pixel from differences along rows; correlation between neighbours lowers the nearest."""
    largest = 0.0
    for lag in (1, 3):
        both = where[:, lag:] & where[:, :-lag]
        squares = (rest[:, lag:] - rest[:, :-lag])[both] ** 2 / 2
        if squares.size < 10:
            continue
        for _ in range(2):
            squares = squares[squares <= 12 * squares.mean()]  # without what no noise is
        largest = max(largest, float(squares.mean()))
    return largest


def cut(
    image: NDArray[np.uint8] | NDArray[np.uint16],
    valid: NDArray[np.bool_],
    centre: tuple[float, float],
    widths: tuple[float, float],
    reach: float,
    detection: Detection,
) -> Window:
    """The window of `reach` widths around a centre, cut to the picture and to whole bins, less the background."""
    size = max(1, int(min(widths) / _BINS_OF_A_WIDTH))
    (x, y), (wide, high) = centre, widths
    left, right = max(0, int(x - reach * wide - 2)), min(image.shape[1], int(x + reach * wide + 3))
    top, bottom = max(0, int(y - reach * high - 2)), min(image.shape[0], int(y + reach * high + 3))
    right -= (right - left) % size
    bottom -= (bottom - top) % size
    part = (slice(top, bottom), slice(left, right))
    background = detection.background_in(left, top, right - left, bottom - top).astype(np.float64)
    middle = background[background.shape[0] // 4 : -(background.shape[0] // 4) or None]
    down = float(middle[-1].mean() - middle[0].mean()) / max(middle.shape[0] - 1, 1)
    along = float(background[:, -1].mean() - background[:, 0].mean()) / max(background.shape[1] - 1, 1)
    return Window(left, top, image[part] - background, valid[part].copy(), size, (along, down))
