"""Who may come in: an ASGI layer in front of everything else, sockets included.

On the loopback interface any program of this computer may. A page of another site, open in the same browser, may
not: it is told by the Origin that browsers send, and one that hides behind a name of its own by the Host.
On a wider network it takes the token, once, in the link; from then on a cookie made from it stands for it.
"""

import hashlib
import hmac
from urllib.parse import parse_qs, urlsplit

from starlette.types import ASGIApp, Receive, Scope, Send

_COOKIE = "mirrormount_panel"
_LOOPBACK = {"localhost", "127.0.0.1", "::1"}
_PAGE = """<!doctype html><meta charset=utf-8><meta name=viewport content="width=device-width">
<title>mirrormount</title><body style="font:18px system-ui;max-width:32em;margin:12vh auto;padding:0 1em">
<h1 style="font-size:1.3em">This panel is not open to you</h1><p>{}</p>"""
_NO_TOKEN = (
    "It needs the link with its token. Take the whole link, or the QR code, that"
    " <code>mirrormount panel</code> printed where it was started."
)
_FOREIGN = "It can be used from its own address only, not through another site or name."


class Guard:
    """Lets requests through to app, or answers 403. token None: loopback only."""

    def __init__(self, app: ASGIApp, token: bytes | None) -> None:
        self._app = app
        self._token = token
        self._pass = None if token is None else hashlib.sha256(b"mirrormount panel " + token).hexdigest().encode()
        # a name of its own: browsers keep one jar for all ports of a computer, and it may have two panels
        self._name = f"{_COOKIE}_{hashlib.sha256(b'name ' + (token or b'')).hexdigest()[:8]}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI's call."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        if self._foreign(headers):
            await _refuse(scope, receive, send, _FOREIGN)
        elif self._token is None or self._pass is None or _same(_cookie(headers, self._name), self._pass):
            await self._app(scope, receive, send)
        elif scope["type"] == "http" and _same(_of_link(scope), self._token):
            await _come_in(send, self._name, self._pass)
        else:
            await _refuse(scope, receive, send, _NO_TOKEN)

    def _foreign(self, headers: dict[bytes, str]) -> bool:
        host = headers.get(b"host", "")
        origin = headers.get(b"origin")
        try:
            if self._token is None and urlsplit("//" + host).hostname not in _LOOPBACK:
                return True
            return origin is not None and urlsplit(origin).netloc != host
        except ValueError:  # no address at all
            return True


def _same(given: str | None, token: bytes) -> bool:
    return given is not None and hmac.compare_digest(given.encode(), token)


def _of_link(scope: Scope) -> str | None:
    values = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
    return values[0] if values else None


def _cookie(headers: dict[bytes, str], name: str) -> str | None:
    """The value of that cookie. Not by http.cookies: that gives up at another program's cookie that it dislikes."""
    pairs = (pair.strip().partition("=") for pair in headers.get(b"cookie", "").split(";"))
    return next((value for key, _, value in pairs if key == name), None)


async def _come_in(send: Send, name: str, passed: bytes) -> None:
    """Give the cookie, and show the page under an address without the token."""
    cookie = name.encode() + b"=" + passed + b"; Path=/; HttpOnly; SameSite=Lax; Max-Age=2592000"
    headers = [(b"location", b"/"), (b"set-cookie", cookie), (b"cache-control", b"no-store")]
    await send({"type": "http.response.start", "status": 303, "headers": headers})
    await send({"type": "http.response.body", "body": b""})


async def _refuse(scope: Scope, receive: Receive, send: Send, why: str) -> None:
    if scope["type"] == "websocket":
        await receive()  # the connection's request; refused before it is accepted, it is answered with 403
        await send({"type": "websocket.close", "code": 4403})
        return
    headers = [(b"content-type", b"text/html; charset=utf-8"), (b"cache-control", b"no-store")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": _PAGE.format(why).encode()})
