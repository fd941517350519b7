"""`find_spot`: where a laser spot is in an image, with its standard error, or why there is none.

Order: candidates (bright places above an uneven background, and one that is wide), the beam in its window (beam.py:
its place, size and error), and what a person would refuse. NoSpotReason declares each reason for no spot once, with
the words for people.
"""

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount.device.table_file import AUTOMATIC
from mirrormount.markup import html_table, html_text
from mirrormount_beam.camera import Dark, Grey, grey, in_one_channel
from mirrormount_beam.selection import WHOLE, Selection, hides
from mirrormount_beam.spot import beam, blobs
from mirrormount_beam.spot.picture import html_reduced

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
    REGION = (
        "region",
        "the spot is cut by the region's edge",
        "move the region or make it larger (--roi), or move the beam",
    )
    MASK = ("mask", "the mask hides a part of the spot", "make the mask smaller (--mask), or move the beam")
    CONTRAST = (
        "contrast",
        "the spot has less contrast than is asked for",
        "expose for longer, or ask for less (--contrast)",
    )
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


# ---- the spot of an image

_AROUND, _LEAST_AROUND = 9.7, 46.0  # standard deviations to each side that are cut out for a small beam; px, at least
_SMALL = 1 / 14  # standard deviation of a small beam at most, in parts of the picture: rows have more dark than beam
_SHARPER = 0.6  # peak of a part of a wide bright place, in peaks of that, above which the part may be the beam
_LARGER = 3.0  # times as large as the spot: a window or a lamp in view is no second spot
GHOST = 0.25  # a second spot with at least this part of the first one's light makes the place ambiguous
_ALONE = 3.0  # peak at least, in thresholds: a second spot of 40 % would be seen, also with the noise against it
_FAINT = 0.1  # a blob with less of the first one's light is none: some hot pixels
_TIP = 0.05  # part of a blob's light above the threshold, at least: a peak there has noise
_SMALLEST = 0.75  # standard deviation of a spot at least, px: a hot pixel is narrower
_LONGISH = 4.0  # ratio of the axes at most
_MARGIN = 2.0  # standard deviations between the place and the picture's edge at least
_SATURATED = 1.0  # saturated area at most, in parts of the area above half of a Gaussian's peak
# what hides light is a doubt of the place: a saturated core, and an edge nearer than the window's radius, in parts of
# the standard deviation (for a radius that is less by one), and of shape_px; of beams that are 1 to 10 % asymmetric
_CORE, _CORE_SHAPE, _RIM, _RIM_SHAPE = 0.0095, 0.55, 0.01, 0.8
_LEAST = 5e-4  # standard error at least, in standard deviations: of the window's bins, and of surroundings that curve
_UNSURE = 0.25  # standard error at most, in standard deviations of the spot
_STANDS_OUT = 0.25  # scatter of the surroundings at most, in parts of the peak
_NEAR = 4.8  # standard deviations within which a second spot is looked for in the light itself
_HIDDEN = 0.8  # of a bright place, which is then no light
_VALLEY = 0.15  # depth of the valley between two spots, in parts of the fainter one
REACH_OF_SHAPE = 0.5  # part of the window in which the place is taken once more, for the doubt of the shape


