"""Removes telnet's own bytes from a network client's. Bytes in, bytes out; imports nothing of ours.

A New Focus controller on Ethernet uses telnet (RFC 854): it sends two offers first, and a client may
answer them. To the board the first byte of such an answer is damage, and it would stop.
"""

import time
from collections.abc import Callable

GREETING = bytes((0xFF, 0xFB, 0x01, 0xFF, 0xFB, 0x03))  # WILL echo, WILL suppress go-ahead; drivers wait for it

_IAC = 0xFF  # begins every telnet command
_WILL, _DONT = 0xFB, 0xFE  # and WONT, DO between them: an option's number follows
_SB, _SE = 0xFA, 0xF0  # a sub-negotiation's begin and end
_BRK, _IP, _ABORT = 0xF3, 0xF4, 0xEE  # the "interrupt" keys of a telnet program
_FIRST_COMMAND = 0xEC
_STOP = 0x21
_ZERO = 0x30  # eight in a row are a stop
_PAUSE_S = 1.0  # a negotiation that pauses for longer has ended: the next byte is the board's
_SUB_MOST = 64  # a longer one has ended: it must not swallow commands, least of all a stop

# Ctrl-C would drop the firmware to its prompt, where text is executed as Python; the others are mpremote's keys
_PASSED = bytes.maketrans(b"\x03", b"!")
_KEPT_BACK = b"\x01\x02\x04\x05\x18"


def _pass(data: bytes) -> bytes:
    return data.translate(_PASSED, _KEPT_BACK)


class Inlet:
    """Filters the bytes of one client. With telnet, telnet's own bytes are removed.

    No stop is removed, wherever it stands: `!` and `0` are no options here (a board has no use for 0x21, flow
    control), and a negotiation without end is bounded in length and in time.
    """

    def __init__(self, telnet: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self._telnet = telnet
        self._clock = clock
        self._state: Callable[[int], bytes] = self._plain
        self._sub_left = 0
        self._zeros = 0  # in a row, in a sub-negotiation
        self._fed_s = clock()

    def feed(self, data: bytes) -> bytes:
        """The bytes of data that are for the board; data may be cut anywhere."""
        now_s = self._clock()
        if now_s - self._fed_s > _PAUSE_S:
            self._state = self._plain
        self._fed_s = now_s
        passed, at = [], 0
        while at < len(data):
            if self._state == self._plain:  # nearly always: all at once up to telnet's next byte
                end = data.find(_IAC, at) if self._telnet else -1
                end = len(data) if end < 0 else end
                passed.append(_pass(data[at:end]))
                at = end
            if at < len(data):
                passed.append(self._state(data[at]))
                at += 1
        return b"".join(passed)

    def _plain(self, c: int) -> bytes:
        if c == _IAC and self._telnet:
            self._state = self._command
            return b""
        return _pass(bytes((c,)))

    def _command(self, c: int) -> bytes:
        self._state = self._plain
        if c < _FIRST_COMMAND:  # not telnet after all
            return self._plain(c)
        if _WILL <= c <= _DONT:
            self._state = self._option
        elif c == _SB:
            self._state = self._sub
            self._sub_left = _SUB_MOST
            self._zeros = 0
        return b"!" if c in (_BRK, _IP, _ABORT) else b""

    def _option(self, c: int) -> bytes:
        self._state = self._plain
        return bytes((c,)) if c in (_STOP, _ZERO) else b""

    def _sub(self, c: int) -> bytes:
        self._sub_left -= 1
        self._zeros = self._zeros + 1 if c == _ZERO else 0
        if c == _STOP or self._zeros == 8 or not self._sub_left:
            self._state = self._plain
            return b"!"
        if c == _IAC:
            self._state = self._sub_command
        return b""

    def _sub_command(self, c: int) -> bytes:
        if c == _IAC:  # 0xFF itself, as data
            self._state = self._sub
            return b""
        self._state = self._plain
        return b"" if c == _SE else self._command(c)
