"""The web servers: the panel's, and the small one of other pages. Both are behind auth.py.

The panel is NiceGUI on uvicorn. A page that drives no mount (a camera's, a loop's) is plain HTML and has no NiceGUI.
Tracebacks go to a log file; an error is one line on stderr.
"""

import logging
import logging.handlers
import math
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape
from typing import TYPE_CHECKING

import uvicorn
from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import HTMLResponse, Response
from nicegui import app as gui
from nicegui import core, ui
from platformdirs import user_log_path
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from mirrormount.errors import CannotListen
from mirrormount.supervise.worker import Worker
from mirrormount.terminal import printable
from mirrormount_panel import camera, page
from mirrormount_panel.auth import Auth, SignIn, same
from mirrormount_panel.connections import BoundedConnection
from mirrormount_panel.mounts import Orders, Pages, PanelMount, find, stop_all
from mirrormount_panel.page_moves import PageMoves
from mirrormount_panel.positions import Positions
from mirrormount_panel.socket import routes

if TYPE_CHECKING:
    from mirrormount_beam.live import LiveCamera
    from mirrormount_panel.camera import CameraView

# ---- the log

_LOG_MOST = 1 << 20  # The log has at most so many bytes, and one older file of this size is kept.


def log_to_file() -> None:
    """Log to a file, with tracebacks; an error is also one line on stderr."""
    path = user_log_path("mirrormount") / "panel.log"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        to_file = logging.handlers.RotatingFileHandler(path, maxBytes=_LOG_MOST, backupCount=1, encoding="utf-8")
        more = f"more in {path}"
    except OSError:  # no reason not to drive
        to_file = logging.NullHandler()
        more = f"more could not be written to {path}"
    to_file.setFormatter(_Printable("%(asctime)s %(name)s %(levelname)s: %(message)s"))
    to_screen = logging.StreamHandler()
    to_screen.setLevel(logging.ERROR)
    to_screen.setFormatter(_OneLine(more))
    root = logging.getLogger()
    root.handlers[:] = [to_file, to_screen]
    root.setLevel(logging.WARNING)
    for name in ("nicegui", "uvicorn", "uvicorn.error", "uvicorn.access", "asyncio"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
        logger.setLevel(logging.WARNING)


class _Printable(logging.Formatter):
    """Log lines without control characters."""

    def format(self, record: logging.LogRecord) -> str:
        return "\n".join(printable(line, 500) for line in super().format(record).splitlines())


class _OneLine(logging.Formatter):
    """One line for an error; the file has the traceback."""

    def __init__(self, more: str) -> None:
        super().__init__()
        self._more = more

    def format(self, record: logging.LogRecord) -> str:
        return f"mirrormount: {printable(str(record.getMessage()).partition(chr(10))[0])} ({self._more})"


# ---- a page without a mount


def light_page(title: str, body: str, *scripts: str) -> str:
    """A whole page. title is text, body is HTML, scripts are names of files in static/."""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{escape(title)}</title><link rel="icon" href="data:,"><link rel="stylesheet" href="/panel/panel.css">'
        '<script src="/panel/mode.js"></script>'
        + "".join(f'<script src="/panel/{name}" defer></script>' for name in ("light.js", *scripts))
        + f'</head><body class="light"><header class="top"><span class="brand">mirrormount</span>'
        f'<span class="board">{escape(title)}</span>{page.MODE_BUTTON}</header>{body}</body></html>'
    )


def may(sign_in: SignIn, request: Request) -> bool:
    """Whether a request shows the key that signing in has left in the page's own storage (auth.py)."""
    given = request.headers.get("x-key", "").encode("utf-8", "replace")
    return sign_in.key is None or same(given, sign_in.key.encode())


