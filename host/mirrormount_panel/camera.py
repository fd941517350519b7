"""A camera on a page: its elements, what is told of it, and the route of its pictures.

static/camera.js fills the elements. It is told, as JSON, the spot, or why there is none, the threshold and the target.
A page asks for the next picture when it has drawn the last one, so no picture ever waits in the network.
"""

import asyncio
import json
import re
import time
from collections.abc import Callable, Sequence
from html import escape
from typing import Any, Generic, TypeVar, cast

import numpy as np
from fastapi import APIRouter, Request, Response

from mirrormount.errors import BadFile, NotCalibrated
from mirrormount_beam import scale as camera_scale
from mirrormount_beam.camera import Camera, Size
from mirrormount_beam.cuts import Cut, cuts
from mirrormount_beam.estimates import Estimate
from mirrormount_beam.exposure import advice
from mirrormount_beam.live import LiveView, Seen
from mirrormount_beam.scale import Optics, Scale
from mirrormount_beam.spot.find import NoSpot, Spot
from mirrormount_panel.auth import Rates

# ---- the elements

_PROFILE_HTML = (
    '<p class="camera-exposure"></p>'
    '<canvas class="cuts" role="img" aria-label="Light along the axes of the beam, and Gaussians of the same size">'
    '</canvas><canvas class="profile" role="img" aria-label="Brightness of one row, and the threshold"></canvas>'
)


def camera_html(number: int, name: str, *, clicks: bool = False, profile: bool = False) -> str:
    """The elements that static/camera.js fills. clicks: a click moves the spot; profile: exposure, cuts, a row."""
    label = escape(f"Picture of {name}" + (": click where the spot should go" if clicks else ""), quote=True)
    return (
        f'<div class="camera" data-camera="{number}"{" data-clicks" if clicks else ""}>'
        f'<canvas class="picture" role="img" aria-label="{label}"></canvas>'
        '<p class="camera-trouble" role="status"></p><p class="camera-says mono"></p><p class="camera-also hint"></p>'
        '<p class="camera-off mono"></p><p class="camera-doing" role="status"></p>'
        + (_PROFILE_HTML if profile else "")
        + "</div>"
    )


# ---- what is told

_PROFILE = 160  # The brightness of a row is told in at most so many points.

Of = TypeVar("Of", bound=LiveView, covariant=True)


class CameraView(Generic[Of]):
    """One camera on pages: a LiveCamera, or the view of a loop's camera.

    scale: the camera's if it is known, else the saved one is looked up.
    target: where the spot should be, px. doing: what is being done about it, in a line. Any thread sets them.
    """

    def __init__(self, live: Of, scale: Scale | None = None) -> None:
        self._live = live
        self.target: tuple[float, float] | None = None
        self.doing = ""
        self._given = scale
        self._known: tuple[Size, Optics, str] | None = None

    @property
    def live(self) -> Of:
        """The camera."""
        return self._live

    @property
    def optics(self) -> Optics:
        """The scale for the picture's present size."""
        return self._looked_up()[1]

    def told(self, seen: Seen | None, now_s: float, *, profile: bool = False) -> dict[str, Any]:
        """What is known now. seen: the image that is shown with it. now_s: of time.monotonic."""
        trouble = self.live.trouble
        told: dict[str, Any] = {"name": self.live.name, "trouble": trouble, "doing": self.doing, "target": self.target}
        if seen is None:
            return told
        size, optics, note = self._looked_up()
        told |= {"n": seen.number, "age": round(now_s - seen.at_s, 2), "size": size, "note": note}
        told |= {"unit": self._unit(optics), "says": _says(seen.found), "also": _also(seen)}
        detection = seen.found.detection
        told["blobs"] = [_rounded(b.x, b.y, b.width_x, b.width_y) for b in detection.blobs] if detection else []
        if isinstance(seen.found, Spot):
            spot = seen.found
            told["spot"] = _rounded(spot.x, spot.y, spot.width, spot.height)
            told["off"] = self._off(spot, optics)
        if profile:
            advised = advice(seen.frame, seen.found)
            told |= {"profile": _profile(seen), "exposure": advised and f"exposure: {advised.words}"}
            if isinstance(seen.found, Spot):
                told["cuts"] = [_cut(cut) for cut in cuts(seen.frame.image, seen.found)]
        return told

    def _looked_up(self) -> tuple[Size, Optics, str]:
        size = self.live.size
        known = self._known
        if known is None or known[0] != size:
            scale, note = self._given, ""
            if scale is not None and Size(scale.width, scale.height) != size:
                scale, note = None, "the scale is of another size of the picture: pixels are shown"
            elif scale is None:
                try:
                    scale = camera_scale.read(cast(Camera, self.live))
                except (NotCalibrated, BadFile) as e:
                    note = f"in pixels: {e}"
            known = self._known = size, Optics(scale), note
        return known

    @staticmethod
    def _unit(optics: Optics) -> tuple[float, str]:
        """The length of a pixel in the best unit that is known."""
        pixel = optics.shown(Estimate(1.0, 0.0, "px"))
        return pixel.value, pixel.unit.replace("urad", "µrad")

    def _off(self, spot: Spot, optics: Optics) -> str:
        """How far the spot is from the target, in the units that are known."""
        if self.target is None:
            return ""
        parts = []
        for px, sigma, ways in (
            (spot.x - self.target[0], spot.sigma_x, ("right", "left")),
            (spot.y - self.target[1], spot.sigma_y, ("below", "above")),
        ):
            shift = Estimate(abs(px), sigma, "px")
            length, angle = optics.mm(shift), optics.beam_urad(shift)
            parts.append(f"{ways[px < 0]} {_length(length) if length else shift}" + (f" ({angle})" if angle else ""))
        of_beam = "; angles are of the beam" if optics.distance_mm else ""
        return f"from the target: {', '.join(parts)}{of_beam}".replace("urad", "µrad")


