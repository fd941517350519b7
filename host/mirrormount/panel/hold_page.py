"""The page of a loop that holds a beam: pictures, errors, history, HOLD and STOP, alarms. Drawn by static/hold.js.

A loop belongs to nobody's page: it goes on when the page is closed. STOP needs no key and no tick, HOLD needs both.
"""

import asyncio
import json
import math
import re
import time
from collections.abc import Callable, Sequence

import uvicorn
from fastapi import APIRouter, Request, Response

from mirrormount.beam.scale import Scale
from mirrormount.beam.table import TargetCamera
from mirrormount.common.errors import MountError
from mirrormount.panel.camera_html import html
from mirrormount.panel.camera_view import CameraView
from mirrormount.panel.hold_board import HoldBoard
from mirrormount.panel.light_server import make_light_server, may, page
from mirrormount.panel.sign_in import SignIn

_LATE_MS = 2000  # an order to hold that has seen no younger state is not carried out
_BODY_MOST = 100  # bytes of an order
_LATE = "nothing was done: that came late, the network or this browser was stuck; press HOLD again"
_BODY = """<main class="hold"><section class="card state" aria-live="polite"><p class="hold-state"></p>
<p class="hold-why"></p><div class="hold-gates" role="alert"></div><div class="line"><button class="go" type="button"
 data-go>HOLD</button><button class="quiet" type="button" data-quiet>Sound: press to switch on</button></div>
<p class="hold-refused" role="alert"></p></section>
<div class="pictures">{pictures}</div>
<section class="card"><h2 class="title">Error over time</h2>
<canvas class="history" role="img" aria-label="Error of each camera over the last ten minutes, and without the loop"
></canvas><p class="hint">Full line: the error along x and y together. Broken line: what it would be if nothing had been
moved since the loop began, estimated from the pulses. The colours are those beside the cameras' errors. Each
line of the grid is ten times as far as the one below.</p></section>
<section class="card"><h2 class="title">What it did</h2><p class="hold-counts mono"></p>
<div class="hold-news" role="log"></div></section></main>
<footer class="bottom"><button class="stop" type="button" data-stop aria-label="STOP all motors (Escape)">
<span>STOP</span><span class="key">Esc</span></button></footer>"""
_PICTURE = """<section class="card"><h2 class="title">{name}</h2>{html}<p class="hold-off mono" data-of="{at}"></p>
</section>"""


def make_hold_server(
    cameras: Sequence[TargetCamera],
    board: HoldBoard,
    sign_in: SignIn,
    *,
    go: Callable[[], object],
    stop: Callable[[], object],
    clock: Callable[[], float] = time.monotonic,
) -> uvicorn.Server:
    """The server of the page. go(), stop(): what HOLD and STOP do; any thread, must return soon; raise MountError."""
    views = [_view(camera) for camera in cameras]
    pictures = "".join(
        _PICTURE.format(name=view.live.name, html=html(at, view.live.name), at=at - 1)
        for at, view in enumerate(views, 1)
    )
    text = page("hold the beam", _BODY.format(pictures=pictures), "camera.js", "hold.js")
    return make_light_server(text, views, sign_in, [_routes(board, sign_in, go, stop, clock)])


def _view(camera: TargetCamera) -> CameraView:
    mm_per_px = math.sqrt(camera.um_per_px[0] * camera.um_per_px[1]) / 1000
    distance_mm = camera.distance_m * 1000 if camera.distance_m else None
    view = CameraView(camera.view, Scale(*camera.size, mm_per_px, 0.0, distance_mm))
    view.target = camera.target_px
    return view


def _routes(
    board: HoldBoard,
    sign_in: SignIn,
    go: Callable[[], object],
    stop: Callable[[], object],
    clock: Callable[[], float],
) -> APIRouter:
    router = APIRouter()

    @router.get("/hold/state")
    async def state(request: Request) -> Response:
        if not may(sign_in, request):
            return Response("sign in again", 403)
        after = request.query_params.get("after", "")
        told = board.told(float(after) if re.fullmatch(r"[0-9]{1,12}(\.[0-9]{1,3})?", after) else -math.inf)
        told["tick"] = int(clock() * 1000)
        return Response(json.dumps(told), media_type="application/json", headers={"cache-control": "no-store"})

    @router.post("/hold/go")
    async def hold(request: Request) -> Response:
        if not may(sign_in, request):
            return Response("sign in again", 403)
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > _BODY_MOST:
                return Response("that is no order", 400)
        if not re.fullmatch(rb"[0-9]{1,15}", body):
            return Response("that is no order", 400)
        if not -_LATE_MS < int(body) - int(clock() * 1000) <= 0:
            return Response(_LATE, 409)
        try:
            await asyncio.to_thread(go)
        except MountError as e:
            return Response(f"nothing was done: {e}", 409)
        return Response(status_code=204)

    @router.post("/stop")
    async def halt() -> Response:
        try:
            await asyncio.to_thread(stop)
        except MountError as e:
            return Response(str(e), 500)
        return Response(status_code=204)

    return router
