"""Pictures as arrays of grey values: how a colour becomes grey, which pixels are saturated, and which are hot."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount.common.errors import BadValue

if TYPE_CHECKING:
    from mirrormount.beam.camera import Frame

GREY_OF_COLOUR = "the largest of the colour channels, so that a saturated channel stays visible"
_LEAST = 32  # pixels of a side
# of a sensor of 10, 12 or 14 bits in a picture of 16: its bits are the lower or the upper ones
_ENDS = {(1 << bits) - 1 << shift for bits in (10, 12, 14) for shift in (0, 16 - bits)}
_HOT = 8.0  # standard deviations above the dark picture's median


@dataclass(frozen=True, slots=True)
class Grey:
    """A grey picture. saturated: pixels at the end of the range. flat: all have one value."""

    image: NDArray[Any]
    saturated: NDArray[np.bool_]
    flat: bool


def to_grey(image: NDArray[Any]) -> NDArray[Any]:
    """A picture of shape (rows, columns), of the same type. Colours: GREY_OF_COLOUR. Raises BadValue."""
    if not isinstance(image, np.ndarray):
        raise BadValue(f"a picture is an array of NumPy, not {type(image).__name__}")
    if image.dtype.newbyteorder("=") not in (np.uint8, np.uint16):
        raise BadValue(f"a picture has 8 or 16 bit without sign (numpy.uint8, numpy.uint16), not {image.dtype}")
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    if image.ndim == 3 and image.shape[2] in (3, 4):
        image = cv2.max(cv2.max(image[:, :, 0], image[:, :, 1]), image[:, :, 2])
    elif image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim != 2 or min(image.shape) < _LEAST:
        raise BadValue(
            f"a picture has rows, columns and 1, 3 or 4 channels, at least {_LEAST} x {_LEAST}: {image.shape}"
        )
    return np.ascontiguousarray(image)


def grey(frame: "Frame | NDArray[Any]") -> Grey:
    """A frame or an array as a grey picture. Raises BadValue."""
    array: Any = getattr(frame, "image", frame)
    image = to_grey(array)
    low, high, _, _ = cv2.minMaxLoc(image)
    end = high if image.dtype == np.uint16 and high in _ENDS else np.iinfo(image.dtype).max
    return Grey(image, image >= end, low == high)


@dataclass(frozen=True, slots=True)
class Dark:
    """Hot pixels, learned from one or more pictures without the beam."""

    hot: NDArray[np.bool_]

    @classmethod
    def of(cls, dark: "Dark | NDArray[Any]") -> "Dark":
        """Of one picture, or of a stack (pictures, rows, columns), which is averaged."""
        if isinstance(dark, Dark):
            return dark
        mean = to_grey(dark) if dark.ndim == 2 or dark.shape[-1] in (1, 3, 4) else dark.mean(axis=0)
        mean = mean.astype(np.float32)
        apart = mean - cv2.medianBlur(mean, 5)
        noise = max(float(np.sqrt((apart[np.abs(apart) < 6 * apart.std() + 1e-6] ** 2).mean())), 0.3)
        return cls(apart > _HOT * noise)

    def hot_in(self, image: NDArray[Any]) -> NDArray[np.bool_]:
        """The mask for a picture. Raises BadValue if the size differs."""
        if self.hot.shape != image.shape:
            (rows, columns), (of_rows, of_columns) = image.shape, self.hot.shape
            raise BadValue(f"the dark picture has {of_columns} x {of_rows} pixels, the frame {columns} x {rows}")
        return self.hot
