"""Least-squares fits of one elliptical Gaussian, or two of one shape, on a plane of background.

The data are bins: means of b x b pixels. A bin is a Gaussian that is a little wider, by b²/12 in the variance, which
does not shift the centre. Positions are relative to the fit's window, in pixels.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

X, Y = 1, 2  # places of the centre among the parameters
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


def errors(found: Fit, bins: Bins, groups: NDArray[np.intp]) -> tuple[Array, Array]:
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
