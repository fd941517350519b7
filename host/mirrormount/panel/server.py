"""The web server of the panel: NiceGUI on uvicorn, behind auth.py. Tracebacks go to a file."""

import socket
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import uvicorn
from fastapi import FastAPI, Request
from nicegui import app as gui
from nicegui import core, ui
from starlette.types import ASGIApp

from mirrormount.common.errors import CannotListen
from mirrormount.panel import camera_route, page
from mirrormount.panel.auth import Auth
from mirrormount.panel.log_file import log_to_file
from mirrormount.panel.mounts import Orders, PanelMount, find, stop_all
from mirrormount.panel.pages import Pages
from mirrormount.panel.sign_in import SignIn
from mirrormount.panel.socket import routes
from mirrormount.supervise.worker import Worker

if TYPE_CHECKING:
    from mirrormount.beam.live import LiveCamera
    from mirrormount.panel.camera_view import CameraView

_MESSAGE_MOST = 1 << 16  # bytes of a message of a socket


class Server(uvicorn.Server):
    """Serves until a signal ends it; the motors are stopped before the pages are closed."""

    def __init__(self, app: ASGIApp, mounts: Sequence[PanelMount]) -> None:
        super().__init__(
            uvicorn.Config(
                app,
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
            self._ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """As uvicorn's, after the pages."""
        # Before NiceGUI cancels its tasks: asyncio.wait_for() of Python 3.11 loses a cancellation that comes together
        # with the awaited event, and a page's outbox that had an update then goes on until its page is deleted.
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
    orders = Orders()
    if view:
        from mirrormount.panel.spot_moves import SpotMoves

        moves = SpotMoves(next(iter(workers.values())), view)
        orders = Orders({"place": moves.place, "learn": moves.learn}, moves.give_way)
        app.include_router(camera_route.routes([view], lambda request: _viewer(mounts, request)))
    mounts = [
        PanelMount(name if len(workers) > 1 else "", worker, Pages(worker.lease), Orders() if number else orders)
        for number, (name, worker) in enumerate(workers.items())
    ]
    app.include_router(routes(mounts, sign_in.key))
    page.register(mounts, link, view)

    def fault(error: Exception) -> None:
        stop_all(mounts, "the panel has a fault", tell=False)
        for mount in mounts:
            mount.worker.report(
                f"the panel has a fault ({type(error).__name__}); the motors were stopped", "PanelFault"
            )

    def fault_of_page(error: Exception) -> None:
        fault(error)
        ui.label("The panel has a fault; the motors were stopped. Load the page again.")

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
