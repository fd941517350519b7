"""Refuses requests that are not allowed, and adds security headers to every reply: an ASGI layer around all others.

On the loopback interface any program of this computer may come in. A page of another site, open in the same browser,
may not: browsers name it by Origin and Sec-Fetch-Site, and one that hides behind a name of its own is known by Host.
On a wider network it takes a sign-in (sign_in.py); a cookie stands for it. No page may frame the panel.
"""

import asyncio
import ipaddress
import re
import secrets
from urllib.parse import urlsplit

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mirrormount.panel.rates import Rate, Rates
from mirrormount.panel.sign_in import SignIn
from mirrormount.panel.tokens import same

FLOOD = 4429  # a close code: too many messages
_MESSAGES = 200, 100  # of one socket: at once, a second. A page sends about 25 a second
_PAGES = 6, 0.5  # of one client: at once, a second. To build one takes 30 ms
_POST_MOST = 512  # bytes of a sign-in
_PATHS = re.compile(r"/(?:enter|stop|drive|camera/[1-9]|hold/state|hold/go|panel/[\w.]+|_nicegui/.*|_nicegui_ws/.*)?")
_MESSAGE = """<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width">
<meta name=color-scheme content="light dark"><title>mirrormount</title>
<body style="font:18px system-ui;max-width:32em;margin:12vh auto;padding:0 1em"><p>{}</p>"""
_FOREIGN = "The panel can be used from its own address only, not through another site or name."
_NO_TOKEN = "The panel needs a token: open its first page."
_CROWD = "Too many pages were opened at once: wait a few seconds, then load this page again."
_NOTHING = "The panel has no such page."

_Headers = list[tuple[bytes, bytes]]


class Auth:
    """Passes requests on to app, or refuses them."""

    def __init__(self, app: ASGIApp, sign_in: SignIn) -> None:
        self._app = app
        self._sign_in = sign_in
        self._pages = Rates(*_PAGES)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI's call."""
        if scope["type"] == "websocket":
            await self._socket(scope, receive, send)
        elif scope["type"] == "http":
            await self._request(scope, receive, _Hardened(scope, send))
        else:
            await self._app(scope, receive, send)

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        if self._foreign(scope) or not self._signed_in(scope):
            await receive()  # the connection's request; refused before it is accepted, it is answered with 403
            await send({"type": "websocket.close", "code": 4403})
            return
        await self._app(scope, _bounded(receive, send), send)

    async def _request(self, scope: Scope, receive: Receive, send: "_Hardened") -> None:
        path = scope["path"]
        if self._foreign(scope):
            await send.page(403, _FOREIGN)
        elif not _PATHS.fullmatch(path):  # here, and not in a library, which writes the address to its log
            await send.page(404, _NOTHING)
        elif path == "/enter":
            await self._enter(scope, receive, send)
        elif not self._signed_in(scope):
            await (send.html(403, self._sign_in.page(send.nonce)) if path == "/" else send.page(403, _NO_TOKEN))
        elif path == "/" and scope["query_string"]:  # nothing of ours; the address bar is to be clean
            await send.answer(303, b"", [(b"location", b"/")])
        elif path == "/" and not self._pages.take(_client(scope)):
            await send.answer(429, _MESSAGE.format(_CROWD).encode(), [(b"retry-after", b"3"), _HTML])
        else:
            headers = [h for h in scope["headers"] if path != "/" or h[0] != b"accept-encoding"]  # see _Hardened
            await self._app({**scope, "headers": headers}, receive, send)

    async def _enter(self, scope: Scope, receive: Receive, send: "_Hardened") -> None:
        if self._sign_in.token is None:
            await send.answer(303, b"", [(b"location", b"/")])
        elif scope["method"] != "POST":
            await send.html(200, self._sign_in.page(send.nonce))
        else:
            answer = self._sign_in.judge(_client(scope), await _body(receive))
            headers = [(b"content-type", b"text/plain; charset=utf-8")]
            if answer.key is not None:
                name, value = self._sign_in.cookie_name.encode(), self._sign_in.cookie
                cookie = name + b"=" + value + b"; Path=/; HttpOnly; SameSite=Lax; Max-Age=2592000"
                headers.append((b"set-cookie", cookie))
            await send.answer(answer.status, answer.text.encode(), headers)

    def _signed_in(self, scope: Scope) -> bool:
        sign_in = self._sign_in
        return sign_in.token is None or same(_cookie(scope, sign_in.cookie_name), sign_in.cookie)

    def _foreign(self, scope: Scope) -> bool:
        """True if it comes from a page of another origin, or by another name of this computer."""
        host = _header(scope, b"host") or ""
        origin = _header(scope, b"origin")
        try:
            if self._sign_in.token is None and not _is_loopback(urlsplit("//" + host).hostname or ""):
                return True
            if origin is not None and urlsplit(origin).netloc != host:
                return True
        except ValueError:  # no address at all
            return True
        return _header(scope, b"sec-fetch-site") not in (None, "same-origin", "none") and not _is_visit(scope)


