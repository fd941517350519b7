"""Pictures of a laser spot as a webcam takes them, made to be nasty, with the true place of the spot.

real() has the beams and sensors of mirrormount_sim.beams; the other scenes have Gaussians.

Independent of the product. Light is integrated over each pixel by Gauss and Legendre's rule of 3 x 3 points, the error
of which is below 1e-6 of the peak for the widths used here. Coordinates: pixels from the centre of the top left one.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from mirrormount_sim import beams

ROWS, COLUMNS = 480, 640
_APART = 3.2  # widths between two spots that a person sees as two: of nearer ones the light has one top
_NODES = np.array([-0.7745966692414834, 0.0, 0.7745966692414834]) / 2
_WEIGHTS = np.array([5, 8, 5]) / 18


@dataclass
class Scene:
    """image: uint8. truth: x, y of the one spot; None if there is none, or no one. parts: what is in the picture."""

    image: np.ndarray
    truth: tuple[float, float] | None
    parts: list[str] = field(default_factory=list)
    dark: np.ndarray | None = None


def gaussian(x, y, wide, high, angle=0.0, power=1.0):
    """Light of an elliptical spot with peak 1, integrated over each pixel; power > 1 has a flat top."""
    light = np.zeros((ROWS, COLUMNS))
    reach = int(6 * max(wide, high)) + 2
    left, right = max(0, int(x) - reach), min(COLUMNS, int(x) + reach)
    top, bottom = max(0, int(y) - reach), min(ROWS, int(y) + reach)
    if left >= right or top >= bottom:
        return light
    cos, sin = np.cos(angle), np.sin(angle)
    for along, weight_x in zip(_NODES, _WEIGHTS, strict=True):
        for down, weight_y in zip(_NODES, _WEIGHTS, strict=True):
            dx = np.arange(left, right)[None, :] + along - x
            dy = np.arange(top, bottom)[:, None] + down - y
            square = ((cos * dx + sin * dy) / wide) ** 2 + ((cos * dy - sin * dx) / high) ** 2
            light[top:bottom, left:right] += weight_x * weight_y * np.exp(-0.5 * square**power)
    return light


def expose(light, rng, *, read=1.0, gain=0.1):
    """Light in grey values as 8 bits, with read noise and the shot noise of `gain` grey values an electron."""
    noisy = light + rng.normal(size=light.shape) * np.sqrt(read**2 + gain * np.maximum(light, 0))
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def clean(rng, *, width=12.0, peak=180.0):
    """A round spot in the dark, a little noise, nothing else."""
    x, y = rng.uniform(5 * width, COLUMNS - 5 * width), rng.uniform(5 * width, ROWS - 5 * width)
    return Scene(expose(8 + peak * gaussian(x, y, width, width), rng), (x, y), ["clean"])


def marred(rng, *, width=12.0, peak=268.0):
    """A round spot of which about 3 % is saturated, with a ghost of 10 % somewhere near and 60 hot pixels."""
    x, y = rng.uniform(10 * width, COLUMNS - 10 * width), rng.uniform(10 * width, ROWS - 10 * width)
    far, to = rng.uniform(2, 8) * width, rng.uniform(0, 2 * np.pi)
    ghost = gaussian(x + far * np.cos(to), y + far * np.sin(to), width, width)
    light = peak * (gaussian(x, y, width, width) + 0.1 * ghost)
    image = expose(8 + light, rng)
    image[rng.integers(0, ROWS, 60), rng.integers(0, COLUMNS, 60)] = 255
    return Scene(image, beams.declared_place(light), ["ghost", "hot", "saturated"])


def nasty(rng):
    """A random scene: each part comes or not, by chance."""
    parts: list[str] = []

    def comes(name, chance):
        if rng.random() < chance:
            parts.append(name)
        return name in parts and parts[-1] == name

    light = np.full((ROWS, COLUMNS), rng.uniform(2, 25))
    read, gain = rng.uniform(0.4, 3.0), rng.uniform(0.03, 0.3)
    if comes("gradient", 0.4):
        light += _gradient(rng)
    if comes("lamp", 0.2):
        light += rng.uniform(5, 50) * gaussian(rng.uniform(0, COLUMNS), rng.uniform(0, ROWS), *rng.uniform(90, 250, 2))
    if comes("flicker", 0.2):
        rows = np.arange(ROWS)[:, None]
        light += rng.uniform(1, 8) * np.sin(2 * np.pi * (rows / rng.uniform(120, 400) + rng.random()))
    middle, ambient = None, light.copy()
    if not comes("none", 0.1):
        middle = _add_spot(light, rng, comes, parts)
    if comes("fly", 0.15):
        _fly(light, rng, middle)
    light, ambient = np.maximum(light, 0), np.maximum(ambient, 0)
    if comes("gamma", 0.1):
        gamma = rng.uniform(0.5, 0.9)
        light, ambient = (255 * (part / 255) ** gamma for part in (light, ambient))
    truth = middle if middle is None or "edge" in parts else _declared(light - ambient)
    image = expose(light, rng, read=read, gain=gain)
    dark = None
    if comes("hot", 0.35):
        image, dark = _hot(image, rng, read)
    if comes("jpeg", 0.15):
        image = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(75, 97))])[1], 0)
    return Scene(image, truth, parts, dark)


def _declared(light):
    """The declared place of what is left of a spot; None if a fly has left nothing that has a place."""
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        try:
            return beams.declared_place(light)
        except (FloatingPointError, ValueError, np.linalg.LinAlgError):
            return None


def _add_spot(light, rng, comes, parts):
    width = float(np.exp(rng.uniform(np.log(3.0), np.log(25.0))))
    ratio = rng.uniform(0.75, 1.33) if comes("ellipse", 0.5) else 1.0
    wide, high, angle = width, width * ratio, rng.uniform(0, np.pi)
    peak = float(np.exp(rng.uniform(np.log(8), np.log(220))))
    if comes("saturated", 0.15):
        peak = rng.uniform(230, 900)
    if comes("edge", 0.08):
        x, y = _near_the_edge(rng, width)
    else:
        x, y = rng.uniform(3 * width, COLUMNS - 3 * width), rng.uniform(3 * width, ROWS - 3 * width)
    spot = gaussian(x, y, wide, high, angle, rng.uniform(1.1, 2) if comes("flat top", 0.05) else 1.0)
    if comes("speckle", 0.1):
        grain = cv2.GaussianBlur(rng.normal(size=spot.shape), (0, 0), rng.uniform(0.7, 2.0))
        spot = spot * np.maximum(1 + rng.uniform(0.02, 0.1) * grain / grain.std(), 0)
    light += peak * spot
    if comes("ghost", 0.2):
        far, to = rng.uniform(2, 8) * width, rng.uniform(0, 2 * np.pi)
        share = rng.uniform(0.02, 0.1)
        if 0 <= x < COLUMNS and 0 <= y < ROWS:  # the ghost of a spot that is not in the picture is the picture's spot
            light += share * peak * gaussian(x + far * np.cos(to), y + far * np.sin(to), wide, high, angle)
    if "edge" not in parts and comes("two", 0.08):
        far, to = rng.uniform(2, 10) * width, rng.uniform(0, 2 * np.pi)
        u, v = x + far * np.cos(to), y + far * np.sin(to)
        if 0 < u < COLUMNS and 0 < v < ROWS:
            light += rng.uniform(0.4, 1) * peak * gaussian(u, v, wide, high, angle)
            if far > _APART * max(wide, high):
                return None
        else:
            parts.remove("two")
    return x, y


def _near_the_edge(rng, width):
    along = rng.uniform(-2, 2.5) * width
    side = rng.integers(4)
    x, y = rng.uniform(0, COLUMNS), rng.uniform(0, ROWS)
    return [(along, y), (COLUMNS - 1 - along, y), (x, along), (x, ROWS - 1 - along)][side]


def _gradient(rng):
    x, y = np.linspace(-1, 1, COLUMNS)[None, :], np.linspace(-1, 1, ROWS)[:, None]
    a, b, c = rng.uniform(-15, 15, 3)
    return a * x + b * y + c * x * y + abs(a) + abs(b) + abs(c)


def _fly(light, rng, truth):
    """An opaque ellipse with a soft rim, in front of the spot or anywhere, darker than what is behind it.

    A lit thing of a spot's size and shape is a spot in a single picture.
    """
    wide, high = rng.uniform(3, 20, 2)
    x, y = rng.uniform(0, COLUMNS), rng.uniform(0, ROWS)
    if truth is not None and rng.random() < 0.5:
        x, y = truth[0] + rng.normal() * 20, truth[1] + rng.normal() * 20
    dx, dy = np.arange(COLUMNS)[None, :] - x, np.arange(ROWS)[:, None] - y
    inside = 1 / (1 + np.exp(np.clip(8 * (np.hypot(dx / wide, dy / high) - 1), -50, 50)))
    level = rng.uniform(0, 40)
    light += inside * np.minimum(level - light, 0)


def _hot(image, rng, read):
    """The picture with hot pixels, some in pairs; and for every other scene a dark frame that shows them."""
    image = image.copy()
    count = int(rng.integers(1, 120))
    rows, columns = rng.integers(0, ROWS, count), rng.integers(0, COLUMNS - 1, count)
    levels = rng.integers(30, 256, count)
    pairs = rng.random(count) < 0.2
    dark = expose(np.full((ROWS, COLUMNS), 4.0), rng, read=read, gain=0.0)
    for row, column, level, pair in zip(rows, columns, levels, pairs, strict=True):
        for at in (column, column + 1)[: 1 + pair]:
            for picture in (image, dark):
                picture[row, at] = min(255, int(picture[row, at]) + int(level))
    return image, dark if rng.random() < 0.5 else None


ONE_BEAM = (*beams.SHAPES, "saturated", "rows", "columns", "jpeg", "colour", "wide", "small", "window")
NO_BEAM = ("empty", "lamp", "two spots", "cut by the edge")
_PEAKS = {"saturated": (300, 1500), "colour": (250, 700), "small": (60, 230)}  # grey values; of the others 40 to 220


def real(rng, kind):
    """A scene of a kind of ONE_BEAM, with the beam's declared place, or of NO_BEAM: what a person sees no one beam in.

    Each beam has a little of all defects, and much of the kind. A part of the pictures has more bits than 8.
    """
    shape = (960, 1280) if kind == "wide" and rng.random() < 0.5 else (ROWS, COLUMNS)
    light = np.full(shape, rng.uniform(0, 12), np.float32)
    truth = None
    if kind == "lamp":
        lamp = beams.draw_window(rng, shape, 0, 0, 100)
        light += beams.window_light(replace(lamp, level=rng.uniform(20, 200)), shape)
    elif kind != "empty":
        truth = _add_beam(light, rng, kind)
    defects = beams.draw_defects(rng, kind)
    if kind not in ("jpeg", "colour") and rng.random() < 0.25:
        defects = replace(defects, bits=int(rng.choice([10, 12, 16])))
    black, read, electrons = rng.uniform(4, 20), rng.uniform(0.4, 2), rng.uniform(10, 50)
    image = beams.expose(light, rng, defects, black=black, read_noise=read, electrons=electrons)
    return Scene(image, truth, [kind])


def _add_beam(light, rng, kind):
    """Add a beam, or two. Returns the declared place of one that is in the picture."""
    rows, columns = light.shape
    sigma = float(np.exp(rng.uniform(np.log(5), np.log(28))))
    if kind in ("wide", "small"):
        sigma = float(rng.uniform(*((40, 0.2 * rows) if kind == "wide" else (1.5, 3))))
    beam = beams.draw_beam(rng, sigma, kind, *(["tails"] if kind == "saturated" else []))
    peak = rng.uniform(*_PEAKS[kind]) if kind in _PEAKS else float(np.exp(rng.uniform(np.log(40), np.log(220))))
    if kind == "cut by the edge":
        x, y = _near_the_edge(rng, sigma / 2)
    else:
        margin = np.minimum(4 * sigma * beam.ratio**0.5, 0.48 * np.array([columns, rows]))
        x, y = rng.uniform(margin, [columns, rows] - margin)
    light += peak * beams.light_of(beam, x, y, light.shape)
    if kind == "two spots":
        far, to = rng.uniform(5, 10) * sigma, np.arctan2(rows / 2 - y, columns / 2 - x) + rng.uniform(-0.7, 0.7)
        other = beams.draw_beam(rng, sigma)
        at = x + far * np.cos(to), y + far * np.sin(to)
        light += rng.uniform(0.5, 1) * peak * beams.light_of(other, *at, light.shape)
    if kind == "window":
        window = beams.draw_window(rng, light.shape, x, y, 6 * sigma)
        light += beams.window_light(replace(window, level=min(window.level, 0.5 * peak)), light.shape)
    if kind not in ONE_BEAM:
        return None
    beyond = int(beam.reach) + 1  # the truth is that of all of the beam
    alone = beams.light_of(beam, x + beyond, y + beyond, (rows + 2 * beyond, columns + 2 * beyond))
    u, v = beams.declared_place(alone)
    return u - beyond, v - beyond
