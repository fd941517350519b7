"""The fit of one blob, and of what disturbs it: a ghost, a fly, a second spot."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount.beam import blobs, gaussian, window
from mirrormount.beam.reasons import Reason

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

    part: window.Window
    fit: gaussian.Fit
    bins: gaussian.Bins
    keep: NDArray[np.bool_]
    masked: float
    shift: NDArray[np.float64]
    ghost: float


def locate(image: NDArray[Any], valid: NDArray[np.bool_], blob: blobs.Blob, seen: blobs.Detection) -> Located | Reason:
    """Fit the blob, and what disturbs it."""
    level = min(seen.threshold / max(blob.peak, 1e-9), 0.98)
    cut_off = max(1 - level * -math.log(level) / (1 - level), 0.1)  # what a threshold leaves of a Gaussian's variance
    widths = (blob.width_x / cut_off**0.5, blob.width_y / cut_off**0.5)
    if min(widths) > 2 * WIDEST:
        return Reason.WIDE
    centre = (blob.x, blob.y)
    for _ in range(3):
        part = window.cut(image, valid, centre, widths, _REACH, seen)
        start = _first_fit(part, blob, centre, widths)
        if isinstance(start, Reason):
            return start
        wide, high = np.sqrt(np.diag(start.covariance()))
        near = 0.75 < wide / widths[0] < 1.33 and 0.75 < high / widths[1] < 1.33
        centre, widths = (start.p[1] + part.left, start.p[2] + part.top), (max(wide, 0.7), max(high, 0.7))
        if near:
            return _second_fit(part, start)
    return Reason.SHAPE


def _first_fit(
    part: window.Window, blob: blobs.Blob, centre: tuple[float, float], widths: tuple[float, float]
) -> gaussian.Fit | Reason:
    """A fit with equal weights, for the window's size and the noise."""
    bins, _ = part.bins(None)
    if bins.x.size < 24:
        return Reason.SMALL if part.valid.all() else Reason.SATURATED
    place = (centre[0] - part.left, centre[1] - part.top)
    level = float(np.percentile(bins.value, 10))
    start = gaussian.fit(np.array([blob.peak, *place, widths[0] ** -2, 0, widths[1] ** -2, level, 0, 0]), bins)
    if start is None:
        return Reason.SHAPE
    wide, high = np.sqrt(np.diag(start.covariance()))
    if max(wide, high) > WIDEST:
        return Reason.WIDE
    rows, columns = part.pixels.shape
    if not (-wide < start.p[1] < columns + wide and -high < start.p[2] < rows + high):
        return Reason.EDGE if blob.cut else Reason.SHAPE
    return start


def _second_fit(part: window.Window, start: gaussian.Fit) -> Located | Reason:
    """A fit with the weights of the measured noise, without outliers, and what explains its residual."""
    part.measure_noise(start.p)
    part.drop_outliers(start.p)
    bins, keep = part.bins(start.p)
    if bins.x.size < 24:
        return Reason.SATURATED
    single = gaussian.fit(start.p, bins)
    return Reason.SHAPE if single is None else _explain(part, single, bins, keep)


def _explain(
    part: window.Window, single: gaussian.Fit, bins: gaussian.Bins, keep: NDArray[np.bool_]
) -> Located | Reason:
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
            return Reason.SPLIT
        if good and ratio < most and better > _BETTER:
            if not _apart(double, _CUT) and gaussian.modes(single, bins).odd_chi2 > _ODD:
                return Reason.SHAPE
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
        return Reason.SHAPE
    light = gaussian.evaluate(best.fit.p, best.bins.x, best.bins.y, plane=False)
    core = light > 0.3 * best.fit.peak
    if not core.any() or float(np.sqrt((best.fit.residual[core] ** 2).mean())) > _MISFIT * best.fit.peak:
        return Reason.SHAPE
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


def _in_window(double: gaussian.Fit, part: window.Window) -> bool:
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
