"""What of a picture is looked at: a region, what no mask hides, one channel of a colour picture.

All of it is done before a spot is looked for. The part has the form of a picture, so the finder knows of no region, no
mask and no colour: its edge is an edge, and hidden pixels have become surroundings.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount.device.table_file import AUTOMATIC, CHANNELS
from mirrormount.errors import BadValue
from mirrormount.values import did_you_mean

LEAST_PX = 32  # of a side of what is looked at
_AT = {"green": 1, "red": 2, "blue": 0}  # in OpenCV's order; the first of equals is taken: of green are most pixels
_COLOURS = tuple(_AT)
# of the range, at the brightest place: a dimmer channel does not replace a saturated one, whose flanks say more
_ENOUGH = 0.35
_CORE = 0.25  # of the area above half of the range: a smaller saturated core does not matter to the place
_CLEARLY = 2.0  # times as bright: then another channel of a camera's pictures is taken. Estimate, 1.5 to 3
_NEARLY = 0.9  # of the range: a channel that was left because it was saturated is taken again below that
_SAMPLE = 10_000  # pixels that tell the median
_LONGEST = 1000  # pixels of a side, about, that are enough to choose a channel
_COARSE = 4  # pixels for one of the surroundings that fill a mask
_PATCH = 199  # side of the square of noise that they are given again and again
_NEAREST, _REACH = 2.0, 4.0  # of a hidden pixel at least, and of those that matter, in standard deviations of the beam
_FOLLOWS = 2.0  # times the light that is missing moves the place: the window follows. Measured: 1.7 to 1.8
_DIM = 3  # part of the light with which people see what is not looked at


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """What of a picture is looked at.

    region: x, y of its top left pixel, width, height; None: the whole picture. mask: True where nothing is looked at,
    (rows, columns) of the whole picture. channel: red, green, blue, grey (the largest of the three) or automatic
    (channel_of). contrast: grey values by which a spot's peak is above its surroundings, at least.
    Raises BadValue for what no picture can have.
    """

    region: tuple[int, int, int, int] | None = None
    mask: NDArray[np.bool_] | None = None
    channel: str = AUTOMATIC
    contrast: float = 0.0

    def __post_init__(self) -> None:
        if self.region is not None and (len(self.region) != 4 or not all(float(n).is_integer() for n in self.region)):
            raise BadValue(f"a region is x, y, width and height in whole pixels, not {self.region}")
        if self.mask is not None and not (isinstance(self.mask, np.ndarray) and self.mask.dtype == np.bool_):
            raise BadValue("a mask is an array of truth values (rows, columns), True where nothing is to be looked at")
        if self.channel not in CHANNELS:
            named = str(self.channel)[:40]
            raise BadValue(f"the channel is {', '.join(CHANNELS)}, not {named!r}{did_you_mean(named, CHANNELS)}")
        if not 0 <= self.contrast <= 0xFFFF:
            raise BadValue(f"the contrast is 0 to {0xFFFF} grey values, not {self.contrast}")

    @property
    def is_whole(self) -> bool:
        """Whether all pixels are looked at."""
        return self.region is None and self.mask is None

    def part(self, shape: tuple[int, ...]) -> tuple[slice, slice, NDArray[np.bool_] | None]:
        """Rows and columns that are looked at in a picture of this shape, and what the mask hides of them, if anything.

        Raises BadValue if region or mask are of another picture.
        """
        x, y, width, height = self._region(shape)
        if self.mask is None:
            return slice(y, y + height), slice(x, x + width), None
        if self.mask.shape != tuple(shape[:2]):
            of = " x ".join(map(str, self.mask.shape[::-1]))
            raise BadValue(
                f"the mask has {of} pixels, the picture {shape[1]} x {shape[0]}: make it from a picture of this camera"
            )
        hidden = self.mask[y : y + height, x : x + width]
        rows, columns = (np.flatnonzero(~hidden.all(axis=axis)) for axis in (1, 0))
        if min(len(rows), len(columns)) < LEAST_PX:
            raise BadValue(
                f"the mask leaves less than {LEAST_PX} x {LEAST_PX} pixels to look at: white (True) is what is not"
                " looked at; is it the wrong way round?"
            )
        hidden = hidden[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        down, right = slice(y + rows[0], y + rows[-1] + 1), slice(x + columns[0], x + columns[-1] + 1)
        return down, right, hidden if hidden.any() else None

    def _region(self, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
        """The region in a picture of this shape. Raises BadValue."""
        rows, columns = shape[:2]
        x, y, width, height = map(int, self.region or (0, 0, columns, rows))
        if not (x >= 0 and y >= 0 and x + width <= columns and y + height <= rows):
            raise BadValue(
                f"the region {x},{y},{width},{height} (x, y, width, height) is not in the picture of"
                f" {columns} x {rows} pixels: choose x + width up to {columns} and y + height up to {rows}"
            )
        if min(width, height) < LEAST_PX:
            raise BadValue(f"the region has {width} x {height} pixels: make it at least {LEAST_PX} x {LEAST_PX}")
        return x, y, width, height

    def edge_of(self, at: int, shape: tuple[int, ...], axis: int) -> str:
        """Whose edge is at this row (axis 0) or column (axis 1): "picture", "region" or "mask"."""
        x, y, width, height = self._region(shape)
        begin, length = ((y, height), (x, width))[axis]
        return "picture" if at in (0, shape[axis]) else "region" if at in (begin, begin + length) else "mask"

    def pixels(self, image: NDArray[Any]) -> NDArray[Any]:
        """The grey values of what is looked at."""
        rows, columns, hidden = self.part(image.shape)
        return image[rows, columns] if hidden is None else image[rows, columns][~hidden]

    def shown(self, image: NDArray[Any]) -> NDArray[Any]:
        """A grey picture for people: what is not looked at is dark."""
        if self.is_whole:
            return image
        shown = image // _DIM
        rows, columns, hidden = self.part(image.shape)
        part = image[rows, columns]
        shown[rows, columns] = part if hidden is None else np.where(hidden, shown[rows, columns], part)
        return shown

    def __str__(self) -> str:
        parts = [f"channel {self.channel}"]
        parts += [f"region {','.join(map(str, self.region))}"] if self.region else []
        parts += ["with a mask"] if self.mask is not None else []
        parts += [f"contrast {self.contrast:g} at least"] if self.contrast else []
        return ", ".join(parts)


WHOLE = Selection()


# ---- the channel of a colour picture


class Colour(NamedTuple):
    """channel: the one that is looked at. saturated: those with saturated places in what is looked at."""

    channel: str
    saturated: tuple[str, ...]


def channel_of(image: NDArray[Any], selection: Selection, end: int, before: str = "") -> Colour:
    """The channel of a colour picture (blue, green, red, as OpenCV has them) that is looked at.

    Automatic is the brightest channel: its brightest place is far above its median, and above the other channels there,
    for a laser has a colour and a window has none. If its beam has a large saturated core, another channel that is not
    saturated takes its place if it sees enough light there.
    before: the channel of the camera's image before this one. It stays unless another one is clearly brighter, for two
    channels are never quite the same beam. end: the grey value of a saturated pixel. Single hot pixels do not count:
    four that touch do, or more in a large picture.
    """
    rows, columns, hidden = selection.part(image.shape)
    part = image[rows, columns, :3]
    by = max(2, max(part.shape) // _LONGEST)
    small = cv2.resize(part, (part.shape[1] // by, part.shape[0] // by), interpolation=cv2.INTER_AREA)
    kept = None
    if hidden is not None:
        kept = cv2.resize((~hidden).astype(np.uint8), small.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        small[kept == 0] = 0
    thin = max(1, round(math.sqrt(small.shape[0] * small.shape[1] / _SAMPLE)))
    sample = small[::thin, ::thin].reshape(-1, 3) if kept is None else small[::thin, ::thin][kept[::thin, ::thin] > 0]
    middle = np.median(sample, axis=0) if len(sample) else np.zeros(3)
    light, places = {}, {}
    for name, at in _AT.items():
        _, _, _, (x, y) = cv2.minMaxLoc(cv2.extractChannel(small, at))
        places[name] = {other: float(small[y, x, number]) for other, number in _AT.items()}
        others = max(value for other, value in places[name].items() if other != name)
        light[name] = 2 * places[name][name] - float(middle[at]) - others
    saturated = tuple(name for name in _COLOURS if places[name][name] >= end)
    if selection.channel != AUTOMATIC:
        return Colour(selection.channel, saturated)
    best = max(_COLOURS, key=lambda name: light[name])
    if before and light[best] < _CLEARLY * light[before]:
        best = before
    seen, dark = cv2.extractChannel(small, _AT[best]), middle[_AT[best]]
    core = seen >= min(end, int(places[best][best]))
    large = places[best][best] >= end and int(core.sum()) > _CORE * int((seen > (dark + end) / 2).sum())
    if large or (before and best != before and places[best][best] >= _NEARLY * end):
        there = {name: small[core][:, at] for name, at in _AT.items()}
        light_there = {name: float(values.mean()) for name, values in there.items() if values.max() < end}
        enough = [name for name in light_there if light_there[name] - middle[_AT[name]] >= _ENOUGH * end]
        best = max(enough, key=lambda name: light_there[name], default=best)
    return Colour(best, saturated)


def in_channel(image: NDArray[Any], channel: str) -> NDArray[Any]:
    """A colour picture in one of its channels."""
    if channel in _AT:
        return cv2.extractChannel(image, _AT[channel])
    return cv2.max(cv2.max(image[:, :, 0], image[:, :, 1]), image[:, :, 2])


# ---- what a mask hides


def filled(image: NDArray[Any], hidden: NDArray[np.bool_]) -> NDArray[Any]:
    """A picture, the hidden pixels of which have become smooth surroundings with the noise of the others.

    Without noise they would make the picture quieter than it is.
    """
    rows, columns = image.shape
    open_ = np.where(hidden, np.uint8(0), np.uint8(255))
    size = (max(columns // _COARSE, 1), max(rows // _COARSE, 1))
    light = cv2.resize(cv2.bitwise_and(image, image, mask=open_), size, interpolation=cv2.INTER_AREA)
    weight = cv2.resize(open_, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
    smooth = cv2.resize(_spread(light.astype(np.float32), weight), (columns, rows), interpolation=cv2.INTER_LINEAR)
    every = max(1, image.size // _SAMPLE // 10)
    apart = np.abs(np.diff(image[::every].astype(np.float32), axis=1))
    apart = apart[~(hidden[::every, 1:] | hidden[::every, :-1])]
    noise = 1.4826 / math.sqrt(2) * float(np.median(apart)) if apart.size else 0.0
    patch = np.random.default_rng(1).normal(0, noise, (_PATCH, _PATCH)).astype(np.float32)  # one picture, one answer
    grain = np.tile(patch, (rows // _PATCH + 1, columns // _PATCH + 1))[:rows, :columns]
    kind = cv2.CV_8U if image.dtype == np.uint8 else cv2.CV_16U
    return np.where(hidden, cv2.add(smooth, np.ascontiguousarray(grain), dtype=kind), image)


def _spread(light: NDArray[Any], weight: NDArray[Any]) -> NDArray[Any]:
    """Light where it is known, and where it is not that of coarser and coarser pictures. light: times its weight."""
    known = weight > 0.1
    values = np.divide(light, weight, out=np.zeros_like(light), where=known)
    if known.all() or max(light.shape) < 2:
        return values
    coarse = _spread(cv2.pyrDown(light), cv2.pyrDown(weight))
    return np.where(known, values, cv2.pyrUp(coarse, dstsize=light.shape[::-1]))


def hides(
    hidden: NDArray[np.bool_], centre: tuple[float, float], covariance: NDArray[np.float64]
) -> tuple[float, float] | None:
    """By how much hidden light may move the centroid of a Gaussian beam, along x and y, px; None: it hides the beam."""
    (x0, y0), (wide, high) = centre, (float(value) for value in np.sqrt(np.diag(covariance)))
    left, top = max(int(x0 - _REACH * wide), 0), max(int(y0 - _REACH * high), 0)
    box = hidden[top : int(y0 + _REACH * high) + 2, left : int(x0 + _REACH * wide) + 2]
    y, x = np.nonzero(box)
    x, y = x + left - x0, y + top - y0
    (a, b), (_, c) = np.linalg.inv(covariance)
    r2 = a * x * x + 2 * b * x * y + c * y * y
    if (r2 < _NEAREST**2).any():
        return None
    inside = r2 < _REACH**2
    light = _FOLLOWS * np.exp(-r2[inside] / 2) / (2 * math.pi * math.sqrt(float(np.linalg.det(covariance))))
    return abs(float(light @ x[inside])), abs(float(light @ y[inside]))
