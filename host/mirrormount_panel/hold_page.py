"""The page of a loop that holds the beam: pictures, errors, history, HOLD and STOP, alarms. Drawn by static/hold.js.

HoldBoard keeps what the loop has told: listen() takes events in the loop's thread, told() is called in the web
server's. A loop belongs to nobody's page: it goes on when the page is closed. STOP needs no key and no tick, HOLD needs
both.
"""

import argparse
import asyncio
import contextlib
import json
import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import uvicorn
from fastapi import APIRouter, Request, Response

from mirrormount.errors import MountError, NotInControl
from mirrormount_beam.control import events
from mirrormount_beam.control.events import Pair, SpotMissed, SpotSeen
from mirrormount_beam.control.hold import Hold
from mirrormount_beam.control.interfaces import LoopTable
from mirrormount_beam.scale import Scale
from mirrormount_beam.table import TargetCamera
from mirrormount_panel.auth import SignIn
from mirrormount_panel.camera import CameraView, camera_html
from mirrormount_panel.cli import opened
from mirrormount_panel.server import light_page, log_to_file, make_light_server, may

# ---- what the loop has told

ALARM, WARN, CALM = "alarm", "warn", ""
_KEPT = 1200  # So many observations are kept in the history.
_EVERY_S = 0.5  # The time between two of them: the history has ten minutes.
_RMS_S = 60.0  # The scatter is told over this time.
_LAST = 6  # So many corrections and interlocks are told in words.


