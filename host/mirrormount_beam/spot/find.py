"""`find_spot`: where a laser spot is in an image, with its standard error, or why there is none.

Order: threshold above an uneven background and its noise, largest blob, least-squares fit of an elliptical Gaussian
with a plane of background, tests of the residual. A centroid of moments is biased by each cut of its flanks, a fit is
not. A significant residual is fitted (a ghost), masked (a fly), or the spot is refused. NoSpotReason declares each
reason for no spot once, with the words for people.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount_beam.camera import Dark, Grey, grey
from mirrormount_beam.spot import blobs, gaussian

if TYPE_CHECKING:
    from mirrormount_beam.camera import Image


# ---- why there is no spot


class NoSpotReason(Enum):
    """A reason. words: cause and remedy."""

    def __init__(self, code: str, cause: str, remedy: str) -> None:
        self.code = code
        self.cause = cause
        self.remedy = remedy

    @property
    def words(self) -> str:
        return f"{self.cause}; {self.remedy}"

    FLAT = ("flat", "all pixels have one value", "remove the lens cap, or change the exposure")
    NOTHING = (
        "nothing",
        "nothing is brighter than the background and its noise",
        "switch on the laser, point the camera at the spot, or expose for longer",
    )
    DIM = (
        "dim",
        "the spot is too dim: its place, or a second one, is not known",
        "expose for longer, or darken the room",
    )
    SATURATED = ("saturated", "too many pixels are saturated", "expose for a shorter time, or weaken the beam")
    SPLIT = ("split", "two spots are nearly equally bright", "cover reflections, so that one spot is left")
    EDGE = ("edge", "the spot is cut by the picture's edge", "turn the camera, or move the beam")
    SMALL = (
        "small",
        "the bright place is smaller than a spot, as a hot pixel is",
        "defocus a little, or give a dark frame",
    )
    WIDE = ("wide", "the bright place is larger than a spot, as a lamp is", "focus the spot, or shade the lamp")
    SHAPE = (
        "shape",
        "the bright place has not the shape of a spot",
        "look for something in the beam's way, stray light, or a moving beam",
    )


# that the noise of a good spot looks like in one image of some hundred: no single image says it for sure
BY_CHANCE = frozenset({NoSpotReason.SHAPE, NoSpotReason.SPLIT, NoSpotReason.DIM})


# ---- the fit of one blob, and of what disturbs it

WIDEST = 40.0  # standard deviation of a spot at most, px: a lamp is wider
GHOST = 0.25  # a second spot with at least this part of the first one's light makes the place ambiguous
_GHOST_OUTSIDE = 0.5 * GHOST  # if its flank only is seen: by that its light is known to a factor of two
_REACH = 3.2  # the fit's window, in standard deviations of the spot to each side
_MISFIT = 0.08  # rms of what the fit leaves over in the core, in parts of the peak
_SHIFTED = 3.5  # significance of a core that lies elsewhere than its flanks
_LEFT_OVER = 3.4  # significance of light, or of a lack of it, over an area of the size of the spot
_GROSS = 1.5  # chi² per bin of one spot, above which two may be meant
_BETTER = 11.0  # decrease of chi² by a second spot that is believed
_DOUBT, _DOUBT_MASKED = 0.1, 0.5  # part of the shift by a ghost, by a fly, that is added to the error
_ODD, _EVEN, _ODD_DOUBT, _BOTH_DOUBT = (
    16.0,
    20.0,
    12.0,
    19.0,
)  # chi² of the residual's modes of third, of fourth order, that noise seldom reaches
_ONE_SIDED = 2.5  # shift by what dims one side, in widths for the amplitude of the third order; 6 / (w k)² of exp(-k x)
_TWO_APART = 1.5  # widths between two spots that make the place ambiguous
_CUT = 2.0  # widths; a ghost that is nearer explains as well a spot of which an edge has cut one side off
_LONG, _TWO = 1.25, 0.1  # ratio of the axes, and amplitude of fourth order, of two spots that are seen as one
_MASKED = 0.2  # light at most behind a fly


@dataclass(slots=True)
class Located:
    """A fit: its window and bins, the part of the light that was masked, a doubt of x and y (px), a ghost's light."""

    part: gaussian.Window
    fit: gaussian.Fit
    bins: gaussian.Bins
    keep: NDArray[np.bool_]
    masked: float
    shift: NDArray[np.float64]
    ghost: float


