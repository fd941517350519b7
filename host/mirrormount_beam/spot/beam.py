"""The beam in its window: its surroundings, its size, its place, and how well one image tells the place.

The place is the centroid of the light above its surroundings, inside an ellipse of REACH standard deviations of the
beam about the place itself, with a soft edge. It needs no shape: of an ellipse, a flat top, a skewed or a clipped beam
it is the point about which the light balances. It is continuous in the picture, for no model is chosen.

The size is that of the Gaussian which, used as a weight, has the beam's own covariance (adaptive moments; source:
G. Bernstein, M. Jarvis, Astron. J. 123 (2002) 583). Halos and noise far out hardly change it, while plain second
moments, those of ISO 11146, grow without end in noise. So the size sets the window, and the D4-sigma widths are plain
moments in that window.

Positions are in pixels. The picture of a wide beam is reduced first, and a window has bins, which are means of some
pixels: so a beam of any width takes the same time. On sensors of two fields one row of two is darker: an odd number of
rows in a bin keeps their light balanced.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount_beam.spot.blobs import means, median

Array = NDArray[np.float64]
Pixels = NDArray[Any]  # of a grey picture

REACH = 3.0  # radius of the window in standard deviations of the beam: of a Gaussian it holds 98.9 % of the light
_SOFT = 0.1  # part of the radius by which the window's edge is soft, to each side
_RING, _BOX = 4.0, 5.2  # radii of the ring that shows the surroundings, in standard deviations
_LEAST_BOX = 28.0  # pixels to each side, at least: fewer do not show whether the image was compressed
_BINS = 3  # bins in a standard deviation, at least
_RING_BINS = 1500  # of the ring that are used, about: more take time and change nothing
_OUTLIER = 8.0  # standard deviations by which a hot or a dead pixel is not like its neighbours
_FEW = 5000  # pixels that show the level and the noise of a part of a picture
_NOISE_PIXELS = 40_000  # of the window that the noise is measured at, about
_ROUNDS = 30
_BEYOND = 1.7  # how far a round goes, in parts of the way that it saw
# a round that changes the place and the variance by less than these parts of a standard deviation and of it is the last
_DONE, _DONE_SIZE = 2e-4, 2e-3
_WIDE = 9.0  # standard deviation of the shorter axis, px, above which the picture is reduced
_LEVEL = 0.02  # weight of "the surroundings do not slope", in parts of the ring's bins
_LIKE = 3.0  # standard deviations within which a bin of the ring counts as surroundings
_DIFFERENCE = np.array([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0])  # of sixth order: a smooth beam leaves nothing of it
_NORM2 = float(_DIFFERENCE @ _DIFFERENCE)
_OF_SHORT = 0.3  # of the shorter axis' standard deviation: means of larger squares show the beam, not the noise
# A compressed image has means with more noise than its pixels tell, or pixels with less than their rounding. Its true
# variance is that of the means times so much, and the more, the less noise the compression has left: what it left out
# of the beam is no noise. Measured at JPEG of quality 70 to 95.
_SMOOTHED, _FLAT, _COMPRESSED, _QUIET = 3.0, 1 / 3, 2.6, 0.3
_WIDER_THAN = 3.0  # standard deviation of a beam, px, whose rows and columns show their own noise
_SURE = 12  # differences, as many as the noise of the pixels counts for beside the noise of whole rows and columns
# plain second moments of a Gaussian in the window, in parts of its variance
_KEPT = 1 - REACH**2 / 2 * float(np.exp(-(REACH**2) / 2)) / (1 - float(np.exp(-(REACH**2) / 2)))


@dataclass(slots=True)
class Window:
    """Bins about a centre.

    light: above the surroundings. x: of the columns, y: of the rows, from the centre. r2: squared distances from it, in
    standard deviations. near: exp(-r2 / 2). side: of a bin. pixels: the same part of the picture. Of the fit of the
    surroundings: plane (level, and slopes along x and y for a standard deviation), scatter of the ring's bins about it,
    ring (indices of the bins), terms (1, x, y of each of these), trust (its weight), normal (inverse normal matrix).
    """

    light: Array
    x: Array
    y: Array
    r2: Array
    near: Array
    side: int
    pixels: Pixels
    plane: Array
    scatter: float
    ring: NDArray[np.intp]
    terms: Array
    trust: Array
    normal: Array


@dataclass(slots=True)
class Beam:
    """A beam that was followed.

    centre: x, y. covariance: of the Gaussian of its size, px². window: of the reduced picture. scale: pixels for one
    of the reduced picture. reach: radius of the window in which the place is the centroid: less than
    REACH where the picture's edge is nearer. edge: distance of the nearest one, in standard deviations. settled:
    whether the last round changed nothing. levelled: whether what its rows had more than others was taken off.
    """

    centre: Array
    covariance: Array
    window: Window
    scale: int
    reach: float
    edge: float
    settled: bool
    levelled: bool

    @property
    def axes(self) -> tuple[float, float]:
        """Standard deviations along the shorter and the longer axis."""
        short, long = variances(self.covariance)
        return short**0.5, long**0.5


def variances(covariance: Array) -> tuple[float, float]:
    """Of the shorter and the longer axis. NumPy's eigvalsh() takes ten times as long for a matrix of two."""
    (xx, xy), (_, yy) = covariance.tolist()
    apart = math.hypot((xx - yy) / 2, xy)
    return (xx + yy) / 2 - apart, (xx + yy) / 2 + apart