def make_light_server(
    html: str, views: "Sequence[CameraView]", sign_in: SignIn, more: Sequence[APIRouter] = ()
) -> uvicorn.Server:
    """A server of that page and of the pictures of its cameras. more: further routes, which ask may() themselves."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.mount("/panel", StaticFiles(directory=page.STATIC))

    @app.get("/")
    async def index() -> HTMLResponse:
        return HTMLResponse(html)

    def viewer(request: Request) -> str | None:
        client = request.client.host if request.client else "?"
        return f"{client} {request.headers.get('x-page', '')[:40]}" if may(sign_in, request) else None

    app.include_router(camera.routes(views, viewer))
    for router in more:
        app.include_router(router)
    return uvicorn.Server(
        uvicorn.Config(
            Auth(app, sign_in),
            http=BoundedConnection,
            log_config=None,
            timeout_graceful_shutdown=1,
            server_header=False,
            proxy_headers=False,
        )
    )


# ---- the panel

_TURN_S = 0.1  # between two turns of the server's loop; uvicorn's
_MESSAGE_MOST = 1 << 16  # No message of a socket has more bytes.


class Server(uvicorn.Server):
    """Serves until a signal ends it; the motors are stopped before the pages are closed."""

    def __init__(self, app: ASGIApp, mounts: Sequence[PanelMount]) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                http=BoundedConnection,
                log_config=None,
                lifespan="on",
                timeout_graceful_shutdown=1,
                ws_ping_interval=10,
                ws_max_size=_MESSAGE_MOST,
                server_header=False,
                proxy_headers=False,  # a client is known by its address alone: sign-ins are slowed down by it
            )
        )
        self._mounts = mounts
        self._ready: Callable[[], object] = lambda: None
        self._turned_s = math.inf  # when its loop has last turned; while that is not served yet, or no more: never late
        for mount in mounts:
            mount.worker.ways.append(partial(self._why_stuck, mount.worker.lease.patience_s))

    def when_ready(self, action: Callable[[], object]) -> None:
        """Call it when the first page can be loaded."""
        self._ready = action

    def run(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve. Returns when told to end. Raises CannotListen, KeyboardInterrupt."""
        super().run(sockets)
        if not self.started:
            raise CannotListen("the panel's web server did not start")

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """As uvicorn's."""
        await super().startup(sockets)
        if self.started:
            self._turned_s = time.monotonic()  # a loop that hangs before its first turn is stuck, too
            self._ready()

    async def on_tick(self, counter: int) -> bool:
        """As uvicorn's, ten times a second."""
        self._turned_s = time.monotonic()
        return await super().on_tick(counter)

    def _why_stuck(self, patience_s: float) -> str:
        """Why no page's stop gets in; "" if it does."""
        if time.monotonic() - self._turned_s <= patience_s + _TURN_S:
            return ""
        return f"the panel's web server hangs (for more than {patience_s:g} s)"

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """As uvicorn's, after the pages."""
        # Before NiceGUI cancels its tasks: asyncio.wait_for() of Python 3.11 loses a cancellation that comes together
        # with the awaited event, and a page's outbox that had an update then goes on until its page is deleted.
        self._turned_s = math.inf
        for mount in self._mounts:
            mount.pages.close()
        await super().shutdown(sockets)

    def handle_exit(self, sig: int, frame: object) -> None:
        """As uvicorn's, after a stop."""
        stop_all(self._mounts, "the panel is being ended", tell=False)
        super().handle_exit(sig, frame)  # type: ignore[arg-type]


def make_server(
    workers: Mapping[str, Worker],
    sign_in: SignIn,
    link: Callable[[], str] | None,
    view: "CameraView[LiveCamera] | None" = None,
) -> Server:
    """The panel of one or more mounts. workers: by the mounts' names.

    link(): a new link for a phone, if the panel is open to the network. view: a camera whose spot the first one moves.
    """
    log_to_file()
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    mounts: list[PanelMount] = []
    kept: list[Positions] = []
    for number, (name, worker) in enumerate(workers.items()):
        moves = PageMoves(worker)
        orders, spots = {}, None
        if view and number == 0:
            from mirrormount_panel.spot_moves import SpotMoves

            spots = SpotMoves(worker, view, moves)
            orders = {"place": spots.place, "learn": spots.learn}
        kept.append(Positions(worker, moves, spots))
        all_orders = Orders({**orders, "back": kept[-1].back}, moves.give_way)
        mounts.append(PanelMount(name if len(workers) > 1 else "", worker, Pages(worker.lease), all_orders))
    if view:
        app.include_router(camera.routes([view], lambda request: _viewer(mounts, request)))
    app.include_router(routes(mounts, sign_in.key))
    page.register(mounts, kept, link, view)

    def fault(error: Exception) -> None:
        stop_all(mounts, "the panel has a fault", tell=False)
        for mount in mounts:
            mount.worker.report(
                f"the panel has a fault ({type(error).__name__}); the motors were stopped", "PanelFault"
            )

    def fault_of_page(error: Exception) -> None:
        fault(error)
        ui.label("The panel has a fault; the motors were stopped. Load the page again.")

    async def nothing(_request: Request, _error: Exception) -> Response:
        return Response("The panel has no such page.", 404)  # NiceGUI would build a page for each

    gui.add_exception_handler(404, nothing)
    gui.on_exception(fault)
    gui.on_page_exception(fault_of_page)
    ui.run_with(app, title="Mirror mount", dark=None, tailwind=False, show_welcome_message=False, favicon="🎯")
    core.app.config.message_history_length = 0  # what was sent to a page that was away is not true any more
    core.sio.on("log", lambda _sid, _message: None)  # what a page would write to this program's log
    return Server(Auth(app, sign_in), mounts)


def _viewer(mounts: Sequence[PanelMount], request: Request) -> str | None:
    """The page that asks for a picture, by its own key; None if it is not connected: it has shown no key then."""
    found = find(mounts, request.headers.get("x-page", ""))
    return found[1].name if found and found[1].connected else None
