"""Is a network client one of a board's at all? Judged by its first bytes, before one of them is passed on. No I/O.

A web page can make the browser on this computer send text to any of its ports, and the body of a request would be
obeyed as commands. So whoever begins as HTTP or TLS does is not let in. No command line begins so.
"""

import re

_TLS = 0x16  # the first byte of a handshake; the firmware would take it for damage
_METHOD = re.compile(rb"[A-Za-z]+ ?\Z")  # so far it could be the method of a request
_REQUEST = re.compile(rb"[A-Za-z]+ +(/|\*|https?:|[^\n]*HTTP/)", re.IGNORECASE)
_UNDECIDED = re.compile(rb"[A-Za-z]+ [^\n]*\Z")
_LINE_MOST = 128  # the longest command line (mountfw.command.MAX_LINE)
_STOP = re.compile(rb"[!\x03]|0{8}")


class NotAClient(Exception):
    """What begins so does not want a board; the text says what it is."""


class FirstBytes:
    """Passes a client's bytes on once its first line cannot be HTTP's; a stop in them is passed on at once."""

    def __init__(self) -> None:
        self._held = b""
        self._decided = False
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
        self._decided = True
        self._held = b""
        return held
