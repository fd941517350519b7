"""What of a network client's bytes is for the board. Bytes in, bytes out; imports nothing of ours.

A New Focus controller on Ethernet speaks telnet (RFC 854): it greets with two offers, and a client may
answer, in bytes of which the board would take the first for damage and stop.
"""

import time
from collections.abc import Callable

GREETING = bytes((0xFF, 0xFB, 0x01, 0xFF, 0xFB, 0x03))  # I will echo, I will suppress go-ahead; published drivers wait

_IAC = 0xFF  # begins every command of telnet's
_WILL, _DONT = 0xFB, 0xFE  # and WONT, DO between them: an option's number follows
_SB, _SE = 0xFA, 0xF0  # a sub-negotiation's begin and end
_BRK, _IP, _ABORT = 0xF3, 0xF4, 0xEE  # a person at a telnet program has pressed the key for "interrupt"
_FIRST_COMMAND = 0xEC
_STOP = 0x21
_ZERO = 0x30  # eight in a row stop, too
_PAUSE_S = 1.0  # a negotiation that stands still for so long is none: what comes next is the board's
_SUB_MOST = 64  # a longer sub-negotiation is none: it must not swallow what comes, least of all a stop

# Ctrl-C would drop the firmware to its prompt, where text is obeyed as Python; the others are mpremote's keys
_PASSED = bytes.maketrans(b"\x03", b"!")
_KEPT_BACK = b"\x01\x02\x04\x05\x18"


def _pass(data: bytes) -> bytes:
    return data.translate(_PASSED, _KEPT_BACK)


class Inlet:
    """The bytes of one client on their way in. With telnet, telnet's own bytes are taken out.

    No stop is taken out, wherever it stands: `!` and `0` are no options here (0x21, flow control, asks for nothing
    that a board has), and a negotiation that never ends is bounded in length and in time.
    """

    def __init__(self, telnet: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self._telnet = telnet
        self._clock = clock
        self._state: Callable[[int], bytes] = self._plain
        self._sub_left = 0
        self._zeros = 0  # in a row, in a sub-negotiation
        self._fed_s = clock()

    def feed(self, data: bytes) -> bytes:
        """What of data is for the board; data may be cut anywhere."""
        now_s = self._clock()
        if now_s - self._fed_s > _PAUSE_S:
            self._state = self._plain
        self._fed_s = now_s
        passed, at = [], 0
        while at < len(data):
            if self._state == self._plain:  # by far the most: all at once up to telnet's next byte
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