@dataclass(frozen=True, slots=True)
class Spot:
    """A spot. Unit: pixels from the centre of the top left one, x to the right, y down.

    x, y: its place, the centroid of its light in a window of 3 of its standard deviations (beam.py). sigma_x,
    sigma_y: their standard errors by the noise of one image, which is how well images of a beam at rest repeat.
    shape_px: how far the centroid of the inner half of the window is from the place: 0 for a symmetric beam, whatever
    its shape; the doubt that an asymmetric one leaves about what "the place" is. width, height: standard deviations
    of the Gaussian of its size along x and y (half of the 1/e² radius). d4_long, d4_short: D4-sigma widths along its
    axes. angle: of the longer axis, degrees clockwise from x. peak: grey values above the background. background: grey
    value beside the spot. saturated: number of saturated pixels. area: pixels above half of the peak. detection:
    threshold and blobs.
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
    shape_px: float = 0.0
    d4_long: float = 0.0
    d4_short: float = 0.0
    angle: float = 0.0
    detection: blobs.Detection | None = field(default=None, repr=False, compare=False)

    def __str__(self) -> str:
        return f"spot at x {self.x:.3f} ± {self.sigma_x:.3f} px, y {self.y:.3f} ± {self.sigma_y:.3f} px"

    @property
    def ellipticity(self) -> float:
        """The shorter D4-sigma width over the longer one: 1 for a round beam."""
        return self.d4_short / self.d4_long if self.d4_long else 1.0

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Of the Gaussian of its size, px², with the axes of the D4-sigma widths."""
        longer = (1 - self.ellipticity**2) / (1 + self.ellipticity**2)  # of the variances: difference over sum
        across = longer * (self.width**2 + self.height**2) / 2 * math.sin(math.radians(2 * self.angle))
        across = max(min(across, 0.95 * self.width * self.height), -0.95 * self.width * self.height)
        return np.array([[self.width**2, across], [across, self.height**2]])

    def _repr_html_(self) -> str:
        """The reduced picture in which it was found, with the spot drawn into it, and its figures."""
        rows = [
            ("x, px", f"{self.x:.3f} ± {self.sigma_x:.3f}"),
            ("y, px", f"{self.y:.3f} ± {self.sigma_y:.3f}"),
            ("width, height, px", f"{self.width:.2f}, {self.height:.2f}"),
            ("doubt by the shape, px", f"{self.shape_px:.3f}"),
            ("peak above background", f"{self.peak:.0f} above {self.background:.0f}"),
            ("saturated pixels", self.saturated),
        ]
        return html_reduced(self.detection, self) + html_table(("spot", ""), rows)


@dataclass(frozen=True, slots=True)
class NoSpot:
    """No spot, and why. It is false: `if spot := find_spot(image)`."""

    reason: NoSpotReason
    detection: blobs.Detection | None = field(default=None, repr=False, compare=False)

    def __bool__(self) -> Literal[False]:
        return False

    def __str__(self) -> str:
        return f"no spot: {self.reason.words}"

    def _repr_html_(self) -> str:
        return f"{html_reduced(self.detection, self)}<p>{html_text(self)}</p>"


def find_spot(
    frame: "Image | NDArray[np.uint8] | NDArray[np.uint16]",
    dark: "Dark | NDArray | None" = None,
    *,
    region: tuple[int, int, int, int] | None = None,
    mask: "NDArray[np.bool_] | None" = None,
    channel: str | None = None,
    contrast: float | None = None,
) -> Spot | NoSpot:
    """The spot in an image or array, (rows, columns) or (rows, columns, channels: blue, green, red), 8 or 16 bit.

    dark: a picture without the beam, or a Dark, whose hot pixels are not used. region: x, y, width and height of what
    is looked at; mask: True where nothing is; channel: red, green, blue, grey or automatic; contrast: grey values of
    the peak above its surroundings, at least (Selection). What is not given is as the image's camera has it. Places are
    in pixels of the whole picture. Raises BadValue for an array of another form, a dark picture or a mask of another
    size, a region that is not in the picture, a channel that is not known or that a grey picture has not.
    """
    given = {"region": region, "mask": mask, "channel": channel, "contrast": contrast}
    given = {name: value for name, value in given.items() if value is not None}
    # a camera's image is in one channel already
    selection = replace(getattr(frame, "selection", WHOLE), **{"channel": AUTOMATIC, **given})
    array: Any = getattr(frame, "image", frame)
    whole, _ = in_one_channel(array, selection)
    if selection.is_whole and not selection.contrast:
        return _found(grey(whole), None if dark is None else Dark.of(dark).hot_in(whole), None)
    rows, columns, hidden = selection.part(whole.shape)
    hot = None if dark is None else Dark.of(dark).hot_in(whole)[rows, columns]
    found = _found(grey(np.ascontiguousarray(whole[rows, columns]), hidden), hot, hidden)
    if hidden is not None:
        found = _beside(hidden, found)
    seen = found.detection and found.detection.moved(columns.start, rows.start)
    if isinstance(found, NoSpot):
        of_edge = found.reason in (NoSpotReason.EDGE, NoSpotReason.WIDE)
        return NoSpot(_cut_by(selection, whole.shape, seen) or found.reason if of_edge else found.reason, seen)
    if found.peak < selection.contrast:
        return NoSpot(NoSpotReason.CONTRAST, seen)
    return replace(found, x=found.x + columns.start, y=found.y + rows.start, detection=seen)


