"""Blobs that are brighter than an uneven background, in a picture reduced by four."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

REDUCED = 4  # pixels of the picture for one of the reduced one
_TILE = 12  # reduced pixels of a tile, the median of which is one value of the background
ABOVE = 5.0  # threshold in standard deviations of the background's noise
_DARK = 3  # reduced pixels that are darker than the background by the threshold, at least: fewer are noise
_WIDEST_BESIDE = _TILE * REDUCED / 6  # standard deviation of a spot, px, of which a tile holds three to each side
_OF_PEAK = 0.12  # threshold as a part of the brightest value: two spots that touch in their flanks are two blobs


@dataclass(frozen=True, slots=True)
class Blob:
    """One blob, in pixels of the picture. flux: sum of grey values above the background.

    x, y: centroid. width: root of the variance along x and y. cut: it touches the picture's edge.
    """

    x: float
    y: float
    width_x: float
    width_y: float
    flux: float
    peak: float
    cut: bool


@dataclass(frozen=True, slots=True)
class Detection:
    """blobs: the greatest product of peak and flux first.

    threshold, noise: grey values above the background, of a reduced pixel. background: reduced picture of the light
    that is uneven over the whole picture or over its rows. above: the reduced picture less all background.
    """

    blobs: list[Blob]
    threshold: float
    noise: float
    background: NDArray[np.float32]
    above: NDArray[np.float32]

    def background_in(self, left: int, top: int, width: int, height: int) -> NDArray[np.float32]:
        """The background of a part of the picture."""
        offset = (0.5 / REDUCED) - 0.5
        to_reduced = np.array([[1 / REDUCED, 0, left / REDUCED + offset], [0, 1 / REDUCED, top / REDUCED + offset]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        part = cv2.warpAffine(
            self.background, to_reduced, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(part, np.float32)

    def is_dark_beside(self, x: float, y: float, width: float) -> bool:
        """Whether something darker than the background touches a spot of this standard deviation, px.

        False for a spot that is wider than a tile: the tile's median is that of the spot, which leaves a dark rim.
        """
        if width > _WIDEST_BESIDE:
            return False
        rows, columns = self.above.shape
        reach = 3 * width + REDUCED  # a reduced pixel at the rim has light of the spot, too
        half, middle_x, middle_y = reach / REDUCED, (x + 0.5) / REDUCED - 0.5, (y + 0.5) / REDUCED - 0.5
        left, right = max(math.ceil(middle_x - half), 0), min(math.floor(middle_x + half) + 1, columns)
        top, bottom = max(math.ceil(middle_y - half), 0), min(math.floor(middle_y + half) + 1, rows)
        across, down = np.arange(left, right) - middle_x, np.arange(top, bottom)[:, None] - middle_y
        dark = self.above[top:bottom, left:right] < -ABOVE * self.noise
        return int((dark & (across**2 + down**2 < half**2)).sum()) >= _DARK


def detect(image: NDArray[np.uint8] | NDArray[np.uint16]) -> Detection:
    """The blobs of a grey picture.

    A median of 3 x 3 pixels removes single hot pixels. The background is made of what is wider than
    a spot, so uneven, moving and flickering light does not count.
    """
    quiet = cv2.medianBlur(image, 3)
    height, width = image.shape
    small = np.asarray(
        cv2.resize(quiet.astype(np.float32), (width // REDUCED, height // REDUCED), interpolation=cv2.INTER_AREA),
        np.float32,
    )
    background, local = _background(small)
    above = small - background - local
    sample = above[::2, ::2]
    middle = float(np.median(sample))
    noise = 1.4826 * float(np.median(np.abs(sample - middle)))
    above -= middle
    above = np.asarray(cv2.GaussianBlur(above, (3, 3), 0.8), np.float32)
    noise = max(noise, 0.05)
    threshold = max(ABOVE * noise, _OF_PEAK * float(above.max()))
    mask = (above > threshold).astype(np.uint8)
    count, found, areas, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    labels, stats = np.asarray(found, np.int32), np.asarray(areas, np.int32)
    order = sorted(range(1, count), key=lambda i: -stats[i, cv2.CC_STAT_AREA])[:8]
    blobs = [_blob(above, labels, stats[i], i, (width / small.shape[1], height / small.shape[0])) for i in order]
    return Detection(sorted(blobs, key=lambda blob: -blob.peak * blob.flux), threshold, noise, background, above)


def _background(small: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A surface of second order with the medians of rows (flicker under a rolling shutter); what tiles add to it."""
    rows, columns = small.shape
    high, wide = max(rows // _TILE, 2), max(columns // _TILE, 2)
    surface = _surface(_tiles(small, high, wide), rows, columns)
    rest = small - surface
    bands = np.median(rest[:, ::2], axis=1)[:, None].astype(np.float32)
    rest -= bands
    tiles = np.pad(_tiles(rest, high, wide), 2, mode="reflect", reflect_type="odd")  # a slope goes on beyond the edge
    to_tiles = np.array([[wide / columns, 0, 0.5 * wide / columns + 1.5], [0, high / rows, 0.5 * high / rows + 1.5]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    local = cv2.warpAffine(cv2.medianBlur(tiles, 3), to_tiles, (columns, rows), flags=flags)
    return np.asarray(surface + bands, np.float32), np.asarray(local, np.float32)


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

    design, values = terms(*tiles.shape).reshape(-1, 6), tiles.ravel()
    weight, found = np.ones_like(values), np.zeros(6, np.float32)
    for _ in range(4):
        found = np.linalg.lstsq(design * weight[:, None], values * weight, rcond=None)[0]
        apart = values - design @ found
        spread = 1.4826 * float(np.median(np.abs(apart))) + 1e-3
        weight = (np.abs(apart) < 3 * spread).astype(np.float32)
    return terms(rows, columns) @ found.astype(np.float32)


def _centres(count: int) -> NDArray[np.float32]:
    return ((np.arange(count, dtype=np.float32) + 0.5) / count * 2 - 1).astype(np.float32)


def _blob(
    above: NDArray[np.float32],
    labels: NDArray[np.int32],
    stats: NDArray[np.int32],
    label: int,
    scale: tuple[float, float],
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
    cut = left == 0 or top == 0 or left + wide == above.shape[1] or top + high == above.shape[0]
    return Blob(
        x=(left + x + 0.5) * scale[0] - 0.5,
        y=(top + y + 0.5) * scale[1] - 0.5,
        width_x=max(width_x * scale[0], 1.2),
        width_y=max(width_y * scale[1], 1.2),
        flux=flux * scale[0] * scale[1],
        peak=float(part.max()),
        cut=cut,
    )
