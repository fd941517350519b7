"""Rejects web browsers by the first bytes of a client, before any byte is passed on. No I/O.

A web page can make the browser on this computer send text to any of its ports, and the body of a request would be
executed as commands. So a client whose first bytes are HTTP's or TLS's is rejected. No command line begins like them.

A page can choose the method (DNS rebinding makes it the same origin), and a method may begin like a frame or a line
with an axis. Those start motions at once, so they are not held back; the first line is checked to its end.
"""

import re

_TLS = 0x16  # the first byte of a handshake; the firmware would take it for damage
_METHOD = re.compile(rb"[A-Za-z]+ ?\Z")  # may be the beginning of a request's method
_TOKEN = rb"[!#$%&'*+\-.^_`|~0-9A-Za-z]+"  # a method (RFC 9110, 5.6.2)
_REQUEST = re.compile(_TOKEN + rb" +(/|\*|https?:|[^\r\n]*HTTP/)", re.IGNORECASE)
_UNDECIDED = re.compile(rb"[A-Za-z]+ [^\r\n]*\Z")
_UNFINISHED = re.compile(_TOKEN + rb"( [^\r\n]*)?\Z")
_LINE_MOST = 128  # the longest command line (mountfw.dialect.line.MAX_LINE)
_STOP = re.compile(rb"[!\x03]|0{8}")


class NotAClient(Exception):
    """The first bytes are not those of a board's client; the text names the protocol."""


class FirstBytes:
    """Passes a client's bytes on as soon as its first line cannot be HTTP's; a stop is passed on at once."""

    def __init__(self) -> None:
        self._held = b""
        self._decided = False
        self._passed = 0  # bytes of _held that were passed on
        self._stops = 0  # stops in _held that were passed on

    def feed(self, data: bytes) -> bytes:
        """The bytes of data, and of those held back, that are for the board. Raises NotAClient."""
        if self._decided or not (data or self._held):
            return data
        self._held += data
        held = self._held
        if held[0] == _TLS:
            raise NotAClient("speaks TLS")
        if _REQUEST.match(held):
            raise NotAClient("is a web browser")
        if _METHOD.match(held) or _UNDECIDED.match(held):
            if len(held) > _LINE_MOST:  # no command line; a request with a long address is
                raise NotAClient("is a web browser")
            stops = len(_STOP.findall(held))
            new, self._stops = stops - self._stops, stops
            return b"!" * max(0, new)
        passed, self._passed = self._passed, len(held)
        self._decided = len(held) > _LINE_MOST or not _UNFINISHED.match(held)
        if self._decided:
            self._held = b""
        return held[passed:]
