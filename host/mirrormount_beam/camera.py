"""`Camera` and `Image`: what a camera gives, the checks of its images, and grey values. Imports no camera library.

A picture is an array of grey values of shape (rows, columns). A pixel's coordinates are x (column) and y (row), from
the centre of the top left pixel, x to the right and y down. A camera's raw pictures become numbered images, each
compared with the one before; a faulty camera ends them with an error that says what is wrong.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount.device.table_file import AUTOMATIC, GREY
from mirrormount.errors import BadValue
from mirrormount_beam.errors import CameraBlack, CameraRepeats, CameraSizeChanged, CameraSlow
from mirrormount_beam.selection import LEAST_PX, WHOLE, Colour, Selection, channel_of, filled, in_channel


class Size(NamedTuple):
    """Size of a picture in pixels."""

    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width} x {self.height}"


OF_DRIVER = "number of the driver"


class Controls(NamedTuple):
    """Whether the camera keeps exposure and gain: True (fixed), False (automatic), None (the camera does not say).

    exposure, gain: what they are, or were when the camera was opened if they are automatic; None: not known.
    exposure_unit: s, or OF_DRIVER, whose numbers mean something else with each driver, as those of every gain do.
    """

    exposure_fixed: bool | None
    gain_fixed: bool | None
    exposure: float | None = None
    exposure_unit: str | None = None
    gain: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One picture.

    image: uint8, or uint16 of a camera or a file with more than 8 bits; (rows, columns), not to be written to.
    time_s: middle of the exposure on the camera's clock (Camera.monotonic), as well as it is known.
    number: counts the camera's images from 0; a gap is images that are known to be missing.
    repeated: the image is byte for byte that of the image before, so it is no new measurement.
    late: the image came later than two periods of the camera after the image before.
    selection: what of it is looked at. colour: of a colour picture, the channel that this is, and the saturated ones.
    name: of the picture, for people: its file, with the page or the time in it.
    """

    image: "NDArray[np.uint8] | NDArray[np.uint16]"
    time_s: float
    number: int
    repeated: bool = False
    late: bool = False
    selection: Selection = WHOLE
    colour: Colour | None = None
    name: str = ""


class Camera(Protocol):
    """An open camera.

    name: identifies the camera in reports and in saved scales. size: of every frame. selection: what of its pictures
    is looked at; frames() puts it into each one (mirrormount_beam/cameras.py:select sets it).
    """

    @property
    def name(self) -> str: ...

    @property
    def selection(self) -> Selection: ...

    @selection.setter
    def selection(self, selection: Selection, /) -> None: ...

    @property
    def size(self) -> Size: ...

    @property
    def controls(self) -> Controls: ...

    def frames(self) -> Iterator[Image]:
        """Fresh images, until a recording ends or for ever. Raises CameraError; the camera is then to be closed."""
        ...

    def monotonic(self) -> float:
        """The time of the clock that Image.time_s is of, in seconds: the age of an image is the difference."""
        ...

    def close(self) -> None:
        """Release the device; again without effect."""
        ...


# ---- grey values

_BITS = (8, 10, 12, 14)  # of a sensor in a picture of 16: its bits are the lower or the upper ones
_ENDS = {(1 << bits) - 1 << shift for bits in _BITS for shift in (0, 16 - bits)}
_HOT = 8.0  # standard deviations above the dark picture's median


@dataclass(frozen=True, slots=True)
class Grey:
    """A grey picture. saturated: pixels at the end of the range. flat: all have one value."""

    image: NDArray[Any]
    saturated: NDArray[np.bool_]
    flat: bool


def to_grey(image: NDArray[Any]) -> NDArray[Any]:
    """A picture of shape (rows, columns), of the same type. Of colours the largest: what is saturated stays visible.

    Raises BadValue.
    """
    return in_one_channel(image, Selection(channel=GREY))[0]


def in_one_channel(image: NDArray[Any], selection: Selection, before: str = "") -> tuple[NDArray[Any], Colour | None]:
    """A whole picture of shape (rows, columns), of the same type, in the channel that is looked at; and which that is.

    before: the channel of the image before. Raises BadValue.
    """
    if not isinstance(image, np.ndarray):
        raise BadValue(f"a picture is an array of NumPy, not {type(image).__name__}")
    if image.dtype.newbyteorder("=") not in (np.uint8, np.uint16):
        raise BadValue(f"a picture has 8 or 16 bit without sign (numpy.uint8, numpy.uint16), not {image.dtype}")
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    if not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] in (1, 3, 4))) or min(image.shape[:2]) < LEAST_PX:
        raise BadValue(
            f"a picture has rows, columns and 1, 3 or 4 channels, at least {LEAST_PX} x {LEAST_PX}: {image.shape}"
        )
    if image.ndim == 3 and image.shape[2] > 1:
        colour = channel_of(image, selection, _end(image), before)
        return in_channel(image, colour.channel), colour
    if selection.channel not in (AUTOMATIC, GREY):
        raise BadValue(f"the picture is grey, and has no channel {selection.channel}: leave the channel out")
    return np.ascontiguousarray(image if image.ndim == 2 else image[:, :, 0]), None


