"""Pictures with the spot drawn into them, for people: PNG, without a drawing package."""

import base64
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mirrormount.markup import html_text
from mirrormount_beam.camera import as_bytes

if TYPE_CHECKING:
    from mirrormount_beam.spot.blobs import Detection
    from mirrormount_beam.spot.find import NoSpot, Spot

_INK = (60, 180, 255)  # blue, green, red
_WIDE_PX = 320  # of a reduced picture as it is shown


def as_png(image: NDArray[Any], found: "Spot | NoSpot", scale: int = 1, corner: tuple[int, int] = (0, 0)) -> bytes:
    """A grey picture (rows, columns) with the spot, if there is one: a cross, and a circle of two standard deviations.

    scale: pixels of the camera for one of this picture, which begins at the camera's pixel `corner`.
    """
    shown = cv2.cvtColor(as_bytes(image), cv2.COLOR_GRAY2BGR)
    if found:
        x, y = ((place - first + 0.5) / scale - 0.5 for place, first in ((found.x, corner[0]), (found.y, corner[1])))
        at, radius = (round(x), round(y)), max(2, round(max(found.width, found.height) * 2 / scale))
        cv2.circle(shown, at, radius, _INK, 1, cv2.LINE_AA)
        cv2.drawMarker(shown, at, _INK, cv2.MARKER_CROSS, 12, 1, cv2.LINE_AA)
    return cv2.imencode(".png", shown)[1].tobytes()


def html_picture(png: bytes, words: str, width_px: int | None = None) -> str:
    """The picture inside of a page; words: what it shows."""
    size = f' width="{width_px}"' if width_px else ""
    return f'<img alt="{html_text(words)}"{size} src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def html_reduced(seen: "Detection | None", found: "Spot | NoSpot") -> str:
    """The reduced picture in which the spot was looked for; "" of a picture of one grey value, which has none."""
    if seen is None:
        return ""
    grey = seen.small.clip(0).round()
    image = grey.astype(np.uint8 if grey.max() <= 255 else np.uint16)
    return html_picture(as_png(image, found, seen.scale, seen.corner), "the picture, reduced", _WIDE_PX)