def reduction(covariance: Array) -> int:
    """Pixels for one of the picture in which a beam of this size is followed: 1 for one that is not wide."""
    factor = int(variances(covariance)[0] ** 0.5 / _WIDE)
    return max(factor - 1 + factor % 2, 1)


def follow(
    image: Pixels,
    centre: Array,
    covariance: Array,
    peak: float,
    whole: tuple[int, ...],
    corner: Array,
    scale: int,
    levelled: bool,
) -> Beam | None:
    """The beam that is at about this place and of about this size; None if what is there has no size.

    image: a part of the picture, which begins at the pixel `corner` and is reduced, `scale` pixels for one. whole: the
    shape of the picture. peak: of the beam, about. levelled: whether the levels of rows were taken off.
    """

    def reduced(place: Array, first: Array) -> Array:
        return (place - first + 0.5) / scale - 0.5

    edges = reduced(np.array([[-0.5, -0.5], [whole[1] - 0.5, whole[0] - 0.5]]), corner)
    centre, covariance = reduced(centre, corner), covariance / scale**2
    window = _window_at(image, centre, covariance, peak, None)
    for number in range(_ROUNDS):
        found = _gaussian_weighted(window)
        reach = _reach(edges, centre, covariance)
        step = _centroid(window, reach) if found is not None and reach > 0.5 else None
        if found is None or step is None:
            return None
        deviation = float(np.trace(found)) ** 0.5
        settled = float(np.abs(step).max()) < _DONE * deviation
        settled &= float(np.abs(found - covariance).max()) < _DONE_SIZE * deviation**2
        centre, covariance = _next(centre, covariance, step, found, number)
        if not (0 < centre[0] < image.shape[1] and 0 < centre[1] < image.shape[0]) or deviation > max(image.shape):
            return None
        window = _window_at(image, centre, covariance, _peak(window), window)
        if settled:
            break
    else:
        settled = False
    reach = _reach(edges, centre, covariance)
    place = (centre + 0.5) * scale - 0.5 + corner
    return Beam(
        place,
        covariance * scale**2,
        window,
        scale,
        reach,
        edge_distance(edges, centre, covariance),
        settled,
        levelled,
    )


def _next(centre: Array, covariance: Array, step: Array, found: Array, number: int) -> tuple[Array, Array]:
    """Centre and covariance of the next round. A weight of a wrong size shows half of the difference to the beam's."""
    if number >= _ROUNDS // 2:  # bins that come and go make it swing
        return centre + step / 2, (covariance + found) / 2
    beyond = covariance + _BEYOND * (found - covariance)
    far = variances(beyond)[0] < 0.5 * variances(found)[0]
    return centre + step, found if far else beyond


def without_outliers(part: Pixels) -> NDArray[np.float32]:
    """A part of a picture whose hot and dead pixels have the median of their neighbours.

    The middle of a beam of two or three pixels stands out of its neighbours, too, in parts of its light.
    """
    pixels = part.astype(np.float32)
    quiet = cv2.medianBlur(pixels, 3)
    apart = np.abs(pixels - quiet)
    thin = max(3, int((part.size / _FEW) ** 0.5))
    noise = 1.4826 * median(apart[::thin, ::thin]) + 0.3
    most = np.maximum(quiet - median(quiet[::thin, ::thin]), 0) / 2 + _OUTLIER * noise
    found = apart > most
    pixels[found] = quiet[found]
    return pixels


def _reach(edges: Array, centre: Array, covariance: Array) -> float:
    return min(REACH, edge_distance(edges, centre, covariance) / (1 + _SOFT))


