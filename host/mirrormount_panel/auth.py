"""Who may load a page and drive: tokens, sign-in, limits of rates, and the layer around all requests.

On the loopback interface any program of this computer may come in. A page of another site, open in the same browser,
may not: browsers name it by Origin and Sec-Fetch-Site, and one that hides behind a name of its own is known by Host.
No page may frame the panel.

On a wider network a browser signs in, by a link with a one-time code or by the typed token. The code is in the link's
fragment (`/enter#CODE`). A browser sends no fragment to a server, so it is in no log and in no Referer. The page at
/enter takes it out of the address bar and posts it; the reply is a cookie, by which the panel may be looked at, and a
key, without which nothing moves. The page keeps the key in its own storage, which, unlike a cookie, belongs to one
port of one host. Whoever guesses at tokens is slowed down.
"""

import asyncio
import hashlib
import hmac
import ipaddress
import math
import os
import re
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mirrormount.errors import BadValue

# ---- limits of rates


class Rate:
    """At most `burst` events at once, and `per_s` a second over a long time."""

    def __init__(self, burst: float, per_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._burst = self._left = burst
        self._per_s = per_s
        self._clock = clock
        self._at_s = clock()

    def take(self) -> bool:
        """Count one event. False if it is above the rate."""
        return self.wait_s(0.0) == 0.0

    def wait_s(self, most_s: float) -> float:
        """Count one event, and return how long it has to wait for its turn; one that would have to for longer than
        most_s is not counted.
        """
        now_s = self._clock()
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s
        wait_s = max(0.0, (1 - self._left) / self._per_s)
        if wait_s <= most_s:
            self._left -= 1
        return wait_s


class Rates:
    """A Rate for each of the last `clients` clients."""

    def __init__(
        self, burst: float, per_s: float, clients: int = 256, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._new = lambda: Rate(burst, per_s, clock)
        self._clients = clients
        self._rates: OrderedDict[str, Rate] = OrderedDict()

    def of(self, client: str) -> Rate:
        """The rate of this client."""
        rate = self._rates.pop(client, None) or self._new()
        self._rates[client] = rate
        if len(self._rates) > self._clients:
            self._rates.popitem(last=False)
        return rate


# ---- tokens

LONGEST = 254  # A token has at most so many characters.
BITS = 128  # A token of so many random bits cannot be guessed by trying, however fast.
SHORT = f"the token can be guessed (less than {BITS} bits): take one of `secrets.token_urlsafe()`"

_FREE = 5  # So many wrong guesses of one address within _FORGET_S cost no time: people mistype.
_FORGET_S = 60.0
_PAUSE_S = 1.0  # Later guesses wait so long after the one before.
_ADDRESSES_MOST = 1000  # Guesses of so many addresses are remembered.
# Bits that a random token may seem to lack: of 128 bits as 22 characters of base64, one text in a hundred has no
# digit.
_UNSEEN = 3
_FEW = 8  # A token with fewer different characters is a pattern, however long.
_KINDS = ((str.islower, 26), (str.isupper, 26), (str.isdecimal, 10), (lambda c: not c.isalnum(), 33))


def read_token(given: str | None, file: Path | None = None) -> bytes | None:
    """The token as it goes over the wire: as given, else the first line of file, else $MIRRORMOUNT_TOKEN.

    None if there is none. Raises BadValue for one that cannot be a token.
    """
    if given is not None and file is not None:
        raise BadValue("--token and --token-file: give one of them")
    if file is not None:
        try:
            with file.open(encoding="ascii") as opened:
                given = opened.readline(LONGEST + 2).rstrip("\r\n")
        except (OSError, UnicodeDecodeError) as e:
            why = e.strerror if isinstance(e, OSError) else "not ASCII"
            raise BadValue(f"--token-file {file}: cannot be read: {why}") from e
    return check_token(given if given is not None else os.environ.get("MIRRORMOUNT_TOKEN") or None)


def check_token(token: str | None) -> bytes | None:
    """A token as it goes over the wire. Raises BadValue for one that cannot."""
    if token is None:
        return None
    if not (token.isascii() and token.isprintable() and token.strip() == token and 0 < len(token) <= LONGEST):
        raise BadValue(f"a token is 1 to {LONGEST} printable ASCII characters, with no space at either end")
    return token.encode()


def is_short(token: bytes | None) -> bool:
    """True if token, taken as random, holds less than BITS bits, but for _UNSEEN; or is a pattern of few characters."""
    if token is None:
        return False
    text = token.decode("ascii")
    alphabet = sum(size for belongs, size in _KINDS if any(belongs(c) for c in text))
    return len(text) * math.log2(alphabet) < BITS - _UNSEEN or len(set(text)) < _FEW


def same(given: bytes, token: bytes) -> bool:
    """Are they equal? Takes as long for any wrong one of that length."""
    return hmac.compare_digest(given, token)


class Guesses:
    """Slows down who tries tokens: five wrong ones a minute are free, then one a second for each address.

    An address is what the peer cannot choose freely: an IP address without its port.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._wrong: dict[str, list[float]] = {}  # when, the last ones

    def wait_s(self, address: str) -> float:
        """How long until a guess from address may be compared; 0: now."""
        wrong = self._wrong.get(address, [])
        now = self._clock()
        if len([at for at in wrong if now - at < _FORGET_S]) < _FREE:
            return 0.0
        return max(0.0, wrong[-1] + _PAUSE_S - now)

    def wrong(self, address: str) -> None:
        """A guess from address was compared, and was wrong."""
        wrong = self._wrong.pop(address, [])
        self._wrong[address] = [*wrong[1 - _FREE :], self._clock()]
        if len(self._wrong) > _ADDRESSES_MOST:
            del self._wrong[next(iter(self._wrong))]  # the one that guessed longest ago


# ---- sign-in

_CODES = 16  # So many codes are valid at a time, beside the terminal's.
CODE_S = 600.0  # A code that a page has shown is valid for so long.
_ROUNDS = 200_000  # Rounds of PBKDF2: whoever sees the cookie cannot try all short tokens at once.
_PAGE = """<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width">
<meta name=color-scheme content="light dark"><title>mirrormount</title>
<body style="font:18px system-ui;max-width:32em;margin:12vh auto;padding:0 1em">
<h1 style="font-size:1.3em">This panel needs a token</h1>
<p id=why>Open the link, or scan the QR code, that <code>mirrormount panel</code> printed where it was started.
Each link works once; a page that is open shows a new one. Or type the token that was given to it:</p>
<form><input name=token type=password autocomplete=off aria-label=Token style="font:inherit;min-height:44px;width:60%">
<button style="font:inherit;min-height:44px">Enter</button></form><p role=alert style="font-weight:600"></p>
<script nonce="{nonce}">
const form = document.querySelector("form"), told = document.querySelector("[role=alert]");
async function enter(secret) {{
  try {{
    const answer = await fetch("/enter", {{ method: "POST", body: secret }});
    const text = await answer.text();
    if (answer.ok) {{
      localStorage.setItem("mirrormount-key", text);
      location.replace("/");
    }} else told.textContent = text;
  }} catch {{
    told.textContent = "The panel does not answer: see that it still runs, then try again.";
  }}
}}
const code = location.hash.slice(1);
history.replaceState(null, "", "/enter");
if (code) enter(code);
form.addEventListener("submit", (event) => {{
  event.preventDefault();
  enter(form.token.value);
}});
</script>"""


@dataclass(frozen=True)
class Answer:
    """The reply to a posted code or token. key: for the page's storage, None if refused."""

    status: int
    text: str
    key: str | None = None


class SignIn:
    """The sign-in of one run of the panel: its codes, cookie and key. token None: loopback only, without sign-in.

    told(address, code): called after a sign-in by the terminal's link; code is the new one for that link.
    """

    def __init__(self, token: bytes | None, clock: Callable[[], float] = time.monotonic) -> None:
        self.token = token
        self.told: Callable[[str, str], None] = lambda client, code: None
        self.guesses = Guesses(clock)
        self._clock = clock
        self._codes: dict[str, float] = {}  # until when they are valid
        self._terminal = ""
        base = hashlib.pbkdf2_hmac("sha256", token, b"mirrormount panel", _ROUNDS) if token else b""
        self._derive = lambda what: hmac.new(base, what, "sha256").hexdigest()
        self.cookie = self._derive(b"cookie").encode() if token else b""
        # a name of its own: browsers keep one jar for all ports of a computer, and it may have two panels
        self.cookie_name = f"mirrormount_panel_{self._derive(b'name')[:8]}" if token else ""
        self.key = self._derive(b"page") if token else None

    def page(self, nonce: str) -> str:
        """The page at /enter."""
        return _PAGE.format(nonce=nonce)

    def new_code(self) -> str:
        """A code that is valid once, for CODE_S."""
        now_s = self._clock()
        self._codes = {code: until_s for code, until_s in self._codes.items() if until_s > now_s}
        while len(self._codes) >= _CODES:
            del self._codes[next(iter(self._codes))]
        code = secrets.token_urlsafe(16)
        self._codes[code] = now_s + CODE_S
        return code

    def terminal_code(self) -> str:
        """The code of the link that the terminal shows: valid once, however late."""
        self._terminal = self._terminal or secrets.token_urlsafe(16)
        return self._terminal

    def judge(self, client: str, secret: bytes) -> Answer:
        """The reply to a secret (a code or the token) that a client (its IP address) has posted."""
        wait_s = self.guesses.wait_s(client)
        if wait_s > 0:
            return Answer(429, f"Too many wrong tokens: wait {wait_s:.0f} s, then try again.")
        if self.token is None or self.key is None:
            return Answer(404, "This panel needs no token.")
        if self._terminal and same(secret, self._terminal.encode()):
            self._terminal = ""
            self.told(client, self.terminal_code())
        elif (code := next((c for c in self._codes if same(secret, c.encode())), None)) is not None:
            until_s = self._codes.pop(code)
            if until_s <= self._clock():
                return Answer(403, "This link is too old: take a new one.")
        elif not same(secret, self.token):
            self.guesses.wrong(client)
            return Answer(403, "This link was used already, or the token is wrong: take a new link, or type it again.")
        return Answer(200, self.key, self.key)


# ---- the layer around all requests

FLOOD = 4429  # The close code of a socket that sent too many messages.
_MESSAGES = 200, 100  # Messages of one socket: at once, and in a second. A page sends about 25 a second.
_PAGES = 6, 0.5  # Pages of one client: at once, and in a second. To build one takes 30 ms.
# Requests of one client, but for stops: at once, and in a second. To answer one takes 1.5 ms, for which the page that
# drives waits for its tick. The others wait for their turn; a page loads 42 files, then a picture each 80 ms.
_REQUESTS = 25, 100
_TURN_S = 2.0  # A request that would have to wait for longer is refused, after that time: else refusals were a flood.
_SOCKETS_MOST = 100  # Sockets at once, of all clients: a page has two, and each takes a file of the process.
_POST_MOST = 512  # A sign-in is no longer, in bytes.
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
    """Passes requests on to app, or refuses them. A stop is never refused for its number."""

    def __init__(self, app: ASGIApp, sign_in: SignIn, clock: Callable[[], float] = time.monotonic) -> None:
        self._app = app
        self._sign_in = sign_in
        self._pages = Rates(*_PAGES, clock=clock)
        self._requests = Rates(*_REQUESTS, clock=clock)
        self._sockets = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI's call."""
        if scope["type"] == "websocket":
            await self._socket(scope, receive, send)
        elif scope["type"] == "http":
            await self._request(scope, receive, _Hardened(scope, send))
        else:
            await self._app(scope, receive, send)

    async def _turn(self, scope: Scope) -> bool:
        """Wait until it is the request's turn. False if it does not come in time."""
        wait_s = self._requests.of(_client(scope)).wait_s(_TURN_S)
        if wait_s:
            await asyncio.sleep(min(wait_s, _TURN_S))
        return wait_s <= _TURN_S

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        crowd = not await self._turn(scope) or self._sockets >= _SOCKETS_MOST
        if crowd or self._foreign(scope) or not self._signed_in(scope):
            await receive()  # the connection's request; refused before it is accepted, it is answered with 403
            await send({"type": "websocket.close", "code": 4403})
            return
        self._sockets += 1
        try:
            await self._app(scope, _bounded(receive, send), send)
        finally:
            self._sockets -= 1

    async def _request(self, scope: Scope, receive: Receive, send: "_Hardened") -> None:
        path = scope["path"]
        is_stop = path == "/stop" and scope["method"] == "POST"
        if not is_stop and not await self._turn(scope):
            await send.answer(429, b"", [(b"retry-after", b"1")])
        elif self._foreign(scope):
            await send.page(403, _FOREIGN)
        elif not _PATHS.fullmatch(path):  # here, and not in a library, which writes the address to its log
            await send.page(404, _NOTHING)
        elif path == "/enter":
            await self._enter(scope, receive, send)
        elif not self._signed_in(scope):
            await (send.html(403, self._sign_in.page(send.nonce)) if path == "/" else send.page(403, _NO_TOKEN))
        elif path == "/" and scope["query_string"]:  # nothing of ours; the address bar is to be clean
            await send.answer(303, b"", [(b"location", b"/")])
        elif path == "/" and not self._pages.of(_client(scope)).take():
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
