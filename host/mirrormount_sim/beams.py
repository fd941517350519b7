"""Real beams and real sensors, drawn by seed: light that is no Gaussian, the place of a beam, and what a chip does.

A pixel's coordinates are (column, row) from the centre of the top left one; x goes right, y goes down. Lengths of a
beam's shape are in its sigma, so that a shape keeps its look at any size. Light is in grey values of 8 bits. The ranges
are estimates from about 20 pictures that others published of their beams, on bare chips and on screens.
"""

import functools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Light = NDArray[np.float32]

# ---- the shape of a beam


@dataclass(frozen=True)
class Fringes:
    """Two reflections that interfere. contrast: from the mean to a crest, of the light. Period in sigma, rad."""

    contrast: float
    period: float
    angle: float
    phase: float


@dataclass(frozen=True)
class Rings:
    """What a grain of dust at (x, y) diffracts: a dark place, and rings that become narrower. Lengths in sigma.

    radius: of the first bright ring. depth: of the light. Wide ones about the middle are those of a lens or a window.
    """

    depth: float
    radius: float
    x: float
    y: float


@dataclass(frozen=True)
class Aperture:
    """A hard edge, so far from the middle in that direction (sigma, rad): a straight one, or of a hole of a radius."""

    edge: float
    angle: float
    radius: float = math.inf


@dataclass(frozen=True)
class Beam:
    """The shape of a beam. Beam() is a round Gaussian."""

    sigma: float = 12.0  # px: one standard deviation, the geometric mean of both axes
    ratio: float = 1.0  # of the long axis to the short one
    angle: float = 0.0  # of the long axis, rad, from x towards y
    skew: tuple[float, float] = (0.0, 0.0)  # share of the third Hermite mode along the long axis, the short one
    flat: float = 0.0  # share of the fourth mode along both: above 0 the top is flat, below 0 it is peaked
    halo: float = 0.0  # height of a broad, weak Gaussian below the beam, of the peak
    halo_width: float = 3.0  # its sigma, in the beam's
    rings: tuple[Rings, ...] = ()
    fringes: Fringes | None = None
    aperture: Aperture | None = None

    @property
    def reach(self) -> float:
        """Beyond it, in px, there is less than 0.1 % of the peak."""
        return self.sigma * math.sqrt(self.ratio) * max(5.5, 2.8 * self.halo_width if self.halo else 0.0)


GAUSSIAN = Beam()


def patch(beam: Beam, x: float, y: float, shape: tuple[int, ...]) -> tuple[slice, slice, Light]:
    """The beam with a peak of about 1 where it is in a picture of that shape: rows, columns, light.

    (x, y): its declared place, so that all shapes of a beam lie at the same place. The light is that of each pixel's
    centre; it is computed anew for each place and never shifted, so a shift by a part of a pixel is exact.
    """
    off_x, off_y, peak = _normal_form(beam)
    x, y = x - off_x, y - off_y
    left, right = max(0, math.ceil(x - beam.reach)), max(0, min(shape[1], math.floor(x + beam.reach) + 1))
    top, bottom = max(0, math.ceil(y - beam.reach)), max(0, min(shape[0], math.floor(y + beam.reach) + 1))
    if left >= right or top >= bottom:
        return slice(0, 0), slice(0, 0), np.zeros((0, 0), np.float32)
    light = _shape(beam, np.arange(left, right) - x, np.arange(top, bottom) - y)
    light *= np.float32(1 / peak)
    return slice(top, bottom), slice(left, right), light


def light_of(beam: Beam, x: float, y: float, shape: tuple[int, int]) -> Light:
    """A picture of that shape, with the beam alone at (x, y) and a peak of about 1."""
    picture = np.zeros(shape, np.float32)
    rows, columns, light = patch(beam, x, y, shape)
    picture[rows, columns] = light
    return picture


_MOST_SIGMA = 24.0  # px: at this size a shape's place is known to 0.001 of its sigma


