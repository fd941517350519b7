"""How far speckle may have shifted a spot: its contrast, from what the fit leaves over at neighbouring bins.

Speckle multiplies the light, and its grains are larger than a pixel. So it adds up over a grain, where noise of pixels
averages out, and shifts a spot by about 1.4 x contrast x grain, whatever the spot's size. Groups of bins as large as
the spot do not show it for a spot of few grains: the fit has taken their share.
"""

import numpy as np

from mirrormount.beam.gaussian import Array, Bins, Fit, X, Y, evaluate

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
