"""find_spot: where a laser spot is in a picture, with its standard error, or why there is none.

Order: threshold above an uneven background and its noise, largest blob, least-squares fit of an elliptical Gaussian
with a plane of background, tests of the residual. A centroid of moments is biased by each cut of its flanks, a fit is
not. A significant residual is fitted (a ghost), masked (a fly), or the spot is refused.
"""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount.beam import blobs, gaussian, speckle
from mirrormount.beam.located import GHOST, WIDEST, Located, is_double, locate, one_sided
from mirrormount.beam.picture import Dark, Grey, grey
from mirrormount.beam.reasons import Reason

if TYPE_CHECKING:
    from mirrormount.beam.camera import Frame

_SMALLEST = 1.0  # standard deviation of a spot at least, px: a hot pixel is narrower
_LONGISH = 3.0  # ratio of the axes at most
_ALONE = 3.0  # peak at least, in thresholds: a second spot of 40 % would be seen, also with the noise against it
_FAINT = 0.1  # a blob with less of the first one's light is none: some hot pixels
_TIP = 0.05  # part of a blob's light above the threshold, at least: a peak there has noise
_MARGIN = 2.0  # standard deviations between the centre and the picture's edge
_BESIDE = 0.5  # standard deviations between a spot and the centroid of its blob at most; of a single one 0.3
_SATURATED = 0.25  # saturated area at most, in parts of 2 pi sigma_x sigma_y
_SIGNIFICANT = 8.0  # peak at least, in its own standard errors
_NOT_LINEAR = 0.3  # part of a slope of the background that is not below the spot too, as a camera's gamma has it
_HIDDEN = 0.7  # of the error with all the speckle that noise may hide: 3.5 of that one are within 5 of what is stated
_UNSURE = 0.25  # standard error at most, in standard deviations of the spot


@dataclass(frozen=True, slots=True)
class Spot:
    """A spot. Unit: pixels from the centre of the top left one, x to the right, y down.

    sigma_x, sigma_y: standard errors of x and y. width, height: standard deviations of its light along x and y (half of
    the 1/e² radius). peak: grey values above the background. background: grey value below the spot. saturated: number
    of saturated pixels. area: pixels above half of the peak. masked: part of its light that was left out. ghost: light
    of a second, weaker spot that was fitted with it, in parts of the first. detection: threshold and blobs.
    """

    x: float
    y: float
    sigma_x: float
    sigma_y: float
    width: float
    height: float
    peak: float
    background: float
    saturated: int
    area: float
    masked: float = 0.0
    ghost: float = 0.0
    detection: blobs.Detection | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class NoSpot:
    """No spot, and why. It is false: `if spot := find_spot(frame)`."""

    reason: Reason
    detection: blobs.Detection | None = field(default=None, repr=False, compare=False)

    def __bool__(self) -> Literal[False]:
        return False

    def __str__(self) -> str:
        return f"no spot: {self.reason.words}"


def find_spot(
    frame: "Frame | NDArray[np.uint8] | NDArray[np.uint16]", dark: "Dark | NDArray | None" = None
) -> Spot | NoSpot:
    """The spot in a frame or array, (rows, columns) or (rows, columns, channels), 8 or 16 bit.

    dark: a picture without the beam, or a Dark, whose hot pixels are not used. Raises BadValue for an array of another
    form, or a dark picture of another size.
    """
    picture = grey(frame)
    valid = ~picture.saturated
    hot = Dark.of(dark).hot_in(picture.image) if dark is not None else None
    image = picture.image
    if hot is not None:
        valid &= ~hot
        image = np.where(hot, cv2.medianBlur(image, 5), image)
    if picture.flat:
        return NoSpot(Reason.FLAT)
    if picture.saturated.mean() > 0.2:
        return NoSpot(Reason.SATURATED)
    seen = blobs.detect(image)
    if not seen.blobs:
        return NoSpot(Reason.NOTHING, seen)
    first, *others = seen.blobs
    least = _FAINT * _light(first, seen)
    if any(other.peak > GHOST * first.peak and _light(other, seen) > least for other in others):
        return NoSpot(Reason.SPLIT, seen)
    if first.peak < _ALONE * blobs.ABOVE * seen.noise:
        return NoSpot(Reason.DIM, seen)
    found = locate(image, valid, first, seen)
    if isinstance(found, Reason):
        too_bright = _overexposed(picture, (first.x, first.y), (first.width_x, first.width_y))
        return NoSpot(Reason.SATURATED if too_bright else found, seen)
    return _judge(found, picture, seen)