def _length(mm: Estimate) -> str:
    return str(mm if mm.value >= 1 else mm.scaled(1000, "µm"))


def _says(found: Spot | NoSpot) -> str:
    if isinstance(found, NoSpot):
        return str(found)
    x, y = Estimate(found.x, found.sigma_x, "px"), Estimate(found.y, found.sigma_y, "px")
    return f"x {x}, y {y}"


def _also(seen: Seen) -> str:
    found = seen.found
    parts = []
    if isinstance(found, Spot):
        parts.append(f"D4-sigma {found.d4_long:.1f} x {found.d4_short:.1f} px at {found.angle:.0f}°")
        parts.append(f"peak {found.peak:.0f}")
        parts += [f"{found.saturated} pixels saturated"] if found.saturated else []
        parts.append(f"shape ± {found.shape_px:.2f} px")
    if found.detection:
        brightest = max((blob.peak for blob in found.detection.blobs), default=None)
        parts.append(f"threshold {found.detection.threshold:.1f} above the background")
        parts.append(f"noise {found.detection.noise:.2f}")
        parts += [f"brightest {brightest:.0f}"] if brightest is not None and not found else []
    return "; ".join([*parts, "late"] if seen.frame.late else parts)


def _cut(cut: Cut) -> dict[str, Any]:
    numbers = {name: _rounded(*getattr(cut, name)) for name in ("at", "light", "gaussian")}
    return {"angle": round(cut.angle), "sigma": round(cut.sigma, 2)} | numbers


def _profile(seen: Seen) -> dict[str, Any] | None:
    """Brightness along the row of the spot, or of the brightest place, and the threshold there."""
    image, found = seen.frame.image, seen.found
    rows, columns = image.shape
    if found.detection is None:
        return None
    if isinstance(found, Spot):
        row = found.y
    elif found.detection.blobs:
        row = found.detection.blobs[0].y
    else:
        row = float(np.unravel_index(int(np.argmax(image)), image.shape)[0])
    top = min(max(round(row) - 1, 0), rows - 3)
    every = -(-columns // _PROFILE)
    usable = columns - columns % every
    line = image[top : top + 3].astype(np.float32).mean(axis=0)
    level = found.detection.background_along(top + 1, columns) + found.detection.threshold
    thin = [np.round(a[:usable].reshape(-1, every).max(axis=1), 1).tolist() for a in (line, level)]
    return {"row": top + 1, "light": thin[0], "threshold": thin[1]}


def _rounded(*numbers: float) -> list[float]:
    return [round(float(number), 2) for number in numbers]


# ---- the pictures

_PICTURES = 5, 20  # Pictures of one page: at once, and in a second.
_WAIT_S = 1.0  # A request waits so long for a new picture; then it is answered without one.
_CHECK_S = 0.02  # between two checks for a new picture


def routes(views: Sequence["CameraView"], viewer: Callable[[Request], str | None]) -> APIRouter:
    """GET /camera/1?after=N: a newer picture than number N, as JPEG, with what is seen in it as JSON in X-Seen.

    204 without a picture if there is no newer one. viewer(): the name of the page that asks; None: it may not see.
    """
    router = APIRouter()
    rates = Rates(*_PICTURES)
    asking: set[str] = set()

    @router.get("/camera/{number}")
    async def picture(number: str, request: Request) -> Response:
        who = viewer(request)
        if who is None:
            return Response("this page may not see the camera: load it again", 403)
        view = next((view for at, view in enumerate(views, 1) if str(at) == number), None)
        if view is None:
            return Response("there is no such camera", 404)
        name = f"{who} {number}"
        if name in asking or not rates.of(name).take():
            return Response("one picture at a time", 429)
        asking.add(name)
        try:
            return await _next(view, _after(request), "profile" in request.query_params)
        finally:
            asking.discard(name)

    return router


def _after(request: Request) -> int:
    text = request.query_params.get("after", "0")
    return int(text) if re.fullmatch(r"[0-9]{1,12}", text) else 0


async def _next(view: "CameraView", after: int, profile: bool) -> Response:
    until_s = time.monotonic() + _WAIT_S
    while True:
        seen = view.live.last
        new = seen is not None and seen.number > after
        if new or time.monotonic() > until_s:
            break
        await asyncio.sleep(_CHECK_S)
    told = view.told(seen, time.monotonic(), profile=profile and new)
    headers = {"x-seen": json.dumps(told, separators=(",", ":")), "cache-control": "no-store"}
    if seen is None or not new:
        return Response(status_code=204, headers=headers)
    return Response(await asyncio.to_thread(view.live.jpeg, seen), media_type="image/jpeg", headers=headers)
