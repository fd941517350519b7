"""Blobs that are brighter than an uneven background, in a reduced picture."""

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_REDUCED, _LONGEST = 4, 400  # pixels for one of the reduced picture, or as many as leave it so long; then an odd number
_TILE = 12  # reduced pixels of a tile, the median of which is one value of the background
_STRIPS = 12  # that a picture is cut into, at least; a third of them is taken to have nothing but flicker
ABOVE = 5.0  # threshold in standard deviations of the background's noise
_OF_PEAK = 0.12  # threshold as a part of the brightest value: two spots that touch in their flanks are two blobs


@dataclass(frozen=True, slots=True)
class Blob:
    """One blob, in pixels of the picture. flux: sum of grey values above the background.

    x, y: centroid. width: root of the variance along x and y.
    """

    x: float
    y: float
    width_x: float
    width_y: float
    flux: float
    peak: float

    @property
    def start(self) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Centre, covariance and peak, to follow the beam from."""
        return np.array([self.x, self.y]), np.diag([self.width_x**2, self.width_y**2]), self.peak


@dataclass(frozen=True, slots=True)
class Detection:
    """blobs: the greatest product of peak and flux first.

    threshold, noise: grey values above the background, of a reduced pixel. background: reduced picture of the light
    that is uneven over the whole picture or over its rows. bands: what its rows have more than others. small: the
    reduced picture. scale: pixels for one of it. corner: x, y of the first pixel of what was looked at.
    """

    blobs: list[Blob]
    threshold: float
    noise: float
    background: NDArray[np.float32]
    bands: NDArray[np.float32]
    small: NDArray[np.float32]
    scale: int
    corner: tuple[int, int] = (0, 0)

    def moved(self, x: int, y: int) -> "Detection":
        """The same in a picture that this one was a part of, from that pixel on."""
        blobs = [replace(blob, x=blob.x + x, y=blob.y + y) for blob in self.blobs]
        return replace(self, blobs=blobs, corner=(x, y))

    def background_along(self, row: int, columns: int) -> NDArray[np.float32]:
        """The background of a row of the picture, which has so many columns."""
        x, y = self.corner
        line = self.background[min(max(row - y, 0) // self.scale, len(self.background) - 1)]
        at = (np.arange(columns) - x + 0.5) / self.scale - 0.5
        return np.interp(at, np.arange(line.size), line).astype(np.float32)

    def level_of(self, rows: NDArray[Any]) -> NDArray[np.float32]:
        """What these rows of the picture have more than others (flicker), grey values."""
        reduced = (rows + 0.5) / self.scale - 0.5
        return np.interp(reduced, np.arange(self.bands.size), self.bands).astype(np.float32)


def means(image: NDArray[Any], side: int) -> NDArray[np.float32]:
    """Means of squares of side x side pixels; rows and columns that fill no square are left out."""
    if side == 1:
        return image.astype(np.float32)
    rows, columns = max(image.shape[0] // side, 1), max(image.shape[1] // side, 1)
    whole = image[: rows * side, : columns * side]
    if image.dtype.kind == "u":  # sums of rows in whole numbers: six times as fast as OpenCV's means
        wide = np.uint16 if image.dtype == np.uint8 and side < 257 else np.uint32
        whole = whole.reshape(rows, -1, whole.shape[1]).sum(axis=1, dtype=wide) * np.float32(1 / side)
    return np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)


def median(values: NDArray[Any]) -> float:
    """The middle one, or the upper one of two: np.median() takes several times as long for few values."""
    flat = values.ravel()
    return float(np.partition(flat, flat.size // 2)[flat.size // 2])


def detect(image: NDArray[np.uint8] | NDArray[np.uint16]) -> Detection:
    """The blobs of a grey picture.

    A median of 3 x 3 pixels removes single hot pixels. The background is made of what is wider than
    a spot, so uneven, moving and flickering light does not count.
    """
    quiet = cv2.medianBlur(image, 3)
    longest = max(image.shape)
    by = max(_REDUCED, (longest // _LONGEST) | 1 if longest > _REDUCED * _LONGEST else 0)
    small = means(quiet, by)
    bands = _bands(small)
    background, local = _background(small, bands)
    above = small - background - local
    sample = above[::2, ::2]
    middle = median(sample)
    noise = 1.4826 * median(np.abs(sample - middle))
    above -= middle
    above = np.asarray(cv2.GaussianBlur(above, (3, 3), 0.8), np.float32)
    noise = max(noise, 0.05)
    threshold = max(ABOVE * noise, _OF_PEAK * float(above.max()))
    mask = (above > threshold).astype(np.uint8)
    count, found, areas, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    labels, stats = np.asarray(found, np.int32), np.asarray(areas, np.int32)
    order = sorted(range(1, count), key=lambda i: -stats[i, cv2.CC_STAT_AREA])[:8]
    blobs = [_blob(above, labels, stats[i], i, by) for i in order]
    return Detection(
        sorted(blobs, key=lambda blob: -blob.peak * blob.flux), threshold, noise, background, bands, small, by
    )


_COARSE = 4  # reduced pixels for one in which a wide beam is looked for
_BELOW = 0.1  # part of the light that the surface of the surroundings has below it
_WIDE = 12.0  # standard deviation of a wide beam, px, at least


def wide(seen: Detection) -> Blob | None:
    """The brightest wide place above a plane that follows the darkest parts of the picture; None if it is not wide.

    The tiles of detect() take a beam wider than themselves for background.
    """
    rows, columns = seen.small.shape
    size = (max(columns // _COARSE, 8), max(rows // _COARSE, 8))
    coarse = np.asarray(cv2.resize(seen.small, size, interpolation=cv2.INTER_AREA), np.float64)
    coarse = cv2.GaussianBlur(coarse, (0, 0), 0.7)
    y, x = np.mgrid[: size[1], : size[0]]
    terms = np.stack([np.ones(coarse.size), x.ravel() / size[0] - 0.5, y.ravel() / size[1] - 0.5])
    values, weight, plane = coarse.ravel(), np.ones(coarse.size), np.zeros(3)
    for _ in range(8):
        plane = np.linalg.solve((terms * weight) @ terms.T, (terms * weight) @ values)
        weight = np.where(values > plane @ terms, _BELOW, 1 - _BELOW)
    above = coarse - (plane @ terms).reshape(coarse.shape)
    top = np.unravel_index(int(np.argmax(above)), above.shape)
    peak = float(above[top])
    if peak <= ABOVE * seen.noise:
        return None
    _, labels = cv2.connectedComponents((above > peak / 2).astype(np.uint8))
    here = labels == labels[top]
    at_y, at_x = np.nonzero(here)
    weights = above[here] - peak / 2
    scale = seen.scale * columns / size[0], seen.scale * rows / size[1]
    across, down = (float((weights * at).sum() / weights.sum()) for at in (at_x, at_y))
    # an area above half of a Gaussian's peak is 2 pi ln 2 of its standard deviations squared
    size_px = math.sqrt(float(here.sum()) * scale[0] * scale[1] / (2 * math.pi * math.log(2)))
    if size_px < _WIDE:
        return None
    spread = [max(float(at.std()), 0.3) for at in (at_x, at_y)]
    ratio = math.sqrt(spread[0] * scale[0] / (spread[1] * scale[1]))
    return Blob(
        x=(across + 0.5) * scale[0] - 0.5,
        y=(down + 0.5) * scale[1] - 0.5,
        width_x=size_px * ratio,
        width_y=size_px / ratio,
        flux=float(weights.sum()) * scale[0] * scale[1],
        peak=peak,
    )


def _background(
    small: NDArray[np.float32], bands: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A surface of second order with the bands; what tiles add to it."""
    rows, columns = small.shape
    high, wide = max(rows // _TILE, 2), max(columns // _TILE, 2)
    rest = small - bands[:, None]
    surface = _surface(_tiles(rest, high, wide), rows, columns)
    rest -= surface
    tiles = np.pad(_tiles(rest, high, wide), 2, mode="reflect", reflect_type="odd")  # a slope goes on beyond the edge
    to_tiles = np.array([[wide / columns, 0, 0.5 * wide / columns + 1.5], [0, high / rows, 0.5 * high / rows + 1.5]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    local = cv2.warpAffine(cv2.medianBlur(tiles, 3), to_tiles, (columns, rows), flags=flags)
    return np.asarray(surface + bands[:, None], np.float32), np.asarray(local, np.float32)


def _bands(small: NDArray[np.float32]) -> NDArray[np.float32]:
    """What each row has more than others: flicker of lamps under a rolling shutter is the same all along a row.

    The picture is cut into upright strips. Those that differ least from the others tell it, for a window or a lamp is
    in some of them only.
    """
    rows, columns = small.shape
    wide = max(columns // _STRIPS, 1)
    strips = small[:, : columns // wide * wide].reshape(rows, -1, wide)[:, :, :: max(wide // 20, 1)]
    strips = _level(np.median(strips, axis=2))
    bands = np.median(strips, axis=1)
    for _ in range(2):
        apart = np.abs(_level(strips - bands[:, None])).mean(axis=0)
        bands = np.median(strips[:, np.argsort(apart)[: max(apart.size // 3, 1)]], axis=1)
    return np.asarray(bands, np.float32)


def _level(strips: NDArray[np.float32]) -> NDArray[np.float32]:
    """Strips with the same level."""
    return strips - np.median(strips, axis=0)


def _tiles(small: NDArray[np.float32], high: int, wide: int) -> NDArray[np.float32]:
    """Medians of high x wide tiles."""
    rows, columns = small.shape
    tiles = small[: high * (rows // high), : wide * (columns // wide)]
    tiles = tiles.reshape(high, rows // high, wide, columns // wide)[:, ::2]
    return np.median(tiles.transpose(0, 2, 1, 3).reshape(high, wide, -1), axis=2).astype(np.float32)


def _surface(tiles: NDArray[np.float32], rows: int, columns: int) -> NDArray[np.float32]:
    """A polynomial of second order through the tiles, without those that lie far above it."""

    def terms(high: int, wide: int) -> NDArray[np.float32]:
        y, x = np.meshgrid(_centres(high), _centres(wide), indexing="ij")
        return np.stack([np.ones_like(x), x, y, x * y, x * x, y * y], axis=-1)

    design, values = terms(*tiles.shape).reshape(-1, 6).astype(np.float64), tiles.ravel()
    weight, found = np.ones_like(values), np.zeros(6)
    for _ in range(4):
        weighted = design.T * weight
        found = np.linalg.solve(weighted @ design + 1e-9 * np.eye(6), weighted @ values)  # there may be few tiles
        apart = np.abs(values - design @ found)
        weight = (apart < 3 * (1.4826 * median(apart) + 1e-3)).astype(np.float64)
    return terms(rows, columns) @ found.astype(np.float32)


def _centres(count: int) -> NDArray[np.float32]:
    return ((np.arange(count, dtype=np.float32) + 0.5) / count * 2 - 1).astype(np.float32)


def _blob(
    above: NDArray[np.float32],
    labels: NDArray[np.int32],
    stats: NDArray[np.int32],
    label: int,
    scale: int,
) -> Blob:
    left, top, wide, high = (int(stats[i]) for i in range(4))
    inside = labels[top : top + high, left : left + wide] == label
    part = np.where(inside, above[top : top + high, left : left + wide], 0).astype(np.float64)
    columns, rows = part.sum(axis=0), part.sum(axis=1)
    flux = float(columns.sum())
    at_x, at_y = np.arange(wide), np.arange(high)
    x, y = float(columns @ at_x) / flux, float(rows @ at_y) / flux
    width_x = (float(columns @ (at_x - x) ** 2) / flux) ** 0.5
    width_y = (float(rows @ (at_y - y) ** 2) / flux) ** 0.5
    return Blob(
        x=(left + x + 0.5) * scale - 0.5,
        y=(top + y + 0.5) * scale - 0.5,
        width_x=max(width_x * scale, 1.2),
        width_y=max(width_y * scale, 1.2),
        flux=flux * scale**2,
        peak=float(part.max()),
    )