@functools.lru_cache(256)
def _normal_form(beam: Beam) -> tuple[float, float, float]:
    """The declared place of a shape, from the middle of its formula in px, and its peak."""
    small = replace(beam, sigma=min(beam.sigma, _MOST_SIGMA))
    half = math.ceil(small.reach)
    axis = np.arange(-half, half + 1)
    light = _shape(small, axis, axis)
    x, y = declared_place(light)
    scale = beam.sigma / small.sigma
    return (x - half) * scale, (y - half) * scale, float(light.max())


def _shape(beam: Beam, right_px: NDArray[Any], down_px: NDArray[Any]) -> Light:
    """The formula of the light at so many pixels from its middle: down x right."""
    across = (right_px / beam.sigma).astype(np.float32)[None, :]
    down = (down_px / beam.sigma).astype(np.float32)[:, None]
    c, s, root = math.cos(beam.angle), math.sin(beam.angle), math.sqrt(beam.ratio)
    u, v = c / root * across + s / root * down, c * root * down - s * root * across
    u2, v2 = u * u, v * v
    square = u2 + v2
    light = np.exp(np.float32(-0.5) * square)
    if beam.flat or any(beam.skew):
        flat, (along, over) = np.float32(beam.flat), beam.skew
        mode = (u2 - 3) * u * np.float32(along)
        mode += (v2 - 3) * v * np.float32(over)
        if beam.flat:
            mode -= ((u2 - 6) * u2 + (v2 - 6) * v2 + 6) * flat
        mode += 1
        light *= np.maximum(mode, 0, out=mode)
    if beam.halo:
        square *= np.float32(-0.5 / beam.halo_width**2)
        light += np.float32(beam.halo) * np.exp(square, out=square)
    if beam.fringes:
        _modulate(light, beam.fringes, across, down)
    for rings in beam.rings:
        _ring(light, rings, across, down)
    if beam.aperture:
        light *= _opening(beam.aperture, across, down, np.float32(beam.sigma))
    return light


def _modulate(light: Light, fringes: Fringes, across: Light, down: Light) -> None:
    """Multiply by 1 + contrast cos(k r + phase)."""
    k = 2 * math.pi / fringes.period
    a = (k * math.cos(fringes.angle) * across + fringes.phase).astype(np.float32)
    b = (k * math.sin(fringes.angle) * down).astype(np.float32)
    wave = np.cos(a) * np.cos(b) - np.sin(a) * np.sin(b)
    wave *= np.float32(fringes.contrast)
    wave += 1
    light *= wave


_FADE = 2.5  # rings: in q = (r/radius)^2, a ring later for each 2, their depth falls as exp(-q / _FADE)


def _ring(light: Light, rings: Rings, across: Light, down: Light) -> None:
    """Multiply the part around a grain by 1 - depth cos(pi q) exp(-q / _FADE), where q = (r / radius)^2."""
    far = rings.radius * math.sqrt(5 * _FADE)
    left, right = np.searchsorted(across[0], (rings.x - far, rings.x + far))
    top, bottom = np.searchsorted(down[:, 0], (rings.y - far, rings.y + far))
    q = ((across[:, left:right] - rings.x) ** 2 + (down[top:bottom] - rings.y) ** 2) * np.float32(rings.radius**-2)
    light[top:bottom, left:right] *= 1 - np.float32(rings.depth) * np.cos(np.pi * q) * np.exp(q / -_FADE)


def _opening(aperture: Aperture, across: Light, down: Light, sigma: np.float32) -> Light:
    """The share of each pixel that an aperture lets through."""
    c, s = math.cos(aperture.angle), math.sin(aperture.angle)
    if math.isinf(aperture.radius):
        inside = aperture.edge - c * across - s * down
    else:
        middle = aperture.edge - aperture.radius
        inside = aperture.radius - np.hypot(across - c * middle, down - s * middle)
    return np.clip(inside.astype(np.float32) * sigma + np.float32(0.5), 0, 1)


# ---- the place of a beam

