"""Camera pictures of the screen, and the position of the spot in a picture."""

from dataclasses import dataclass

import numpy as np

SPOT_MM = 2.0  # radius of the spot (one standard deviation); assumed
_NOISE = 2.0  # read noise, grey levels; assumed
_FLOOR = 10.0  # dark level


@dataclass(frozen=True)
class View:
    """The part of the screen in the picture: left, right, bottom, top in mm, and the pixels' size in mm."""

    left: float
    right: float
    bottom: float
    top: float
    pixel: float = 0.25

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return round((self.top - self.bottom) / self.pixel), round((self.right - self.left) / self.pixel)

    def picture(self, spot_mm: tuple[float, float], noise: np.random.Generator) -> np.ndarray:
        """A grey picture (rows x columns, float, 0 ... 255; row 0 is the top) of the spot at spot_mm."""
        rows, columns = self.shape
        x = self.left + (np.arange(columns) + 0.5) * self.pixel - spot_mm[0]
        y = self.top - (np.arange(rows) + 0.5) * self.pixel - spot_mm[1]
        light = np.exp(-(y[:, None] ** 2 + x[None, :] ** 2) / (2 * SPOT_MM**2))
        return np.clip(np.round(_FLOOR + 220 * light + noise.normal(0, _NOISE, (rows, columns))), 0, 255)

    def centroid(self, picture: np.ndarray) -> tuple[float, float] | None:
        """Where the spot is in a picture, (right, up) in mm: first moments above half of its height.

        None if nothing in the picture stands clear of the noise.
        """
        dark = float(np.median(picture))
        peak = float(picture.max())
        if peak - dark < 20 * _NOISE:
            return None
        weight = np.clip(picture - (dark + peak) / 2, 0, None)
        rows, columns = np.indices(picture.shape)
        total = weight.sum()
        x = self.left + (float((weight * columns).sum() / total) + 0.5) * self.pixel
        y = self.top - (float((weight * rows).sum() / total) + 0.5) * self.pixel
        return x, y