def _is_visit(scope: Scope) -> bool:
    """True for a link to the panel that was followed: a whole page in a tab of its own."""
    return (
        scope["type"] == "http"
        and scope["method"] == "GET"
        and scope["path"] in ("/", "/enter")
        and _header(scope, b"sec-fetch-mode") == "navigate"
        and _header(scope, b"sec-fetch-dest") == "document"
    )


def _is_loopback(host: str) -> bool:
    """True for a loopback address and localhost; any other name may be another site's."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _client(scope: Scope) -> str:
    return scope["client"][0] if scope.get("client") else "?"


def _header(scope: Scope, name: bytes) -> str | None:
    return next((value.decode("latin-1") for key, value in scope["headers"] if key == name), None)


def _cookie(scope: Scope, name: str) -> bytes:
    """The value of that cookie, b"" without it. http.cookies stops at a malformed cookie of another program."""
    pairs = (pair.strip().partition("=") for pair in (_header(scope, b"cookie") or "").split(";"))
    return next((value.encode() for key, _, value in pairs if key == name), b"")


async def _body(receive: Receive) -> bytes:
    """The posted bytes, at most one more than a sign-in may have."""
    body, more = b"", True
    while more and len(body) <= _POST_MOST:
        message = await receive()
        body += message.get("body", b"")
        more = message.get("more_body", False)
    return body[: _POST_MOST + 1]


def _bounded(receive: Receive, send: Send) -> Receive:
    """The messages of one socket, which is closed after too many. Between two of them other tasks run."""
    rate = Rate(*_MESSAGES)

    async def bounded() -> Message:
        message = await receive()
        if message["type"] == "websocket.receive":
            if not rate.take():
                await send({"type": "websocket.close", "code": FLOOD})
                return {"type": "websocket.disconnect", "code": FLOOD}
            await asyncio.sleep(0)
        return message

    return bounded


_HTML = (b"content-type", b"text/html; charset=utf-8")


class _Hardened:
    """A send() that adds security headers to every reply, and a nonce to the page's own scripts."""

    def __init__(self, scope: Scope, send: Send) -> None:
        self._send = send
        self._is_page = scope["path"] == "/"
        self._start: Message | None = None
        self._body = b""
        self.nonce = secrets.token_urlsafe(16)
        host = _header(scope, b"host") or ""
        self._sockets = f" ws://{host} wss://{host}" if re.fullmatch(r"[\w.:\[\]-]+", host) else ""

    async def __call__(self, message: Message) -> None:
        """ASGI's send. A page is buffered until it is complete: its scripts get the nonce."""
        if message["type"] == "http.response.start":
            message = {**message, "headers": self._headers(message.get("headers", []))}
            if self._is_page:
                self._start = message
                return
        elif self._start is not None:
            self._body += message.get("body", b"")
            if message.get("more_body"):
                return
            html = self._body.replace(b"<script", b'<script nonce="%s"' % self.nonce.encode())
            headers = [h for h in self._start["headers"] if h[0].lower() != b"content-length"]
            await self._send({**self._start, "headers": [*headers, (b"content-length", str(len(html)).encode())]})
            message = {"type": "http.response.body", "body": html}
        await self._send(message)

    async def page(self, status: int, text: str) -> None:
        """Send a page of one sentence."""
        await self.html(status, _MESSAGE.format(text))

    async def html(self, status: int, html: str) -> None:
        """Send an HTML page."""
        await self.answer(status, html.encode(), [_HTML])

    async def answer(self, status: int, body: bytes, headers: _Headers) -> None:
        """Send a reply, which the browser does not cache."""
        headers = [*headers, (b"cache-control", b"no-store"), (b"content-length", str(len(body)).encode())]
        await self._send({"type": "http.response.start", "status": status, "headers": self._headers(headers)})
        await self._send({"type": "http.response.body", "body": body})

    def _headers(self, headers: _Headers) -> _Headers:
        policy = (
            "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; img-src 'self' data:;"
            f" font-src 'self'; connect-src 'self'{self._sockets}; style-src 'self' 'unsafe-inline';"
            f" script-src 'self' 'nonce-{self.nonce}' 'unsafe-eval'"  # NiceGUI's handlers are evaluated in the page
        )
        return [
            *headers,
            (b"content-security-policy", policy.encode("latin-1")),
            (b"x-frame-options", b"DENY"),
            (b"cross-origin-opener-policy", b"same-origin"),
            (b"cross-origin-resource-policy", b"same-origin"),
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
        ]