def _beside(hidden: NDArray, found: Spot | NoSpot) -> Spot | NoSpot:
    """What was found beside a mask: refused where it hides the beam; what it may hide of its rim is in the error."""
    seen = found.detection
    if found:
        moved = hides(hidden, (found.x, found.y), found.covariance)
        if moved is not None:
            sigmas = math.hypot(found.sigma_x, moved[0]), math.hypot(found.sigma_y, moved[1])
            return replace(found, sigma_x=sigmas[0], sigma_y=sigmas[1])
    elif seen is None or not seen.blobs:
        return found
    else:  # a beam that is cut has no shape of a spot, and other such reasons
        first = seen.blobs[0]
        if hides(hidden, (first.x, first.y), first.start[1]) is not None:
            return found
    return NoSpot(NoSpotReason.MASK, seen)


def _cut_by(selection: Selection, shape: tuple[int, ...], seen: blobs.Detection | None) -> NoSpotReason | None:
    """What cuts a spot, if its nearest edge is not that of the picture."""
    if selection.is_whole:
        return None
    if not seen or not seen.blobs:
        return NoSpotReason.REGION if selection.region else NoSpotReason.MASK
    rows, columns, _ = selection.part(shape)
    whose = {"picture": None, "region": NoSpotReason.REGION, "mask": NoSpotReason.MASK}
    blob = seen.blobs[0]
    ways = (blob.y, blob.width_y, rows, 0), (blob.x, blob.width_x, columns, 1)
    edges = [(abs(at - edge) / width, edge, axis) for at, width, part, axis in ways for edge in (part.start, part.stop)]
    _, edge, axis = min(edges)
    return whose[selection.edge_of(edge, shape, axis)]


def _found(picture: Grey, hot: NDArray | None, hidden: NDArray | None) -> Spot | NoSpot:
    """The spot in a grey picture. hot: pixels that are not used. hidden: those that a mask hides."""
    image = picture.image
    if picture.flat:
        return NoSpot(NoSpotReason.FLAT)
    if hot is not None:
        image = np.where(hot, cv2.medianBlur(image, 5), image)
    seen = blobs.detect(image)
    wide = blobs.wide(seen)
    if hidden is not None:
        seen = replace(seen, blobs=[blob for blob in seen.blobs if not _is_hidden(blob, hidden)])
        wide = wide and (None if _is_hidden(wide, hidden) else wide)
    start = _start(seen, wide)
    if isinstance(start, NoSpotReason):
        return NoSpot(NoSpotReason.SATURATED if picture.saturated.mean() > 0.2 else start, seen)
    found = _followed(image, seen, *start)
    if found is None:
        return NoSpot(NoSpotReason.SATURATED if picture.saturated.mean() > 0.05 else NoSpotReason.SHAPE, seen)
    return _judge(found, picture, seen)


def _is_hidden(blob: blobs.Blob, hidden: NDArray) -> bool:
    """Whether a bright place is one of what a mask was filled with."""
    half_x, half_y = 1.5 * blob.width_x, 1.5 * blob.width_y
    rows = slice(max(int(blob.y - half_y), 0), int(blob.y + half_y) + 2)
    columns = slice(max(int(blob.x - half_x), 0), int(blob.x + half_x) + 2)
    return float(hidden[rows, columns].mean()) > _HIDDEN


def _start(seen: blobs.Detection, wide: blobs.Blob | None) -> tuple[NDArray, NDArray, float] | NoSpotReason:
    """Centre, covariance and peak to begin with: of the brightest place. Others as bright are a reason for none."""
    places = seen.blobs
    if wide is not None:
        inside = [place for place in places if _within(place, wide)]
        # a coarse picture makes a small beam dimmer, and two that are near each other one
        sharper = [place for place in inside if place.peak > _SHARPER * wide.peak]
        places = [place for place in places if place not in inside] + (sharper or [wide])
    if not places:
        return NoSpotReason.NOTHING
    first = max(places, key=lambda place: place.peak)
    least = _FAINT * _light(first, seen)
    for other in places:
        if other is first or other.peak < GHOST * first.peak or _light(other, seen) < least:
            continue
        if other.width_x * other.width_y < _LARGER**2 * first.width_x * first.width_y:
            return NoSpotReason.SPLIT
    if first.peak < _ALONE * blobs.ABOVE * seen.noise:
        return NoSpotReason.DIM
    return first.start


