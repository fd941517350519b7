"""Sign-in of a browser to a panel that needs a token: by a link with a one-time code, or by the typed token.

The code is in the link's fragment (`/enter#CODE`). A browser sends no fragment to a server, so it is in no log and
in no Referer. The page at /enter takes it out of the address bar and posts it; the reply is a cookie, by which the
panel may be looked at, and a key, without which nothing moves. The page keeps the key in its own storage, which,
unlike a cookie, belongs to one port of one host.
"""

import hashlib
import hmac
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass

from mirrormount.panel.tokens import Guesses, same

_CODES = 16  # that are valid at a time, beside the terminal's
CODE_S = 600.0  # validity of a code that a page has shown
_ROUNDS = 200_000  # of PBKDF2: what is made from a short token does not give it away at once
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
    told.textContent = "The panel does not answer.";
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
            return Answer(403, "This link was used already, or the token is wrong.")
        return Answer(200, self.key, self.key)