class HoldBoard:
    """The last state of one loop. um_per_px: of each camera, for the errors of its spot."""

    def __init__(
        self, um_per_px: Mapping[str, Pair] | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._um_per_px = dict(um_per_px or {})
        self._clock = clock
        self._lock = threading.Lock()
        self._state, self._why = "", "the loop has not begun"
        self._tripped: events.InterlockTripped | None = None
        self._progress: events.Progress | None = None
        self._seen: events.Observed | None = None
        self._heard_s: float | None = None
        self._history: deque[dict[str, Any]] = deque(maxlen=_KEPT)
        self._kept_s = -math.inf
        self._estimate: events.Estimated | None = None  # the last one, unless an interlock has tripped since
        self._recent: deque[tuple[float, ...]] = deque()  # time, seconds; times these: squares of um, of urad x and y
        self._number = -1  # of the last correction
        self._counts = {"corrections": 0, "pulses": 0, "reversals": 0, "interlocks": 0}
        self._news: deque[str] = deque(maxlen=_LAST)

    def listen(self, event: events.Event) -> None:
        """Take an event of the loop."""
        with self._lock:
            self._heard_s = self._clock()
            match event:
                case events.Observed():
                    self._observed(event)
                case events.Estimated():
                    self._estimated(event)
                case events.Pulsed():
                    self._counts["pulses"] += 1
                case events.Corrected():
                    self._counts["corrections"] += event.number != self._number  # a creep is told pulse by pulse
                    self._number = event.number
                    self._counts["reversals"] += len(event.reversals)
                    self._news.append(_correction(event))
                case events.StateChanged():
                    self._state, self._why = event.state, event.why
                    self._progress = None
                case events.InterlockTripped():
                    self._counts["interlocks"] += 1
                    self._estimate = None
                    self._tripped = event  # the last one is the one that has to be cleared
                    self._news.append(f"interlock {event.number}, {event.name}: {event.cause}")
                case events.InterlockCleared():
                    self._tripped = None
                    self._news.append(f"interlock {event.number}, {event.name}: cleared")
                case events.Progress():
                    self._progress = event
                case _:
                    pass

    def _observed(self, seen: events.Observed) -> None:
        self._seen = seen
        while self._recent and self._recent[0][0] < seen.time_s - _RMS_S:
            self._recent.popleft()
        if seen.time_s - self._kept_s >= _EVERY_S:
            self._kept_s = seen.time_s
            off = [spot.error_um if isinstance(spot, SpotSeen) else None for spot in seen.spots]
            self._history.append({"t": round(seen.time_s, 2), "off": off, "free": seen.free_um})

    def _estimated(self, estimate: events.Estimated) -> None:
        """The one before has counted until now, as in ErrorStatistics."""
        if before := self._estimate:
            seconds = estimate.time_s - before.time_s
            um = max(abs(each) for pair in before.errors_um.values() for each in pair)
            x, y = before.angle_urad or (math.nan, math.nan)
            self._recent.append((estimate.time_s, seconds, seconds * um**2, seconds * x**2, seconds * y**2))
        self._estimate = estimate

    @property
    def alert(self) -> str:
        """ALARM: a person has to act. WARN: an interlock has tripped that may clear itself. CALM: neither."""
        tripped = self._tripped
        if self._state == events.STOPPED or (tripped and not tripped.clears_itself):
            return ALARM
        return WARN if self._state == events.WAITING or tripped else CALM

    def told(self, after_s: float = -math.inf) -> dict[str, Any]:
        """All that a page shows, as JSON. after_s: of the history only what is later, on the loop's clock."""
        with self._lock:
            now_s = self._clock()
            seen, tripped = self._seen, self._tripped
            return {
                "state": self._state,
                "why": self._why,
                "alert": self.alert,
                "silent_s": None if self._heard_s is None else round(now_s - self._heard_s, 1),
                "progress": [self._progress.done, self._progress.what] if self._progress else None,
                "interlocks": [[tripped.name, tripped.cause, tripped.remedy, tripped.clears_itself]] if tripped else [],
                "cameras": [self._camera(spot, at) for at, spot in enumerate(seen.spots)] if seen else [],
                "angle": _rounded(seen.angle_urad) if seen and seen.angle_urad else None,
                "rms": self._rms(),
                "counts": dict(self._counts),
                "news": list(self._news)[::-1],
                "history": [point for point in self._history if point["t"] > after_s],
            }

    def _camera(self, spot: SpotSeen | SpotMissed, at: int) -> dict[str, Any]:
        free = self._seen.free_um if self._seen else ()
        told: dict[str, Any] = {"name": spot.camera, "free": _rounded(free[at]) if at < len(free) else None}
        if isinstance(spot, SpotMissed):
            return told | {"missed": spot.reason}
        per_px = self._um_per_px.get(spot.camera)
        sigma = _rounded((spot.sigma_px[0] * per_px[0], spot.sigma_px[1] * per_px[1])) if per_px else None
        return told | {"off": _rounded(spot.error_um), "sigma": sigma}

    def _rms(self) -> dict[str, float | None]:
        """Over the last minute: of the worst error along an axis in any camera, and of the beam's angle (x or y)."""
        _, seconds, *squares = (sum(part) for part in zip(*self._recent, strict=True)) if self._recent else (0.0, 0.0)
        if not seconds:
            return {"um": None, "urad": None}
        um, x, y = (math.sqrt(square / seconds) for square in squares)
        return {"um": _known(um), "urad": _known(max(x, y))}


def _correction(event: events.Corrected) -> str:
    steps = ", ".join(f"{name} {steps:+.3f}" for name, steps in event.steps.items() if steps).replace("-", "−")
    before, after = (max(map(abs, um), default=0.0) for um in (event.before_um, event.after_um))
    return f"correction {event.number}: {steps or 'nothing'} steps; worst error {before:.0f} → {after:.0f} µm"


def _known(number: float) -> float | None:
    return round(number, 1) if math.isfinite(number) else None


def _rounded(pair: Pair) -> list[float | None]:
    return [_known(number) for number in pair]


# ---- the server

# An order to hold is refused if the page has seen no younger state: it was pressed that long ago, and the network was
# stuck.
_LATE_MS = 2000
_BODY_MOST = 100  # An order is no longer, in bytes.
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
<footer class="bottom"><button class="stop" type="button" data-stop aria-label="STOP all motors (Space, or Escape)">
<span>STOP</span><span class="key">Space · Esc</span></button></footer>"""
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
        _PICTURE.format(name=view.live.name, html=camera_html(at, view.live.name), at=at - 1)
        for at, view in enumerate(views, 1)
    )
    text = light_page("hold the beam", _BODY.format(pictures=pictures), "camera.js", "hold.js")
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


# ---- the page of `mirrormount hold --page`


class HoldPage:
    """board: takes the loop's events. hold: what HOLD tells to go on.

    halt(): stops all mounts from any thread, and ends the loop's control; None: only the loop itself can.
    """

    def __init__(self, table: LoopTable, halt: Callable[[], object] | None) -> None:
        self.board = HoldBoard({camera.name: camera.um_per_px for camera in table.cameras})
        self.hold: Hold | None = None
        self._halt = halt

    def go(self) -> None:
        """HOLD was pressed. Raises NotInControl."""
        if self.hold is None:
            raise NotInControl("nothing was done: the loop has not begun to hold the beam; wait until it holds")
        self.hold.go_on()

    def stop(self) -> None:
        """STOP was pressed. Raises NotInControl."""
        if self._halt:
            self._halt()
        elif self.hold:
            self.hold.stop()
        else:
            raise NotInControl("this virtual table is stopped by Ctrl-C until it holds the beam")


@contextlib.contextmanager
def served(args: argparse.Namespace, table: LoopTable, halt: Callable[[], object] | None) -> Iterator[HoldPage]:
    """Serve the page of a loop on this table. Raises BadValue, BadAddress, CannotListen."""
    page = HoldPage(table, halt)
    with opened(args) as opening, contextlib.ExitStack() as kept:
        log_to_file()
        server = make_hold_server(table.cameras, page.board, opening.sign_in, go=page.go, stop=page.stop)
        thread = threading.Thread(target=server.run, args=([opening.listener],), name="page", daemon=True)
        thread.start()
        opening.tell("the loop's page", "can stop the loop, and tell it to go on")
        if args.browser:
            opening.browser(kept)()
        try:
            yield page
        finally:
            server.should_exit = True
            thread.join(5)