_WINDOW, _SOFT = 3.0, 0.3  # the window's edge, and half of the width over which it falls, in the beam's sigma
_ABOVE_HALF = 0.217128  # what the light above half of the peak, less that half, has of a Gaussian's second moments
_STILL, _ROUNDS = 1e-3, 60  # px; until the place moves by less, at most so often


def declared_place(light: NDArray[Any]) -> tuple[float, float]:
    """(x, y) of a beam: the centroid of its light within an ellipse of 3 sigma that follows it (docs/beam.md).

    light: of the beam alone, without ambient light, noise and saturation, at each pixel's centre. The ellipse is that
    of the Gaussian which, as a weight, has the light's own second moments: it fits a Gaussian of any axes, and a halo
    hardly widens it. Its edge is soft, over a tenth to each side.
    """
    rows, columns = np.nonzero(light)
    values = light[rows, columns].astype(float)
    places = np.stack([columns, rows]).astype(float)
    centre, moments = _moments(places, np.maximum(values - values.max() / 2, 0))
    moments /= _ABOVE_HALF
    for _ in range(_ROUNDS):
        off = places - centre[:, None]
        square = (off * np.linalg.solve(moments, off)).sum(axis=0)
        before, size = centre, moments[0, 0] + moments[1, 1]
        window = np.clip((_WINDOW + _SOFT - np.sqrt(square)) / (2 * _SOFT), 0, 1)
        centre, _ = _moments(places, values * window)
        moments = 2 * _moments(places, values * np.exp(-square / 2))[1]
        if math.dist(centre, before) < _STILL and abs(moments[0, 0] + moments[1, 1] - size) < _STILL * size:
            break
    return float(centre[0]), float(centre[1])