def _light(blob: blobs.Blob, seen: blobs.Detection) -> float:
    """All light of a blob: that of a Gaussian above a level q of its peak is the part 1 - q of it."""
    return blob.flux / max(1 - seen.threshold / blob.peak, _TIP)


def _saturated_around(picture: Grey, centre: tuple[float, float], widths: tuple[float, float]) -> int:
    """How many pixels are saturated within two widths of a place."""
    (x, y), (half_x, half_y) = centre, (int(2 * width) + 1 for width in widths)
    rows = slice(max(round(y) - half_y, 0), round(y) + half_y)
    columns = slice(max(round(x) - half_x, 0), round(x) + half_x)
    return int(picture.saturated[rows, columns].sum())


def _overexposed(picture: Grey, centre: tuple[float, float], widths: tuple[float, float]) -> bool:
    """Is too much of a blob saturated, so that it has not the shape of a spot?"""
    return _saturated_around(picture, centre, widths) > _SATURATED * 2 * math.pi * widths[0] * widths[1]


def _judge(found: Located, picture: Grey, seen: blobs.Detection) -> Spot | NoSpot:
    """The spot with its errors, or what is wrong with it."""
    part, fit = found.part, found.fit
    covariance = fit.covariance()
    wide, high = float(covariance[0, 0] ** 0.5), float(covariance[1, 1] ** 0.5)
    x, y = fit.centre[0] + part.left, fit.centre[1] + part.top
    size = math.sqrt(max(float(np.linalg.det(covariance)), 0))
    rows, columns = picture.image.shape
    groups = part.groups(found.keep, math.sqrt(size))
    expected, grouped = gaussian.errors(fit, found.bins, groups)
    student = 1 + 3.6 / len(np.unique(groups))  # 2 sigma of Student's t for a third of the groups, which see the spot
    variance = np.maximum(np.diag(expected), np.diag(grouped) * student**2) + found.shift**2
    curved, deviation = gaussian.background_shift(fit, found.bins)
    modes = gaussian.modes(fit, found.bins)
    sides = one_sided(modes)
    variance += (sides * np.array([wide, high])) ** 2
    slope = np.array(part.slope) + fit.p[7:9]
    variance += (_NOT_LINEAR * (covariance @ slope) / fit.peak) ** 2
    variance += np.where(np.abs(curved) > 2.5 * deviation, curved, 0) ** 2
    seen_grains, hidden_grains = speckle.variances(fit, found.bins, part.bin)
    variance = np.maximum(variance + seen_grains, _HIDDEN**2 * (variance + hidden_grains))
    sigma_x, sigma_y = (float(v) ** 0.5 for v in variance)
    short, long = np.sqrt(np.linalg.eigvalsh(covariance))
    if long > _LONGISH * short or sides > _UNSURE or seen.is_dark_beside(x, y, max(wide, high)):
        return NoSpot(Reason.SHAPE, seen)
    if is_double(modes, float(long / short)):
        return NoSpot(Reason.SPLIT, seen)
    if short < _SMALLEST:
        return NoSpot(Reason.SMALL, seen)
    if max(wide, high) > WIDEST:
        return NoSpot(Reason.WIDE, seen)
    if min(x + 0.5, columns - 0.5 - x) < _MARGIN * wide or min(y + 0.5, rows - 0.5 - y) < _MARGIN * high:
        return NoSpot(Reason.EDGE, seen)
    saturated = _saturated_around(picture, (x, y), (wide, high))
    if saturated > _SATURATED * 2 * math.pi * size:
        return NoSpot(Reason.SATURATED, seen)
    blob = seen.blobs[0]
    if max(abs(x - blob.x) / wide, abs(y - blob.y) / high) > _BESIDE:  # it has merged with one beyond the fit's window
        return NoSpot(Reason.SPLIT, seen)
    weighted = fit.jacobian * found.bins.weight[:, None]
    sigma_peak = float(np.linalg.inv(weighted.T @ fit.jacobian)[0, 0]) ** 0.5
    if fit.peak < _SIGNIFICANT * sigma_peak or max(sigma_x / wide, sigma_y / high) > _UNSURE:
        return NoSpot(Reason.DIM, seen)
    return Spot(
        x=x,
        y=y,
        sigma_x=sigma_x,
        sigma_y=sigma_y,
        width=wide,
        height=high,
        peak=fit.peak,
        background=float(fit.p[6] + fit.p[7] * fit.p[1] + fit.p[8] * fit.p[2]),
        saturated=saturated,
        area=2 * math.pi * math.log(2) * size,
        masked=found.masked,
        ghost=found.ghost,
        detection=seen,
    )
