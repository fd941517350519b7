"""A plain centroid, independent of the product's way to find a spot."""

import numpy as np


def centroid(image: np.ndarray, above: float = 60.0) -> tuple[float, float]:
    """First moments (column, row) of what stands `above` the picture's median, by parabolas near the brightest pixel.

    For a picture with one bright Gaussian spot that is whole and not saturated.
    """
    light = image.astype(float) - np.median(image)
    assert light.max() > above, "no spot"
    # the middle of all that is above half: robust against hot pixels, then moments around it
    rows, columns = np.nonzero(light > light.max() / 2)
    y, x = np.median(rows), np.median(columns)
    for _ in range(3):
        top, left = max(0, round(y) - 40), max(0, round(x) - 40)
        part = np.clip(light[top : round(y) + 41, left : round(x) + 41], 0, None)
        part[part < 20] = 0
        total = part.sum()
        y = top + float((part.sum(axis=1) * np.arange(part.shape[0])).sum() / total)
        x = left + float((part.sum(axis=0) * np.arange(part.shape[1])).sum() / total)
    return x, y
