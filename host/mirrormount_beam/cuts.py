"""The light along the axes of a beam, and a Gaussian of the same width and area beside it, for people to look at."""

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount_beam.spot.find import Spot

_REACH, _WITHIN = 4.5, 3.3  # standard deviations that are shown, and of which the light is the area
_POINTS = 91
_LINES = 3  # beside each other, one pixel apart: their mean is shown


class Cut(NamedTuple):
    """angle: degrees clockwise from x. sigma: standard deviation, px. at: px from the place. Others: grey values."""

    angle: float
    sigma: float
    at: NDArray[np.float64]
    light: NDArray[np.float64]
    gaussian: NDArray[np.float64]


def cuts(image: NDArray[Any], spot: Spot) -> tuple[Cut, Cut]:
    """Along the longer and the shorter axis of the spot. Places that are not in the picture are left out.

    The Gaussian's standard deviation is a quarter of the D4-sigma width. Its area is that of the light above the
    background within 3.3 of it: what a Gaussian beam of this size would be.
    """
    return _cut(image, spot, spot.angle, spot.d4_long / 4), _cut(image, spot, spot.angle + 90, spot.d4_short / 4)


def _cut(image: NDArray[Any], spot: Spot, angle: float, sigma: float) -> Cut:
    rows, columns = image.shape
    at = np.linspace(-_REACH * sigma, _REACH * sigma, _POINTS)
    along = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    x, y = spot.x + at * along[0], spot.y + at * along[1]
    there = (x >= 0) & (x <= columns - 1) & (y >= 0) & (y <= rows - 1)
    at, x, y = at[there], x[there], y[there]
    left, top = max(int(x.min()) - _LINES, 0), max(int(y.min()) - _LINES, 0)
    part = image[top : int(y.max()) + _LINES + 1, left : int(x.max()) + _LINES + 1].astype(np.float32)
    beside = (np.arange(_LINES) - _LINES // 2)[:, None]
    maps = (x - left - along[1] * beside).astype(np.float32), (y - top + along[0] * beside).astype(np.float32)
    light = cv2.remap(part, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).mean(axis=0).astype(np.float64)
    inside = np.abs(at) < _WITHIN * sigma
    area = float((light[inside] - spot.background).sum()) * (at[1] - at[0])
    gaussian = spot.background + area / (sigma * math.sqrt(2 * math.pi)) * np.exp(-((at / sigma) ** 2) / 2)
    return Cut((angle + 90) % 180 - 90, sigma, at, light, gaussian)
