"""The route of a camera's pictures: a page asks for the next one when it has drawn the last, so none ever waits."""

import asyncio
import json
import re
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from fastapi import APIRouter, Request, Response

from mirrormount.panel.rates import Rates

if TYPE_CHECKING:
    from mirrormount.panel.camera_view import CameraView

_PICTURES = 5, 20  # of one page: at once, a second
_WAIT_S = 1.0  # for a new picture; then only what is known is sent
_LOOK_S = 0.02


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
        if name in asking or not rates.take(name):
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
        await asyncio.sleep(_LOOK_S)
    told = view.told(seen, time.monotonic(), profile=profile and new)
    headers = {"x-seen": json.dumps(told, separators=(",", ":")), "cache-control": "no-store"}
    if seen is None or not new:
        return Response(status_code=204, headers=headers)
    return Response(await asyncio.to_thread(view.live.jpeg, seen), media_type="image/jpeg", headers=headers)
