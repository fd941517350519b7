"""Whether a picture is exposed well, and by what factor the exposure is to be changed: from its peak and background."""

import math
from typing import NamedTuple

import numpy as np

from mirrormount_beam.camera import Image, range_of
from mirrormount_beam.spot.find import NoSpot, NoSpotReason, Spot

LOW, AIM, HIGH = 0.4, 0.6, 0.8  # of the range, background and peak together (docs/beam.md: expose for the peak)
_MOST = 10.0  # a factor beyond it is not known better than that: change by it, and look again
_OF_LIGHT = (NoSpotReason.FLAT, NoSpotReason.NOTHING, NoSpotReason.DIM, NoSpotReason.SATURATED)


class Advice(NamedTuple):
    """kind: dark, right, bright or saturated. words: for people. factor: of the exposure; None where it may stay."""

    kind: str
    words: str
    factor: float | None


def advice(frame: Image, found: Spot | NoSpot) -> Advice | None:
    """What to do with the exposure; None where the picture does not tell it.

    Light is taken to be proportional to the exposure, as it is without gamma.
    """
    end = range_of(frame.image)
    if found:
        background, top = found.background, found.background + found.peak
        saturated, above_half = float(found.saturated), found.area
    else:
        pixels = frame.selection.pixels(frame.image)
        background = float(np.median(pixels))
        top = float(pixels.max() if found.detection is None else found.detection.small.max())
        saturated = float((pixels >= end).sum()) if top >= 0.98 * end else 0.0
        above_half = float((pixels > (background + end) / 2).sum())
        if found.reason not in _OF_LIGHT:
            if not saturated:
                return None
            return _told(
                frame, "saturated", "some places are saturated: if they are not the beam, choose a region", None
            )
        if not saturated and top >= LOW * end:
            return None  # something is bright enough, and it is no spot
    if saturated:
        # of a Gaussian, the area above a level falls with the logarithm of the level
        doublings = saturated / max(above_half - saturated, 1e-9)
        over = (background + max(end - background, end / 2) * 2 ** min(doublings, 10)) / end
        by = f"about {over:.1f} times the range" if over < _MOST else f"{_MOST:g} times the range or more"
        return _told(frame, "saturated", f"saturated, {by if over > 1.05 else 'hardly'}", AIM / over)
    level = top / end
    what = f"{level:.0%} of {end}"
    if level < LOW:
        beam = "" if found else ", if the beam is on"
        return _told(frame, "dark", f"too dark, {what}{beam}", AIM / max(level, 1e-9))
    if level > HIGH:
        return _told(frame, "bright", f"nearly saturated, {what}", AIM / level)
    return _told(frame, "right", f"right, {what}", None)


def _told(frame: Image, kind: str, words: str, factor: float | None) -> Advice:
    if factor is not None:
        more = max(min(factor, _MOST), 1 / _MOST)
        least = "" if more == factor else " or more" if factor > 1 else " or less"
        words += f": exposure times {more:.2g}{least} ({math.log2(more):+.1f} in powers of 2)"
    colour = frame.colour
    if colour:
        others = [name for name in colour.saturated if name != colour.channel]
        words = f"{colour.channel} is {words}" if kind != "saturated" or factor else words
        words += f"; {' and '.join(others)} {'is' if len(others) == 1 else 'are'} saturated" if others else ""
    return Advice(kind, words, factor)