def locate(
    image: NDArray[Any], valid: NDArray[np.bool_], blob: blobs.Blob, seen: blobs.Detection
) -> Located | NoSpotReason:
    """Fit the blob, and what disturbs it."""
    level = min(seen.threshold / max(blob.peak, 1e-9), 0.98)
    cut_off = max(1 - level * -math.log(level) / (1 - level), 0.1)  # what a threshold leaves of a Gaussian's variance
    widths = (blob.width_x / cut_off**0.5, blob.width_y / cut_off**0.5)
    if min(widths) > 2 * WIDEST:
        return NoSpotReason.WIDE
    centre = (blob.x, blob.y)
    for _ in range(3):
        part = gaussian.cut_window(image, valid, centre, widths, _REACH, seen)
        start = _first_fit(part, blob, centre, widths)
        if isinstance(start, NoSpotReason):
            return start
        wide, high = np.sqrt(np.diag(start.covariance()))
        near = 0.75 < wide / widths[0] < 1.33 and 0.75 < high / widths[1] < 1.33
        centre, widths = (start.p[1] + part.left, start.p[2] + part.top), (max(wide, 0.7), max(high, 0.7))
        if near:
            return _second_fit(part, start)
    return NoSpotReason.SHAPE


def _first_fit(
    part: gaussian.Window, blob: blobs.Blob, centre: tuple[float, float], widths: tuple[float, float]
) -> gaussian.Fit | NoSpotReason:
    """A fit with equal weights, for the window's size and the noise."""
    bins, _ = part.bins(None)
    if bins.x.size < 24:
        return NoSpotReason.SMALL if part.valid.all() else NoSpotReason.SATURATED
    place = (centre[0] - part.left, centre[1] - part.top)
    level = float(np.percentile(bins.value, 10))
    start = gaussian.fit(np.array([blob.peak, *place, widths[0] ** -2, 0, widths[1] ** -2, level, 0, 0]), bins)
    if start is None:
        return NoSpotReason.SHAPE
    wide, high = np.sqrt(np.diag(start.covariance()))
    if max(wide, high) > WIDEST:
        return NoSpotReason.WIDE
    rows, columns = part.pixels.shape
    if not (-wide < start.p[1] < columns + wide and -high < start.p[2] < rows + high):
        return NoSpotReason.EDGE if blob.cut else NoSpotReason.SHAPE
    return start


def _second_fit(part: gaussian.Window, start: gaussian.Fit) -> Located | NoSpotReason:
    """A fit with the weights of the measured noise, without outliers, and what explains its residual."""
    part.measure_noise(start.p)
    part.drop_outliers(start.p)
    bins, keep = part.bins(start.p)
    if bins.x.size < 24:
        return NoSpotReason.SATURATED
    single = gaussian.fit(start.p, bins)
    return NoSpotReason.SHAPE if single is None else _explain(part, single, bins, keep)


def _explain(
    part: gaussian.Window, single: gaussian.Fit, bins: gaussian.Bins, keep: NDArray[np.bool_]
) -> Located | NoSpotReason:
    """The simplest model that leaves only noise over: one spot, a spot and its ghost, a spot behind a fly."""
    none = np.zeros(2)
    left = part.left_over(single, bins, keep)
    if float(np.abs(left).max()) < _LEFT_OVER and _only_noise(single, bins) and _only_modes(single, bins):
        return Located(part, single, bins, keep, 0.0, none, 0.0)
    best = Located(part, single, bins, keep, 0.0, none, 0.0)
    brightest = np.unravel_index(int(np.argmax(left)), left.shape)
    for double in _with_ghost(single, bins, part.place(*map(int, brightest))):
        ratio = double.p[9] / double.p[0]
        good = _only_noise(double, bins)
        better = single.chi2 - double.chi2
        gross = single.chi2 > _GROSS * bins.x.size and double.chi2 < 0.7 * single.chi2
        most = GHOST if _in_window(double, part) else _GHOST_OUTSIDE
        if ratio > most and _apart(double, _TWO_APART) and (gross or (good and better > 2 * _BETTER)):
            return NoSpotReason.SPLIT
        if good and ratio < most and better > _BETTER:
            if not _apart(double, _CUT) and gaussian.modes(single, bins).odd_chi2 > _ODD:
                return NoSpotReason.SHAPE
            return Located(part, double, bins, keep, 0.0, _DOUBT * (double.p[1:3] - single.p[1:3]), max(ratio, 0.0))
        if 0 < ratio < most and double.chi2 < 0.7 * best.fit.chi2:
            best = Located(part, double, bins, keep, 0.0, none, ratio)
    grid = np.zeros(keep.shape, np.uint8)
    grid[keep] = np.abs(best.fit.residual) * np.sqrt(bins.weight) > 4
    grid |= left < -_LEFT_OVER
    masked = cv2.dilate(grid, np.ones((3, 3), np.uint8)).astype(bool)
    light = gaussian.evaluate(single.p, bins.x, bins.y, plane=False)
    share = float(light[masked[keep]].sum() / light.sum())
    fewer, kept = part.bins(single.p, masked)
    if 0 < share <= _MASKED and fewer.x.size > 30:
        without = gaussian.fit(best.fit.p, fewer)
        if without is not None:
            doubt = _DOUBT_MASKED * (without.p[1:3] - single.p[1:3])
            best = Located(part, without, fewer, kept, share, doubt, best.ghost)
            if _only_noise(without, fewer):
                return best
    if best.ghost > GHOST:
        return NoSpotReason.SHAPE
    light = gaussian.evaluate(best.fit.p, best.bins.x, best.bins.y, plane=False)
    core = light > 0.3 * best.fit.peak
    if not core.any() or float(np.sqrt((best.fit.residual[core] ** 2).mean())) > _MISFIT * best.fit.peak:
        return NoSpotReason.SHAPE
    best.shift = np.hypot(best.shift, gaussian.core_shift(best.fit, best.bins)[0])
    return best


