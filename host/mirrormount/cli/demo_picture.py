"""The picture of `mirrormount demo`: the paper's square, its gap, and the same corner with the backlash taken up."""

import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mirrormount.common import whole_file
from mirrormount.virtual.optics import View

VIEW = View(-100, 100, -100, 100, pixel=0.4)  # mm: the square fits whichever way a swapped wire turns it
WIDE = View(-130, 130, -130, 130, VIEW.pixel)  # the same at up to 130 % of the motors' supply


def draw(title: str, first, second, gaps: Sequence[tuple[str, str]], output: Path) -> None:
    """Like the paper's Fig. 5: the pictures of the corners laid over each other, centroids in red.

    first and second are what square() returns; gaps tells of both what is left open across and up. Raises CannotWrite.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (ax, zoom, after) = plt.subplots(
        1, 3, figsize=(15, 5.4), layout="constrained", gridspec_kw={"width_ratios": (1.25, 1, 1)}
    )
    corners, trail, pictures = first
    _draw_square(ax, corners, trail, pictures)
    ax.set_title(title)
    _draw_gap(zoom, corners, pictures, *gaps[0])
    zoom.set_title("the gap that backlash leaves")
    _draw_gap(after, second[0], second[2], *gaps[1])
    after.set_title("the same corner with the backlash taken up")
    for a in (ax, zoom, after):
        a.set_xlabel("right on the screen (mm)")
        a.set_ylabel("up on the screen (mm)")
    picture = io.BytesIO()
    figure.savefig(picture, dpi=120, format=output.suffix.lower().removeprefix("."))
    plt.close(figure)
    whole_file.write(whole_file.behind(output), picture.getvalue())


def _show(ax, pictures) -> None:
    overlay = np.max(np.stack(pictures), axis=0)
    extent = next((v.left, v.right, v.bottom, v.top) for v in (VIEW, WIDE) if v.shape == overlay.shape)
    ax.imshow(overlay, cmap="gray", extent=extent, vmin=0, vmax=255)


def _draw_square(ax, corners, trail, pictures) -> None:
    """The whole way, its corners numbered."""
    _show(ax, pictures)
    x, y = np.array(trail).T
    ax.plot(x, y, color="tab:orange", lw=0.8, alpha=0.8)
    places = {0: (14, 12), 1: (-12, 12), 2: (-12, -14), 3: (12, -14), 4: (14, -12)}
    for number, corner in enumerate(corners):
        ax.plot(*corner, "+", color="red", ms=12, mew=1.6)
        label = {"textcoords": "offset points", "color": "white", "ha": "center", "va": "center"}
        ax.annotate(f"{number + 1}", corner, places[number], **label)
    x, y = np.array(corners).T
    ax.set_xlim(x.min() - 12, x.max() + 12)
    ax.set_ylim(y.min() - 12, y.max() + 12)


def _draw_gap(ax, corners, pictures, across: str, up: str) -> None:
    """The place where the way begins and ends, and how far apart the two are."""
    _show(ax, pictures)
    (x1, y1), (x5, y5) = corners[0], corners[4]
    for corner in corners:
        ax.plot(*corner, "+", color="red", ms=12, mew=1.6)
    side = 12
    ax.set_xlim((x1 + x5) / 2 - side, (x1 + x5) / 2 + side)
    ax.set_ylim((y1 + y5) / 2 - side, (y1 + y5) / 2 + side)
    style = {"color": "cyan", "textcoords": "offset points", "fontsize": 10}
    style["bbox"] = {"boxstyle": "round,pad=0.2", "fc": "black", "ec": "none", "alpha": 0.6}
    if math.dist((x1, y1), (x5, y5)) < 1:  # too near for arrows between them
        ax.annotate(f"{across} across, {up} up", (x1, y1), (0, -72), ha="center", **style)
        ax.annotate("1: start, 5: end", (x1, y1), (0, 62), textcoords="offset points", color="white", ha="center")
        return
    arrow = {"arrowstyle": "<->", "color": "cyan", "lw": 1.4}
    ax.annotate("", (x1, y5), (x5, y5), arrowprops=arrow)
    ax.annotate("", (x1, y5), (x1, y1), arrowprops=arrow)
    ax.annotate(across, ((x1 + x5) / 2, y5), (0, -16), ha="center", **style)
    ax.annotate(up, (x1, (y1 + y5) / 2), (-6, 0), ha="right", va="center", **style)
    ax.annotate("1: start", (x1, y1), (0, 62), textcoords="offset points", color="white", ha="center")
    ax.annotate("5: end", (x5, y5), (0, -72), textcoords="offset points", color="white", ha="center")