def _moments(places: NDArray[np.float64], weights: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Centroid, and the matrix of the second moments about it."""
    total = weights.sum()
    centre = places @ weights / total
    off = places - centre[:, None]
    return centre, (off * weights) @ off.T / total


# ---- what a sensor does to light


@dataclass(frozen=True)
class Window:
    """Something bright in view: a window of a room, or, if round, a lamp that is out of focus. Lengths in px."""

    x: float
    y: float
    wide: float  # from the middle to the edge, or one standard deviation
    high: float
    level: float  # grey values
    round: bool = False


@dataclass(frozen=True)
class Defects:
    """What a sensor does to a picture. Defects() is a good sensor of 8 bits."""

    seed: int = 1  # of what is of the chip, not of the moment
    bits: int = 8  # 10, 12 and 16 are the lower bits of 16
    odd_rows: float = 1.0  # sensitivity of each second row, of the first one's: two fields, or two amplifiers
    columns: float = 0.0  # standard deviation of the columns' levels, grey values; they stay
    rows: float = 0.0  # of the rows' levels; they change from frame to frame
    smear: float = 0.0  # of a column's mean light, added all along it
    hot: int = 0  # pixels
    dead: int = 0  # pixels
    gamma: float = 1.0
    colour: tuple[float, float, float] | None = None  # the light's share in blue, green, red
    jpeg: int | None = None  # its quality


GOOD = Defects()


def expose(
    light: Light,
    noise: np.random.Generator,
    defects: Defects = GOOD,
    *,
    black: float = 6.0,
    read_noise: float = 1.5,
    electrons: float = 47.0,
) -> NDArray[Any]:
    """A frame of this light: rows x columns (x 3 in colour), uint8, or uint16 of more bits than 8.

    black, read_noise, electrons: the level without light, its noise, and the electrons of one grey value.
    """
    shares = defects.colour or (1.0,)
    noises = normal_numbers(noise, light.size * len(shares)).reshape(len(shares), *light.shape)
    lines = normal_numbers(noise, light.shape[0])[:, None] * np.float32(defects.rows)
    channels = []
    for share, grain in zip(shares, noises, strict=True):
        frame = light * np.float32(share)
        if defects.smear:
            frame += np.float32(defects.smear) * frame.mean(axis=0)
        if defects.odd_rows != 1:
            frame[1::2] *= np.float32(defects.odd_rows)
        spread = np.sqrt(frame * np.float32(1 / electrons) + np.float32(read_noise**2))
        spread *= grain
        frame += spread
        frame += np.float32(black)
        _fix(frame, defects)
        frame += lines
        channels.append(_digitised(frame, defects))
    image = np.dstack(channels) if defects.colour else channels[0]
    return image if defects.jpeg is None else _compressed(image, defects.jpeg)


def _fix(frame: Light, defects: Defects) -> None:
    """What is always at the same place."""
    columns, hot, levels, dead = _pattern(defects, frame.shape)
    if defects.columns:
        frame += columns
    flat = frame.reshape(-1)
    flat[hot] += levels
    flat[dead] = 0


@functools.lru_cache(32)
def _pattern(defects: Defects, shape: tuple[int, int]) -> tuple[NDArray[Any], ...]:
    """Levels of the columns, places and levels of the hot pixels, places of the dead ones."""
    fixed = np.random.default_rng([defects.seed, 3])
    columns = fixed.standard_normal(shape[1], np.float32) * np.float32(defects.columns)
    size = shape[0] * shape[1]
    hot, levels = fixed.integers(0, size, defects.hot), fixed.uniform(40, 250, defects.hot).astype(np.float32)
    return columns, hot, levels, fixed.integers(0, size, defects.dead)


def _digitised(frame: Light, defects: Defects) -> NDArray[Any]:
    """The frame, which is overwritten, as whole numbers."""
    if defects.gamma != 1:
        np.clip(frame, 0, None, out=frame)
        frame *= np.float32(1 / 255)
        np.power(frame, np.float32(defects.gamma), out=frame)
        frame *= np.float32(255)
    frame *= np.float32(1 << (defects.bits - 8))
    frame += np.float32(0.5)  # rounded, not cut
    np.clip(frame, 0, (1 << defects.bits) - 1, out=frame)
    return frame.astype(np.uint8 if defects.bits == 8 else np.uint16)


def _compressed(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """As a camera of motion JPEG sends it."""
    import cv2  # here, for nothing else of the bench needs OpenCV

    file = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(file, cv2.IMREAD_UNCHANGED), np.uint8)


@functools.lru_cache(8)
def window_light(window: Window, shape: tuple[int, int]) -> Light:
    """A window's light in a picture of that shape, not to be written to."""
    across = np.abs(np.arange(shape[1]) - window.x)[None, :]
    down = np.abs(np.arange(shape[0]) - window.y)[:, None]
    if window.round:
        share = np.exp(-0.5 * ((across / window.wide) ** 2 + (down / window.high) ** 2))
    else:
        share = 1 / (1 + np.exp(np.clip(across - window.wide, -50, 50) / 2))
        share = share / (1 + np.exp(np.clip(down - window.high, -50, 50) / 2))
    return (window.level * share).astype(np.float32)


_BANK = 1 << 21  # normal numbers, drawn once: a frame takes them from a random place on


def normal_numbers(noise: np.random.Generator, count: int) -> Light:
    """Normal numbers, not to be written to. Drawing them afresh would take longer than all the rest of a frame."""
    bank = _bank()
    if count >= len(bank):
        return noise.standard_normal(count, np.float32)
    start = int(noise.integers(0, len(bank) - count))
    return bank[start : start + count]


@functools.cache
def _bank() -> Light:
    return np.random.default_rng(0).standard_normal(_BANK, dtype=np.float32)


# ---- drawn by seed

SHAPES = ("elliptical", "skewed", "flat", "tails", "rings", "fringes", "clipped")  # what draw_beam() can give much of
_LEAST_PERIOD_PX = 3.0  # of fringes: pixels do not show finer ones
_GRAIN_PX = (4.0, 15.0)  # first bright ring of dust on a chip's window


def draw_beam(noise: np.random.Generator, sigma: float, *much: str) -> Beam:
    """A beam that a person takes for one beam: with a little of everything, and of what is named (SHAPES) with much."""

    def drawn(name: str, little: tuple[float, float], large: tuple[float, float]) -> float:
        return float(noise.uniform(*(large if name in much else little)))

    def turn() -> float:
        return float(noise.uniform(0, 2 * math.pi))

    ratio = drawn("elliptical", (1.0, 1.3), (1.3, 2.0))
    skew, to = drawn("skewed", (0.005, 0.03), (0.03, 0.10)), turn()
    flat = drawn("flat", (0.0, 0.01), (0.01, 0.05)) * float(noise.choice((-1, 1)))
    halo, halo_width = drawn("tails", (0.0, 0.01), (0.01, 0.05)), float(noise.uniform(2, 3))
    rings = []
    for _ in range(int(noise.integers(3, 9) if "rings" in much else noise.integers(0, 3))):
        radius = min(0.5, float(noise.uniform(*_GRAIN_PX)) / sigma)
        x, y = noise.normal(0, 1, 2)
        rings.append(Rings(drawn("rings", (0.005, 0.02), (0.02, 0.08)), radius, float(x), float(y)))
    contrast = drawn("fringes", (0.0, 0.03), (0.03, 0.15))
    period = max(float(noise.uniform(0.2, 1.5)), _LEAST_PERIOD_PX / sigma)
    fringes = Fringes(contrast, period, turn(), turn())
    edge, radius, at = float(noise.uniform(1.2, 2.0)), float(noise.choice((math.inf, 1.6, 2.0))), turn()
    aperture = Aperture(edge, at, radius) if "clipped" in much else None
    angle, skews = turn() / 2, (skew * math.cos(to), skew * math.sin(to))
    return Beam(sigma, ratio, angle, skews, flat, halo, halo_width, tuple(rings), fringes, aperture)


def draw_defects(noise: np.random.Generator, *much: str) -> Defects:
    """A sensor with a little of what stays in all pictures, and with what is named: rows, columns, colour, jpeg."""
    columns = noise.uniform(0.7, 2.0) if "columns" in much else noise.uniform(0.0, 0.5)
    rows = noise.uniform(0.5, 2.0) if "columns" in much else noise.uniform(0.0, 0.3)
    smear = noise.uniform(0.02, 0.2) if "columns" in much else 0.0
    fields = noise.random() < 0.25  # a sensor of two fields
    odd_rows = noise.uniform(0.67, 0.97) if "rows" in much else noise.uniform(0.94, 1.0) if fields else 1.0
    blue, green, red = (float(share) for share in noise.permutation([1.0, *noise.uniform(0.05, 0.6, 2)]))
    return Defects(
        seed=int(noise.integers(1 << 31)),
        odd_rows=float(odd_rows),
        columns=float(columns),
        rows=float(rows),
        smear=float(smear),
        hot=int(noise.integers(0, 15)),
        dead=int(noise.integers(0, 8)),
        colour=(blue, green, red) if "colour" in much else None,
        jpeg=int(noise.integers(70, 96)) if "jpeg" in much else None,
    )


def draw_window(noise: np.random.Generator, shape: tuple[int, int], x: float, y: float, apart: float) -> Window:
    """A window or a lamp in a picture of that shape, dimmer than a beam, and so many px apart from (x, y)."""
    while True:
        lamp = bool(noise.random() < 0.5)
        wide, high = noise.uniform(60, 100, 2) if lamp else noise.uniform(20, 80, 2)
        beyond = 0.2 if lamp else 0.0  # of the picture's size: a lamp reaches into it from there
        right, down = noise.uniform(-beyond, 1 + beyond, 2) * (shape[1], shape[0])
        level, size = float(noise.uniform(15, 60)), 2 if lamp else 1
        window = Window(float(right), float(down), float(wide), float(high), level, lamp)
        if max(abs(window.x - x) - size * window.wide, abs(window.y - y) - size * window.high) > apart:
            return window