def _end(image: NDArray[Any]) -> int:
    """The grey value of a saturated pixel."""
    if image.dtype == np.uint8:
        return 255
    high = int(image.max())
    return high if high in _ENDS else 0xFFFF


def grey(image: NDArray[Any], hidden: NDArray[np.bool_] | None = None) -> Grey:
    """A picture of shape (rows, columns), without what is hidden."""
    end = _end(image)
    saturated = image >= end
    if hidden is not None:
        saturated &= ~hidden
        image = filled(image, hidden)
    low, high, _, _ = cv2.minMaxLoc(image)
    return Grey(image, saturated, low == high)


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


# ---- checks

_FIRST = 10  # images that may not all be of one grey value
_WINDOW = 20  # intervals, the median of which is the camera's period


class Limits(NamedTuple):
    """Bounds of a camera. repeats: equal pictures in a row at most. rate_hz: images in a second at least."""

    repeats: int = 30
    rate_hz: float = 0.5
    may_be_black: bool = False


class Picture(NamedTuple):
    """A raw picture (grey or colour), the middle of its exposure, in seconds of the camera's clock, and its name."""

    image: NDArray[Any]
    time_s: float
    name: str = ""


def checked(
    pictures: Iterator[Picture],
    name: str,
    size: Size | None,
    limits: Limits,
    *,
    numbers: Iterator[int] | None = None,
    selection: Selection = WHOLE,
) -> Iterator[Image]:
    """Images of raw pictures. Raises CameraBlack, CameraRepeats, CameraSizeChanged, CameraSlow, BadValue."""
    before: Image | None = None
    equal, intervals, flat = 0, [], 0
    for count, picture in enumerate(pictures):
        rows, columns = picture.image.shape[:2]
        size = size or Size(columns, rows)
        if (columns, rows) != size:
            raise CameraSizeChanged(f"{name}: a frame has {columns} x {rows} pixels, the frames before had {size}")
        channel = before.colour.channel if before and before.colour else ""
        image, colour = in_one_channel(picture.image, selection, channel)
        image = np.array(image)  # a copy: the camera's library may use its own array again
        interval = picture.time_s - before.time_s if before else 0.0
        usual = float(np.median(intervals)) if len(intervals) >= 5 else float("inf")
        repeated = before is not None and np.array_equal(image, before.image)
        flat = flat + 1 if image.min() == image.max() else 0
        equal = equal + 1 if repeated and not flat else 0
        if flat > count and count + 1 >= _FIRST and not limits.may_be_black:
            raise CameraBlack(f"{name}: all pixels of the first {_FIRST} frames have the value {image[0, 0]}")
        if equal >= limits.repeats:
            raise CameraRepeats(f"{name}: {equal + 1} frames in a row are the same picture")
        if before is not None:
            intervals = [*intervals[-_WINDOW:], interval]
            if len(intervals) >= 5 and float(np.median(intervals)) > 1 / limits.rate_hz:
                rate = 1 / float(np.median(intervals))
                raise CameraSlow(f"{name}: {rate:.2g} frames a second, {limits.rate_hz:g} are needed")
        image.flags.writeable = False
        before = Image(
            image,
            picture.time_s,
            next(numbers) if numbers else count,
            repeated=repeated,
            late=bool(interval > 2 * usual),
            selection=selection,
            colour=colour,
            name=picture.name,
        )
        yield before


def range_of(image: NDArray[Any]) -> int:
    """The largest grey value that this picture's sensor can have: of the fewest bits that hold the brightest pixel."""
    if image.dtype == np.uint8:
        return 255
    brightest = int(image.max())
    return next((end for bits in _BITS if (end := (1 << bits) - 1) >= brightest), 0xFFFF)


def as_bytes(image: NDArray[Any], end: int | None = None) -> NDArray[np.uint8]:
    """A grey picture as 8 bits, for people to look at. end: the grey value that becomes white (range_of)."""
    if image.dtype == np.uint8:
        return image
    return np.asarray(cv2.convertScaleAbs(image, alpha=255 / (end or range_of(image))), np.uint8)
