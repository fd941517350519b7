"""A web server of one page that drives no mount: cameras, and what a loop tells. Behind auth.py; without NiceGUI."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import uvicorn
from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import HTMLResponse
from starlette.staticfiles import StaticFiles

from mirrormount.panel import camera_route
from mirrormount.panel.auth import Auth
from mirrormount.panel.sign_in import SignIn
from mirrormount.panel.tokens import same

if TYPE_CHECKING:
    from mirrormount.panel.camera_view import CameraView

_STATIC = Path(__file__).parent / "static"


def page(title: str, body: str, *scripts: str) -> str:
    """A whole page. title is text, body is HTML, scripts are names of files in static/."""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{escape(title)}</title><link rel="icon" href="data:,"><link rel="stylesheet" href="/panel/panel.css">'
        + "".join(f'<script src="/panel/{name}" defer></script>' for name in ("light.js", *scripts))
        + f'</head><body class="light"><header class="top"><span class="brand">mirrormount</span>'
        f'<span class="board">{escape(title)}</span></header>{body}</body></html>'
    )


def may(sign_in: SignIn, request: Request) -> bool:
    """Whether a request shows the key that signing in has left in the page's own storage (sign_in.py)."""
    given = request.headers.get("x-key", "").encode("utf-8", "replace")
    return sign_in.key is None or same(given, sign_in.key.encode())


def make_light_server(
    html: str, views: "Sequence[CameraView]", sign_in: SignIn, more: Sequence[APIRouter] = ()
) -> uvicorn.Server:
    """A server of that page and of the pictures of its cameras. more: further routes, which ask may() themselves."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.mount("/panel", StaticFiles(directory=_STATIC))

    @app.get("/")
    async def index() -> HTMLResponse:
        return HTMLResponse(html)

    def viewer(request: Request) -> str | None:
        client = request.client.host if request.client else "?"
        return f"{client} {request.headers.get('x-page', '')[:40]}" if may(sign_in, request) else None

    app.include_router(camera_route.routes(views, viewer))
    for router in more:
        app.include_router(router)
    return uvicorn.Server(
        uvicorn.Config(
            Auth(app, sign_in), log_config=None, timeout_graceful_shutdown=1, server_header=False, proxy_headers=False
        )
    )