def edge_distance(edges: Array, centre: Array, covariance: Array) -> float:
    """Distance of the nearest edge, in standard deviations of the beam towards it. edges: left, top; right, bottom."""
    return float((np.abs(edges - centre) / np.sqrt(np.diag(covariance))).min())


def soft_window(r2: Array, reach: float) -> Array:
    """Weights: 1 inside of the radius, 0 outside, a straight slope over _SOFT of the radius to each side of it."""
    return np.clip(((1 + _SOFT) * reach - np.sqrt(r2)) / (2 * _SOFT * reach), 0, 1)


def place_in(beam: Beam, reach: float) -> Array:
    """Centroid in a window of another radius about the same centre, px from that centre."""
    found = _centroid(beam.window, reach)
    return np.zeros(2) if found is None else found * beam.scale


def d4_sigma(beam: Beam) -> tuple[float, float, float]:
    """D4-sigma widths along the longer and the shorter axis, px, and the longer one's angle, degrees clockwise from x.

    Plain second moments in the window; that of ISO 11146-1 is wider, for pictures of less noise.
    """
    window = beam.window
    weighted = soft_window(window.r2, beam.reach) * window.light
    values, axes = np.linalg.eigh(_second_moments(weighted, window) * beam.scale**2 / _KEPT)
    short, long = 4 * np.sqrt(np.maximum(values, 0))
    angle = float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])))
    return float(long), float(short), (angle + 90) % 180 - 90


def place_errors(beam: Beam) -> tuple[float, float]:
    """Standard errors of x and y by the noise of one image.

    The place is linear in the bins, so its variance is the sum of theirs, times the squares of what each one moves it
    by, directly and through the surroundings. Noise that whole columns or rows share is seen in the sums of columns
    and rows: it moves the place more than that of single pixels does. Surroundings that are no plane do so through
    their fit, in patches of the beam's size. A window that follows its centroid adds what light is at its edge.
    """
    window = beam.window
    soft = soft_window(window.r2, beam.reach)
    total = float((soft * window.light).sum())
    short = beam.axes[0] / beam.scale
    noise = _noise(window, 1 / 12 / beam.scale**2, short)
    quiet = median(noise.ravel()[window.ring]) / 9  # of means of nine bins, as the surroundings are fitted
    uneven = max(window.scatter**2 - 2 * quiet, 0.0) * max((short / window.side) ** 2, 1.0)
    growth = 1 / (1 - beam.reach**2 / 2 * float(np.exp(-(beam.reach**2) / 2)))
    errors = []
    deviations = np.sqrt(np.diag(beam.covariance)) / beam.scale
    x, y = window.x, window.y[:, None]
    for along, axis in ((x, 1), (y, 0)):
        lever = soft * along / total
        by_level = np.array([lever.sum(), (lever * x).sum() / deviations[0], (lever * y).sum() / deviations[1]])
        by_ring = by_level @ window.normal @ window.terms * window.trust
        moves = lever.ravel()
        moves[window.ring] -= by_ring
        variance = float(moves * moves @ noise.ravel())
        if axis or not beam.levelled:
            variance *= _shared(window, noise, axis, float(deviations[1 - axis]))
        variance += uneven * float((by_ring * by_ring).sum())
        errors.append(growth * beam.scale * variance**0.5)
    return errors[0], errors[1]


def _noise(window: Window, rounding: float, short: float) -> Array:
    """Variance of each bin, from differences along rows: a constant part, and one that grows with the light.

    Differences of pixels, and of means of 4, 16 and 64: in a compressed image (JPEG) the means are less quiet than
    pixels tell. rounding: variance of a pixel by rounding. short: standard deviation of the beam's shorter axis, px.
    """
    light = np.maximum(cv2.blur(window.light, (3, 3)), 0)
    peak = float(light.max())
    base, bright, finest = rounding, 0.0, rounding
    for side in (1, 2, 4, 8):
        dark, light_too = _levels(window, light, side)
        if dark is not None:
            base, finest = max(base, dark * side**2), dark if side == 1 else finest
        if light_too is not None and (side == 1 or side < _OF_SHORT * short):
            bright = max(bright, light_too * side**2)
    growth = max(bright - base, 0.0) / (0.6 * peak) if peak > 0 else 0.0
    hidden = 1.0
    if finest < _FLAT * rounding or base > _SMOOTHED * max(finest, rounding):  # it was compressed
        hidden = _COMPRESSED + _QUIET / max(finest, _FLAT * rounding)
    return hidden * (base + growth * light) / window.side**2


