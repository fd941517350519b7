"""Least-squares fits of one elliptical Gaussian, or two of one shape, on a plane of background; and speckle.

The fit has the part of the picture around a blob. Its data are bins: means of b x b valid pixels. A bin is a Gaussian
that is a little wider, by b²/12 in the variance, which does not shift the centre. Positions are relative to the fit's
window, in pixels.

Speckle multiplies the light, and its grains are larger than a pixel. So it adds up over a grain, where noise of pixels
averages out, and shifts a spot by about 1.4 x contrast x grain, whatever the spot's size. Its contrast comes from what
the fit leaves over at neighbouring bins. Groups of bins as large as the spot do not show it for a spot of few grains:
the fit has taken their share.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount_beam.spot.blobs import Detection

Array = NDArray[np.float64]

X, Y = 1, 2  # places of the centre among the parameters


# ---- the fit

_SHAPE = slice(3, 6)
_ROUNDS = 25
_DONE = 1e-4  # relative decrease of chi² below which a fit ends
_DETERMINED = 1e-12  # least eigenvalue of the information matrix, scaled to ones on its diagonal: rounding is 1e-15


@dataclass(slots=True)
class Bins:
    """Valid bins: positions, mean grey values, and weights (1 / variance of the mean)."""

    x: Array
    y: Array
    value: Array
    weight: Array


@dataclass(slots=True)
class Fit:
    """Parameters: peak, x, y; inverse covariance a, b, c; plane: offset, along x, along y; of a ghost: peak, x, y.

    chi2: sum of weighted squares. residual: data less model. jacobian: (bins, parameters).
    """

    p: Array
    chi2: float
    residual: Array = field(repr=False)
    jacobian: Array = field(repr=False)

    @property
    def peak(self) -> float:
        return float(self.p[0])

    @property
    def centre(self) -> tuple[float, float]:
        return float(self.p[X]), float(self.p[Y])

    @property
    def shape(self) -> Array:
        """Inverse covariance as a matrix, 1/px²."""
        a, b, c = self.p[_SHAPE]
        return np.array([[a, b], [b, c]])

    def is_ellipse(self) -> bool:
        """Peak above 0 and a shape that ends on all sides."""
        a, b, c = self.p[_SHAPE]
        return bool(np.isfinite(self.p).all() and self.p[0] > 0 and a > 0 and a * c - b * b > 0)

    def covariance(self) -> Array:
        """Covariance of the spot in px²: ((xx, xy), (xy, yy))."""
        return np.asarray(np.linalg.inv(self.shape), np.float64)


def evaluate(p: Array, x: Array, y: Array, *, plane: bool = True) -> Array:
    """Grey values of the model at positions."""
    value = _spot(p[0], p[1], p[2], p[_SHAPE], x, y)
    if len(p) > 9:
        value = value + _spot(p[9], p[10], p[11], p[_SHAPE], x, y)
    return value + (p[6] + p[7] * x + p[8] * y) if plane else value


def _spot(peak: float, x0: float, y0: float, shape: Array, x: Array, y: Array) -> Array:
    dx, dy = x - x0, y - y0
    a, b, c = shape
    return peak * np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))


def _model(p: Array, bins: Bins) -> tuple[Array, Array]:
    """Values (n) and Jacobian (n, parameters)."""
    a, b, c = p[_SHAPE]
    jacobian = np.empty((len(p), bins.x.size))
    value = p[6] + p[7] * bins.x + p[8] * bins.y
    jacobian[6] = 1
    jacobian[7] = bins.x
    jacobian[8] = bins.y
    jacobian[_SHAPE] = 0
    for at in (0, 9)[: 1 + (len(p) > 9)]:
        dx, dy = bins.x - p[at + 1], bins.y - p[at + 2]
        gx, gy = a * dx + b * dy, b * dx + c * dy
        unit = np.exp(-0.5 * (gx * dx + gy * dy))
        spot = p[at] * unit
        value += spot
        jacobian[at] = unit
        jacobian[at + 1] = spot * gx
        jacobian[at + 2] = spot * gy
        jacobian[3] -= 0.5 * spot * dx * dx
        jacobian[4] -= spot * dx * dy
        jacobian[5] -= 0.5 * spot * dy * dy
    return value, jacobian.T


def jacobian(p: Array, bins: Bins) -> Array:
    """Derivatives of the model at the bins, (bins, parameters)."""
    return _model(p, bins)[1]


def _at(p: Array, bins: Bins) -> Fit:
    value, jacobian = _model(p, bins)
    residual = bins.value - value
    return Fit(p, float(bins.weight @ (residual * residual)), residual, jacobian)


def fit(p: Array, bins: Bins) -> Fit | None:
    """The best fit from a start, by Levenberg and Marquardt; None if it leaves the form of a spot.

    None, too, if the data do not determine all parameters: those of two spots that have come to lie on each other.

    Source: K. Levenberg, Quart. Appl. Math. 2 (1944) 164; D. Marquardt, J. SIAM 11 (1963) 431.
    """
    found = _descend(p, bins)
    return found if found and found.is_ellipse() and _determines(bins, found) else None


def _determines(bins: Bins, found: Fit) -> bool:
    """Whether the bins determine all parameters, so that a covariance exists."""
    normal = found.jacobian.T @ (found.jacobian * bins.weight[:, None])
    scale = np.sqrt(np.diag(normal))
    return bool(scale.all()) and float(np.linalg.eigvalsh(normal / np.outer(scale, scale))[0]) > _DETERMINED


def _descend(p: Array, bins: Bins) -> Fit | None:
    best, damping = _at(p, bins), 1e-3
    for _ in range(_ROUNDS):
        weighted = best.jacobian * bins.weight[:, None]
        normal, gradient = weighted.T @ best.jacobian, weighted.T @ best.residual
        while True:
            try:
                step = np.linalg.solve(normal + np.diag(damping * np.diag(normal)), gradient)
            except np.linalg.LinAlgError:
                return None
            with np.errstate(over="ignore", invalid="ignore"):
                trial = _at(best.p + step, bins)
            if trial.is_ellipse() and trial.chi2 <= best.chi2:
                break
            damping *= 8
            if damping > 1e6:
                return best
        done = best.chi2 - trial.chi2 < _DONE * max(best.chi2, 1e-9)
        best, damping = trial, damping / 10
        if done:
            return best
    return best


def fit_errors(found: Fit, bins: Bins, groups: NDArray[np.intp]) -> tuple[Array, Array]:
    """Covariance of x and y, as the noise predicts and as the residuals of groups of bins show it.

    The latter holds for noise that is correlated within a group (compression, demosaicing, speckle), too.
    Source: H. White, Econometrica 48 (1980) 817, clustered, with the correction of small samples.
    """
    weighted = found.jacobian * bins.weight[:, None]
    inverse = np.linalg.inv(weighted.T @ found.jacobian)
    scores = np.zeros((int(groups.max()) + 1, len(found.p)))
    np.add.at(scores, groups, weighted * found.residual[:, None])
    used = len(np.unique(groups))
    n = bins.x.size
    correction = used / max(used - 1, 1) * n / max(n - len(found.p), 1)
    clustered = inverse @ (scores.T @ scores) @ inverse * correction
    pick = np.ix_((X, Y), (X, Y))
    return np.asarray(inverse[pick], np.float64), np.asarray(clustered[pick], np.float64)


def core_shift(found: Fit, bins: Bins) -> tuple[Array, Array]:
    """(shift of x and y if only the core counts, standard deviation of that shift by noise alone), px.

    The shift of an undisturbed spot is noise; a ghost, an edge or a fly shifts core and flanks differently.
    """
    dx, dy = bins.x - found.p[X], bins.y - found.p[Y]
    a, b, c = found.p[_SHAPE]
    core = np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
    columns = [place for place in range(len(found.p)) if place not in (7, 8)]  # a core alone does not show a slope
    part = found.jacobian[:, columns]
    inner = part * (core * bins.weight)[:, None]
    whole = found.jacobian * bins.weight[:, None]
    to_inner = np.linalg.solve(inner.T @ part, inner.T)[X : Y + 1]
    to_whole = np.linalg.solve(whole.T @ found.jacobian, whole.T)[X : Y + 1]
    difference = to_inner - to_whole
    return to_inner @ found.residual, np.sqrt((difference**2 / bins.weight).sum(axis=1))


def background_shift(found: Fit, bins: Bins) -> tuple[Array, Array]:
    """(shift of x and y with a background of third order instead of a plane, its standard deviation by noise), px."""
    width = 1 / np.sqrt(np.diag(found.shape))
    dx, dy = (bins.x - found.p[X]) / width[0], (bins.y - found.p[Y]) / width[1]
    curved = np.column_stack([found.jacobian, dx * dx, dx * dy, dy * dy, dx**3, dy**3])
    whole = found.jacobian * bins.weight[:, None]
    to_curved = np.linalg.solve((curved * bins.weight[:, None]).T @ curved, (curved * bins.weight[:, None]).T)[
        X : Y + 1
    ]
    to_whole = np.linalg.solve(whole.T @ found.jacobian, whole.T)[X : Y + 1]
    return to_curved @ found.residual, np.sqrt(((to_curved - to_whole) ** 2 / bins.weight).sum(axis=1))


@dataclass(frozen=True, slots=True)
class Modes:
    """What of the residual has the shape of a Gauss-Hermite mode, as a fit together with the model's parameters.

    odd, even: root of the sum of squares of the amplitudes of third and of fourth order, in parts of the peak.
    odd_chi2, even_chi2: their significances squared; by noise alone about 4 and about 5.
    """

    odd: float
    odd_chi2: float
    even: float
    even_chi2: float


def modes(found: Fit, bins: Bins) -> Modes:
    """Modes of third order (one side is missing) and of fourth order (two spots, or a flat top).

    They have few parameters, so they show what the sum of squares over hundreds of bins hides in its noise.
    """
    dx, dy = bins.x - found.p[X], bins.y - found.p[Y]
    upper = np.linalg.cholesky(found.shape).T  # shape = upper' upper, so u, v have unit variance
    u, v = upper[0, 0] * dx + upper[0, 1] * dy, upper[1, 1] * dy
    light = found.p[0] * np.exp(-0.5 * (u * u + v * v))
    u2, v2 = u * u - 1, v * v - 1
    u3, v3 = u * (u * u - 3), v * (v * v - 3)
    u4, v4 = (u * u - 6) * u * u + 3, (v * v - 6) * v * v + 3
    terms = np.stack([u3, u2 * v, u * v2, v3, u4, u3 * v, u2 * v2, u * v3, v4]) * light
    design = np.concatenate([found.jacobian.T, terms])
    weighted = design * bins.weight
    inverse = np.linalg.pinv(weighted @ design.T, hermitian=True)
    amplitude = inverse @ (weighted @ found.residual)
    sizes = []
    for part in (slice(-9, -5), slice(-5, None)):
        some = amplitude[part]
        sizes += [float(np.linalg.norm(some)), float(some @ np.linalg.pinv(inverse[part, part], hermitian=True) @ some)]
    return Modes(*sizes)


# ---- its window

_BINS_OF_A_WIDTH = 2.5  # bins in one standard deviation of the spot: finer bins add time and no precision
_OUTLIER = 7.0  # standard deviations by which a pixel differs from the median of its neighbours


@dataclass(slots=True)
class Window:
    """left, top: of its first pixel in the picture. pixels: float64. valid: False where saturated, hot or disturbed."""

    left: int
    top: int
    pixels: Array
    valid: NDArray[np.bool_]
    bin: int
    slope: tuple[float, float]  # grey values a pixel along x and y that were subtracted as background
    base: float = 1 / 12  # variance of a pixel without light; at least that of rounding
    gain: float = 0.0  # increase of the variance with a grey value of light

    @property
    def grid(self) -> tuple[Array, Array]:
        """x and y of each pixel, relative to the window."""
        rows, columns = self.pixels.shape
        return np.arange(columns, dtype=float)[None, :], np.arange(rows, dtype=float)[:, None]

    def variance(self, light: Array) -> Array:
        """Variance of a pixel with so much light of the spot."""
        return self.base + self.gain * np.maximum(light, 0)

    def bins(self, p: Array | None, masked: NDArray[np.bool_] | None = None) -> tuple[Bins, NDArray[np.bool_]]:
        """The bins whose pixels are all valid, weighted by the light of the model p; and which these are."""
        b = self.bin
        rows, columns = self.pixels.shape[0] // b, self.pixels.shape[1] // b
        shape = (rows, b, columns, b)
        value = self.pixels.reshape(shape).mean(axis=(1, 3))
        keep = np.asarray(self.valid.reshape(shape).all(axis=(1, 3)), np.bool_)
        if masked is not None:
            keep = keep & ~masked
        y, x = (np.mgrid[:rows, :columns] * b + (b - 1) / 2.0)[:, keep]
        light = evaluate(p, x, y, plane=False) if p is not None else np.zeros(x.shape)
        return Bins(x, y, value[keep], b * b / self.variance(light)), keep

    def left_over(self, found: Fit, bins: Bins, keep: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Significance of a further spot of the same size at each bin of the grid; negative where light is missing."""
        width = max(float(np.linalg.det(found.covariance())) ** 0.25 / self.bin, 0.6)
        weighted, weight = np.zeros(keep.shape, np.float32), np.zeros(keep.shape, np.float32)
        weighted[keep] = bins.weight * found.residual
        weight[keep] = bins.weight
        light = cv2.GaussianBlur(weighted, (0, 0), width, borderType=cv2.BORDER_CONSTANT)
        # a kernel that is squared is narrower by the root of two, and its integral is 1 / (4 pi width²)
        noise = cv2.GaussianBlur(weight, (0, 0), width / 2**0.5, borderType=cv2.BORDER_CONSTANT)
        return light / np.sqrt(np.maximum(noise, 1e-12) / (4 * np.pi * width**2))

    def place(self, row: int, column: int) -> tuple[float, float]:
        """x and y of a bin's centre."""
        return column * self.bin + (self.bin - 1) / 2, row * self.bin + (self.bin - 1) / 2

    def groups(self, keep: NDArray[np.bool_], width: float) -> NDArray[np.intp]:
        """For each kept bin, the number of its square of about `width` pixels."""
        side = max(round(width / self.bin), 1)
        rows, columns = np.nonzero(keep)
        return (rows // side) * (keep.shape[1] // side + 1) + columns // side

    def measure_noise(self, p: Array) -> None:
        """Noise of a pixel from differences of near pixels, which a smooth misfit of the model p leaves small."""
        x, y = self.grid
        light = evaluate(p, x, y, plane=False)
        rest = self.pixels - light
        dark = light < 0.1 * p[0]
        bright = (light > 0.4 * p[0]) & (light < 1.5 * p[0])
        base = max(_variance(rest, dark & self.valid), 1 / 12)
        core = bright & self.valid
        gain = (_variance(rest, core) - base) / float(light[core].mean()) if core.sum() > 20 else 0.0
        self.base, self.gain = base, max(gain, 0.0)

    def drop_outliers(self, p: Array) -> int:
        """Mark single pixels that differ from their neighbours as not valid; how many."""
        x, y = self.grid
        light = evaluate(p, x, y, plane=False)
        rest = (self.pixels - light).astype(np.float32)
        apart = np.abs(rest - cv2.medianBlur(rest, 3)) > _OUTLIER * np.sqrt(self.variance(light))
        found = apart & self.valid
        self.valid = self.valid & ~found
        return int(found.sum())


def _variance(rest: Array, where: NDArray[np.bool_]) -> float:
    """Robust variance of a pixel from differences along rows; correlation between neighbours lowers the nearest."""
    largest = 0.0
    for lag in (1, 3):
        both = where[:, lag:] & where[:, :-lag]
        squares = (rest[:, lag:] - rest[:, :-lag])[both] ** 2 / 2
        if squares.size < 10:
            continue
        for _ in range(2):
            squares = squares[squares <= 12 * squares.mean()]  # without what no noise is
        largest = max(largest, float(squares.mean()))
    return largest


def cut_window(
    image: NDArray[np.uint8] | NDArray[np.uint16],
    valid: NDArray[np.bool_],
    centre: tuple[float, float],
    widths: tuple[float, float],
    reach: float,
    detection: Detection,
) -> Window:
    """The window of `reach` widths around a centre, cut to the picture and to whole bins, less the background."""
    size = max(1, int(min(widths) / _BINS_OF_A_WIDTH))
    (x, y), (wide, high) = centre, widths
    left, right = max(0, int(x - reach * wide - 2)), min(image.shape[1], int(x + reach * wide + 3))
    top, bottom = max(0, int(y - reach * high - 2)), min(image.shape[0], int(y + reach * high + 3))
    right -= (right - left) % size
    bottom -= (bottom - top) % size
    part = (slice(top, bottom), slice(left, right))
    background = detection.background_in(left, top, right - left, bottom - top).astype(np.float64)
    middle = background[background.shape[0] // 4 : -(background.shape[0] // 4) or None]
    down = float(middle[-1].mean() - middle[0].mean()) / max(middle.shape[0] - 1, 1)
    along = float(background[:, -1].mean() - background[:, 0].mean()) / max(background.shape[1] - 1, 1)
    return Window(left, top, image[part] - background, valid[part].copy(), size, (along, down))


# ---- speckle

_GRAIN = 1.4  # standard deviation of a grain, px: a camera's lens makes grains of few pixels
_LARGEST = 3  # side of a bin, px: over a larger one grains average out, and look like the noise that is measured
_CORE = 0.13  # light of the bins that count, in parts of the peak: two widths
_SEEN = 2.0  # contrast squared that is believed, in its standard deviations
_MOST = 0.1  # contrast at most that noise may hide: more would be refused for its misfit


def variances(found: Fit, bins: Bins, side: int) -> tuple[Array, Array]:
    """Variance of x and y by speckle, px²: as far as it is seen, and the most that noise may hide. side: of a bin, px.

    The contrast squared is the quadratic estimate without bias from the products of residuals of different bins, so
    neither the noise of single bins nor what the fit has taken shifts it. The covariance of two bins is that of white
    noise under a Gaussian filter, exp(-(r / 2 grain)²), times their light.
    Source: C. R. Rao, J. Multivariate Anal. 1 (1971) 257 (MINQUE).
    """
    none = np.zeros(2)
    light = evaluate(found.p, bins.x, bins.y, plane=False)
    core = light > _CORE * found.peak
    if side > _LARGEST or not core.any():
        return none, none
    light, weight, x, y = light[core], bins.weight[core], bins.x[core], bins.y[core]
    wider = _GRAIN**2 + side**2 / 12  # a bin's mean widens a grain
    distance = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
    alike = _GRAIN**2 / wider * np.exp(-distance / (4 * wider)) * np.outer(light, light)
    weighted = found.jacobian[core] * weight[:, None]
    inverse = np.linalg.inv((found.jacobian * bins.weight[:, None]).T @ found.jacobian)
    left = np.diag(weight) - weighted @ inverse @ weighted.T  # covariance of the weighted residuals by noise alone
    neighbours = alike - np.diag(np.diag(alike))
    by_noise = neighbours @ left
    response = float(np.sum(by_noise * (alike @ left).T))
    if response <= 0:
        return none, none
    residual = weight * found.residual[core]
    contrast = float(residual @ neighbours @ residual - np.trace(by_noise)) / response  # squared
    deviation = float(2 * np.sum(by_noise * by_noise.T)) ** 0.5 / response
    to_place = (weighted @ inverse)[:, X : Y + 1]
    shift = np.sum(to_place * (alike @ to_place), axis=0)  # variance of x and y for a contrast of 1
    seen = contrast if contrast > _SEEN * deviation else 0.0
    hidden = max(min(max(contrast, 0.0) + _SEEN * deviation, _MOST**2), seen)
    return seen * shift, hidden * shift