def one_sided(seen: gaussian.Modes) -> float:
    """A doubt of the place, in widths: something may dim one side of the spot, where more than noise says so."""
    believed = seen.odd_chi2 > _ODD_DOUBT or seen.odd_chi2 + seen.even_chi2 > _BOTH_DOUBT
    return _ONE_SIDED * seen.odd if believed else 0.0


def is_double(seen: gaussian.Modes, ratio: float) -> bool:
    """Whether a spot of this ratio of its axes has the fourth order of two side by side, which no fit of two showed.

    Two that differ in brightness have less of it, but the third order with it.
    """
    return ratio > _LONG and seen.even_chi2 > _EVEN and (seen.even > _TWO or seen.odd_chi2 > _ODD)


def _only_modes(found: gaussian.Fit, bins: gaussian.Bins) -> bool:
    """Whether nothing of the residual has the shape of a missing side or of two spots."""
    seen = gaussian.modes(found, bins)
    return seen.odd_chi2 < _ODD and seen.even_chi2 < _EVEN


def _apart(double: gaussian.Fit, widths: float) -> bool:
    """Whether the two spots are more than so many standard deviations of a spot from each other."""
    way = double.p[10:12] - double.p[1:3]
    return float(way @ double.shape @ way) > widths**2


def _in_window(double: gaussian.Fit, part: gaussian.Window) -> bool:
    """Whether the fainter spot's middle is in the window: else only its flank has been fitted."""
    x, y = double.p[10:12]
    rows, columns = part.pixels.shape
    return bool(0 <= x <= columns - 1 and 0 <= y <= rows - 1)


def _only_noise(found: gaussian.Fit, bins: gaussian.Bins) -> bool:
    """Whether the sum of squares and the core's place are those of noise."""
    free = max(bins.x.size - len(found.p), 1)
    if found.chi2 / free > 1.15 + 4 * (2 / free) ** 0.5:
        return False
    shift, deviation = gaussian.core_shift(found, bins)
    return bool((np.abs(shift) < _SHIFTED * deviation).all())


def _with_ghost(single: gaussian.Fit, bins: gaussian.Bins, place: tuple[float, float]) -> Iterator[gaussian.Fit]:
    """Two spots of one shape: started where light is left over, then as two halves along the longer axis."""
    faint = np.concatenate([single.p, [0.1 * single.peak, *place]])
    values, axes = np.linalg.eigh(single.covariance())
    along = axes[:, 1] * values[1] ** 0.5 * 0.9
    halves = np.concatenate([single.p, [0.7 * single.peak, *(single.p[1:3] + along)]])
    halves[0] *= 0.7
    halves[1:3] -= along
    round_shape = np.eye(2) / values[0]
    halves[3:6] = round_shape[0, 0], 0, round_shape[1, 1]
    for start in (faint, halves):
        double = gaussian.fit(start, bins)
        if double is not None:
            if double.p[9] > double.p[0]:
                double.p[[0, 1, 2, 9, 10, 11]] = double.p[[9, 10, 11, 0, 1, 2]]
                double = gaussian.fit(double.p, bins) or double
            yield double


