"""Is a network client one of a board's at all? Judged by its first bytes, before one of them is passed on. No I/O.

A web page can make the browser on this computer send text to any of its ports, and the body of a request would be
obeyed as commands. So whoever begins as HTTP or TLS does is not let in. No command line begins so.

A page can choose the method (DNS rebinding makes it the same origin), and a method may begin as a frame or as a line
with an axis does. Those begin to move at once, so they are not held back; the first line is judged to its end.
"""

import re

_TLS = 0x16  # the first byte of a handshake; the firmware would take it for damage
_METHOD = re.compile(rb"[A-Za-z]+ ?\Z")  # so far it could be the method of a request
_TOKEN = rb"[!#$%&'*+\-.^_`|~0-9A-Za-z]+"  # what a method may be (RFC 9110, 5.6.2)
_REQUEST = re.compile(_TOKEN + rb" +(/|\*|https?:|[^\r\n]*HTTP/)", re.IGNORECASE)
_UNDECIDED = re.compile(rb"[A-Za-z]+ [^\r\n]*\Z")
_UNFINISHED = re.compile(_TOKEN + rb"( [^\r\n]*)?\Z")
_LINE_MOST = 128  # the longest command line (mountfw.dialect.line.MAX_LINE)
_STOP = re.compile(rb"[!\x03]|0{8}")


class NotAClient(Exception):
    """What begins so does not want a board; the text says what it is."""


class FirstBytes:
    """Passes a client's bytes on once its first line cannot be HTTP's; a stop in them is passed on at once."""

    def __init__(self) -> None:
        self._held = b""
        self._decided = False
        self._passed = 0  # bytes of what is held, passed on already
        self._stops = 0  # in what is held, passed on already

    def feed(self, data: bytes) -> bytes:
        """What of data, and of what was held back, is for the board. Raises NotAClient."""
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
