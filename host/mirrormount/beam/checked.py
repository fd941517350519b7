"""Frames from raw pictures: numbered, compared with the one before, and ended in words by a faulty camera."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mirrormount.beam.camera import Frame, Size
from mirrormount.beam.picture import to_grey
from mirrormount.common.beam_errors import CameraBlack, CameraRepeats, CameraSizeChanged, CameraSlow

_FIRST = 10  # frames that may not all be of one grey value
_WINDOW = 20  # intervals, the median of which is the camera's period


class Limits(NamedTuple):
    """Bounds of a camera. repeats: equal pictures in a row at most. rate_hz: frames in a second at least."""

    repeats: int = 30
    rate_hz: float = 0.5
    may_be_black: bool = False


class Picture(NamedTuple):
    """A raw picture (grey or colour) and the middle of its exposure, in seconds of the camera's clock."""

    image: NDArray[Any]
    time_s: float


def checked(
    pictures: Iterator[Picture], name: str, size: Size | None, limits: Limits, *, numbers: Iterator[int] | None = None
) -> Iterator[Frame]:
    """Frames of raw pictures. Raises CameraBlack, CameraRepeats, CameraSizeChanged, CameraSlow."""
    before: Frame | None = None
    equal, intervals, flat = 0, [], 0
    for count, picture in enumerate(pictures):
        image = as_bytes(to_grey(picture.image))
        got = Size(image.shape[1], image.shape[0])
        size = size or got
        if got != size:
            raise CameraSizeChanged(f"{name}: a frame has {got} pixels, the frames before had {size}")
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
        before = Frame(
            image,
            picture.time_s,
            next(numbers) if numbers else count,
            repeated=repeated,
            late=bool(interval > 2 * usual),
        )
        yield before


def as_bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    """A grey picture as 8 bits, a copy; of 16 bits the upper eight."""
    if image.dtype == np.uint16:
        return (image >> 8).astype(np.uint8)
    return np.array(image, np.uint8)