# ---- the spot of an image

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
    """No spot, and why. It is false: `if spot := find_spot(image)`."""

    reason: NoSpotReason
    detection: blobs.Detection | None = field(default=None, repr=False, compare=False)

    def __bool__(self) -> Literal[False]:
        return False

    def __str__(self) -> str:
        return f"no spot: {self.reason.words}"


def find_spot(
    frame: "Image | NDArray[np.uint8] | NDArray[np.uint16]", dark: "Dark | NDArray | None" = None
) -> Spot | NoSpot:
    """The spot in an image or array, (rows, columns) or (rows, columns, channels), 8 or 16 bit.

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
        return NoSpot(NoSpotReason.FLAT)
    if picture.saturated.mean() > 0.2:
        return NoSpot(NoSpotReason.SATURATED)
    seen = blobs.detect(image)
    if not seen.blobs:
        return NoSpot(NoSpotReason.NOTHING, seen)
    first, *others = seen.blobs
    least = _FAINT * _light(first, seen)
    if any(other.peak > GHOST * first.peak and _light(other, seen) > least for other in others):
        return NoSpot(NoSpotReason.SPLIT, seen)
    if first.peak < _ALONE * blobs.ABOVE * seen.noise:
        return NoSpot(NoSpotReason.DIM, seen)
    found = locate(image, valid, first, seen)
    if isinstance(found, NoSpotReason):
        too_bright = _overexposed(picture, (first.x, first.y), (first.width_x, first.width_y))
        return NoSpot(NoSpotReason.SATURATED if too_bright else found, seen)
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
    expected, grouped = gaussian.fit_errors(fit, found.bins, groups)
    student = 1 + 3.6 / len(np.unique(groups))  # 2 sigma of Student's t for a third of the groups, which see the spot
    variance = np.maximum(np.diag(expected), np.diag(grouped) * student**2) + found.shift**2
    curved, deviation = gaussian.background_shift(fit, found.bins)
    modes = gaussian.modes(fit, found.bins)
    sides = one_sided(modes)
    variance += (sides * np.array([wide, high])) ** 2
    slope = np.array(part.slope) + fit.p[7:9]
    variance += (_NOT_LINEAR * (covariance @ slope) / fit.peak) ** 2
    variance += np.where(np.abs(curved) > 2.5 * deviation, curved, 0) ** 2
    seen_grains, hidden_grains = gaussian.variances(fit, found.bins, part.bin)
    variance = np.maximum(variance + seen_grains, _HIDDEN**2 * (variance + hidden_grains))
    sigma_x, sigma_y = (float(v) ** 0.5 for v in variance)
    short, long = np.sqrt(np.linalg.eigvalsh(covariance))
    if long > _LONGISH * short or sides > _UNSURE or seen.is_dark_beside(x, y, max(wide, high)):
        return NoSpot(NoSpotReason.SHAPE, seen)
    if is_double(modes, float(long / short)):
        return NoSpot(NoSpotReason.SPLIT, seen)
    if short < _SMALLEST:
        return NoSpot(NoSpotReason.SMALL, seen)
    if max(wide, high) > WIDEST:
        return NoSpot(NoSpotReason.WIDE, seen)
    if min(x + 0.5, columns - 0.5 - x) < _MARGIN * wide or min(y + 0.5, rows - 0.5 - y) < _MARGIN * high:
        return NoSpot(NoSpotReason.EDGE, seen)
    saturated = _saturated_around(picture, (x, y), (wide, high))
    if saturated > _SATURATED * 2 * math.pi * size:
        return NoSpot(NoSpotReason.SATURATED, seen)
    blob = seen.blobs[0]
    if max(abs(x - blob.x) / wide, abs(y - blob.y) / high) > _BESIDE:  # it has merged with one beyond the fit's window
        return NoSpot(NoSpotReason.SPLIT, seen)
    weighted = fit.jacobian * found.bins.weight[:, None]
    sigma_peak = float(np.linalg.inv(weighted.T @ fit.jacobian)[0, 0]) ** 0.5
    if fit.peak < _SIGNIFICANT * sigma_peak or max(sigma_x / wide, sigma_y / high) > _UNSURE:
        return NoSpot(NoSpotReason.DIM, seen)
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