def _followed(
    image: NDArray, seen: blobs.Detection, centre: NDArray, covariance: NDArray, peak: float
) -> beam.Beam | None:
    """The beam from this start on. From the rows of a small one their levels are taken off first."""
    rows, columns = image.shape
    wide, high = np.sqrt(np.diag(covariance))
    small = max(wide / columns, high / rows) < _SMALL
    half_x, half_y = (int(max(_AROUND * each, _LEAST_AROUND)) for each in (wide, high)) if small else (columns, rows)
    left, top = max(0, int(centre[0]) - half_x), max(0, int(centre[1]) - half_y)
    scale = beam.reduction(covariance)
    part = blobs.means(image[top : int(centre[1]) + half_y + 1, left : int(centre[0]) + half_x + 1], scale)
    part = beam.without_outliers(part)
    if small:
        part -= seen.level_of(top + (np.arange(part.shape[0]) + 0.5) * scale - 0.5)[:, None]
    return beam.follow(part, centre, covariance, peak, image.shape, np.array([left, top], float), scale, small)


def _within(place: blobs.Blob, wide: blobs.Blob) -> bool:
    """Whether a bright place is a part of the wide one: what a tile of the surroundings has left of it."""
    return abs(place.x - wide.x) < 1.5 * wide.width_x and abs(place.y - wide.y) < 1.5 * wide.width_y


def _light(blob: blobs.Blob, seen: blobs.Detection) -> float:
    """All light of a blob: that of a Gaussian above a level q of its peak is the part 1 - q of it."""
    return blob.flux / max(1 - seen.threshold / blob.peak, _TIP)


def _judge(found: beam.Beam, picture: Grey, seen: blobs.Detection) -> Spot | NoSpot:
    """The spot with its errors, or what is wrong with it."""

    def none(reason: NoSpotReason) -> NoSpot:
        return NoSpot(reason, seen)

    window, (x, y), (short, long) = found.window, map(float, found.centre), found.axes
    wide, high = (float(value) for value in np.sqrt(np.diag(found.covariance)))
    half_area = 2 * math.pi * math.log(2) * short * long
    saturated = _saturated_around(picture, (x, y), (wide, high))
    if saturated > _SATURATED * half_area:
        return none(NoSpotReason.SATURATED)
    if short < _SMALLEST:
        return none(NoSpotReason.SMALL)
    if found.edge < _MARGIN:
        rows, columns = picture.image.shape
        return none(NoSpotReason.WIDE if 4 * _MARGIN * max(wide / columns, high / rows) > 1.5 else NoSpotReason.EDGE)
    if not found.settled or long > _LONGISH * short:
        return none(NoSpotReason.SHAPE)
    smooth = beam.smoothed(window)
    inside = window.r2 < found.reach**2
    peak = float(smooth[inside].max())
    if beam.lobes(smooth, window.r2 < _NEAR**2, peak, _VALLEY) > 1:
        return none(NoSpotReason.SPLIT)
    if window.scatter > _STANDS_OUT * peak:
        return none(NoSpotReason.SHAPE)
    sigma_x, sigma_y = beam.place_errors(found)
    shift = beam.place_in(found, REACH_OF_SHAPE * found.reach)
    shape_px = float(np.hypot(*shift))
    core, rim = min(saturated / half_area, 1.0), beam.REACH - found.reach
    hidden, shape = _CORE * core + _RIM * rim, (_CORE_SHAPE * core + _RIM_SHAPE * rim) * shape_px
    sigma_x = math.hypot(sigma_x, hidden * wide, shape, _LEAST * wide)
    sigma_y = math.hypot(sigma_y, hidden * high, shape, _LEAST * high)
    if max(sigma_x / wide, sigma_y / high) > _UNSURE:
        return none(NoSpotReason.DIM)
    d4_long, d4_short, angle = beam.d4_sigma(found)
    return Spot(
        x=x,
        y=y,
        sigma_x=sigma_x,
        sigma_y=sigma_y,
        width=wide,
        height=high,
        peak=peak,
        background=float(window.plane[0]),
        saturated=saturated,
        area=float((smooth[inside] > peak / 2).sum()) * (window.side * found.scale) ** 2,
        shape_px=shape_px,
        d4_long=d4_long,
        d4_short=d4_short,
        angle=angle,
        detection=seen,
    )


def _saturated_around(picture: Grey, centre: tuple[float, float], widths: tuple[float, float]) -> int:
    """How many pixels are saturated within three widths of a place."""
    (x, y), (half_x, half_y) = centre, (int(3 * width) + 1 for width in widths)
    rows = slice(max(round(y) - half_y, 0), round(y) + half_y)
    columns = slice(max(round(x) - half_x, 0), round(x) + half_x)
    return int(picture.saturated[rows, columns].sum())