def _levels(window: Window, light: Array, side: int) -> tuple[float | None, float | None]:
    """Variance of means of side x side pixels where there is little light, and where there is much; None: too few."""
    pixels = window.pixels
    thin = max(1, pixels.size // side // _NOISE_PIXELS)
    coarse = means(pixels[: pixels.shape[0] // side * side, : pixels.shape[1] // side * side], side)[::thin]
    if coarse.shape[1] < 2 * _DIFFERENCE.size:
        return None, None
    margin = _DIFFERENCE.size // 2
    along = cv2.filter2D(coarse, cv2.CV_32F, _DIFFERENCE[None, :])[:, margin:-margin]
    apart = np.diff(along, axis=0) ** 2 / (2 * _NORM2)  # without what whole columns share
    near = cv2.resize(light.astype(np.float32), coarse.shape[::-1], interpolation=cv2.INTER_LINEAR)
    most = cv2.dilate(near, np.ones((1, _DIFFERENCE.size)))[1:, margin:-margin]  # of all that a difference is made of
    dark, bright = most < 0.02 * float(light.max()), near[1:, margin:-margin] > 0.3 * float(light.max())
    return _mean_square(apart[dark]), _mean_square(apart[bright])


def _mean_square(squares: Pixels) -> float | None:
    """Mean of squares without those that no noise makes; None for too few."""
    if squares.size < 10:
        return None
    for _ in range(2):
        squares = squares[squares <= 12 * squares.mean()]
    return float(squares.mean())


def _shared(window: Window, noise: Array, axis: int, deviation: float) -> float:
    """How much larger the noise of sums of columns (axis 1: of rows, axis 0) is than that of their pixels alone.

    Rows are compared with the next but one: sensors of two fields have rows of alternating brightness, which moves
    nothing. deviation: of the beam along the axis, px: of a narrow one the differences show the beam.
    """
    across = np.abs(window.y if axis else window.x)
    middle = across < 0.4 * across.max()
    picked = np.repeat(middle, window.side)
    part = window.pixels[picked] if axis else window.pixels[:, picked]
    sums = cv2.reduce(part.astype(np.float32), 0 if axis else 1, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
    per_bin = noise[middle].sum(axis=0) if axis else noise[:, middle].sum(axis=1)
    expected = np.repeat(per_bin, window.side) * window.side**3  # a bin's mean has side² pixels, in `side` columns
    step = 1 if axis else 2
    if deviation < _WIDER_THAN * step:
        return 1.0
    kernel = np.zeros((_DIFFERENCE.size - 1) * step + 1)
    kernel[::step] = _DIFFERENCE
    if sums.size <= kernel.size:
        return 1.0
    seen = np.convolve(sums, kernel, "valid") ** 2
    ratios = seen / np.convolve(expected, kernel**2, "valid")
    ratios = ratios[ratios <= 12 * max(median(ratios), 1.0)]
    return max((float(ratios.sum()) + _SURE) / (ratios.size + _SURE), 0.5)


def smoothed(window: Window) -> Array:
    """The light without the noise of single bins."""
    return np.asarray(cv2.GaussianBlur(window.light, (0, 0), 1.0), np.float64)


def lobes(smooth: Array, inside: NDArray[np.bool_], peak: float, depth: float) -> int:
    """How many maxima rise by this part of them above the pass to a higher one. peak: of the beam."""
    found = 1
    for level in np.arange(0.9, 0.2, -0.05) * peak:
        count, labels = cv2.connectedComponents(((smooth > level) & inside).astype(np.uint8))
        if count > 2:
            tops = [float(smooth[labels == label].max()) for label in range(1, count)]
            found = max(found, sum(level < (1 - depth) * top for top in tops))
    return found


def _centroid(window: Window, reach: float) -> Array | None:
    weighted = soft_window(window.r2, reach) * window.light
    total = float(weighted.sum())
    if total <= 0:
        return None
    return np.array([weighted.sum(axis=0) @ window.x, weighted.sum(axis=1) @ window.y]) / total


def _gaussian_weighted(window: Window) -> Array | None:
    """The covariance of the light under a Gaussian weight, twice: for a Gaussian of the weight's size it is its own."""
    weighted = window.near * window.light
    if float(weighted.sum()) <= 0:
        return None
    found = 2 * _second_moments(weighted, window)
    return found if np.isfinite(found).all() and variances(found)[0] > 0.05 else None


def _second_moments(weighted: Array, window: Window) -> Array:
    x, y = window.x, window.y
    columns, rows = weighted.sum(axis=0), weighted.sum(axis=1)
    moments = np.array([[columns @ (x * x), y @ weighted @ x], [0.0, rows @ (y * y)]])
    moments[1, 0] = moments[0, 1]
    total, first = float(rows.sum()), np.array([columns @ x, rows @ y])
    return moments / total - np.outer(first, first) / total**2


def _peak(window: Window) -> float:
    """The peak of the Gaussian of the window's size that fits the light."""
    like = window.near.ravel()
    return max(float(like @ window.light.ravel()) / float(like @ like), 0.0)


def _window_at(image: Pixels, centre: Array, covariance: Array, peak: float, before: Window | None) -> Window:
    """The bins of the picture about a centre, less the surroundings.

    peak: of the beam, whose light reaches these. before: the window of the round before, to go on from.
    """
    wide, high = np.sqrt(np.diag(covariance))
    side = max(1, int(variances(covariance)[0] ** 0.5 / _BINS))
    side -= 1 - side % 2
    (rows, columns), (x0, y0) = image.shape, centre
    half_x, half_y = max(_BOX * wide, _LEAST_BOX), max(_BOX * high, _LEAST_BOX)
    left, right = max(0, int(x0 - half_x) - 2), min(columns, int(x0 + half_x) + 3)
    top, bottom = max(0, int(y0 - half_y) - 2), min(rows, int(y0 + half_y) + 3)
    (left, right), (top, bottom) = _whole(left, right, side, columns), _whole(top, bottom, side, rows)
    part = image[top:bottom, left:right]
    values = means(part, side).astype(np.float64)
    x = left + (np.arange(values.shape[1]) + 0.5) * side - 0.5 - x0
    y = top + (np.arange(values.shape[0]) + 0.5) * side - 0.5 - y0
    (xx, xy), (_, yy) = covariance.tolist()
    square = xx * yy - xy * xy
    r2 = yy / square * x * x + (xx / square * y * y)[:, None] + np.multiply.outer(-2 * xy / square * y, x)
    near = np.exp(r2 / -2)
    ring = _ring(r2, left // side, top // side, 37 * wide * high / side**2)
    terms = np.stack([np.ones(ring.size), (x / wide)[ring % x.size], (y / high)[ring // x.size]])
    around = cv2.blur(values - peak * near, (3, 3)).ravel()[ring]
    plane, scatter, trust, normal = _surroundings(around, terms, before)
    light = values - (plane[0] + plane[1] / wide * x + (plane[2] / high * y)[:, None])
    return Window(light, x, y, r2, near, side, part, plane, scatter, ring, terms, trust, normal)


def _whole(begin: int, end: int, side: int, most: int) -> tuple[int, int]:
    """A range of whole bins, at multiples of a bin's side so that windows which move a little have the same bins."""
    return begin // side * side, min(-(-end // side), most // side) * side


def _ring(r2: Array, left: int, top: int, many: float) -> NDArray[np.intp]:
    """Indices of the bins around the beam: about _RING_BINS, always the same ones of the picture. many: all of them.

    left, top: of the first bin, in bins of the picture.
    """
    inside = (r2 > _RING**2) & (r2 < _BOX**2)
    thin = max(1, int(many / _RING_BINS))
    if thin > 1:
        inside &= ((left + np.arange(r2.shape[1])) + 5 * (top + np.arange(r2.shape[0]))[:, None]) % thin == 0
    ring = np.flatnonzero(inside)
    return ring if ring.size >= 24 else np.argpartition(r2.ravel(), -24)[-24:]  # a beam that fills the picture: corners


def _surroundings(values: Array, terms: Array, before: Window | None) -> tuple[Array, float, Array, Array]:
    """A plane through the ring's bins, without what stands out of it; their scatter, weights and normal matrix."""
    prior = np.diag([0, 1, 1]) * (_LEVEL * values.size)
    weight = np.ones_like(values) if before is None else _like(values - before.plane @ terms, before.scatter)
    normal, plane, scatter = prior, np.zeros(3), 0.0
    for _ in range(4 if before is None else 1):
        weighted = terms * weight
        normal = np.linalg.inv(weighted @ terms.T + prior)
        plane = normal @ (weighted @ values)
        rest = values - plane @ terms
        scatter = max(1.4826 * median(np.abs(rest)), 0.1)
        weight = _like(rest, scatter)
    return np.asarray(plane, np.float64), scatter, weight, np.asarray(normal, np.float64)


def _like(rest: Array, scatter: float) -> Array:
    """Weights of bins that are so far from the plane: 1 on it, 1/2 at _LIKE standard deviations."""
    parts = rest * (1 / (_LIKE * scatter))
    parts *= parts
    parts *= parts
    return 1 / (1 + parts)
