"""What of a network client's bytes is for the board. Bytes in, bytes out; no I/O, imports nothing of ours.

A New Focus controller on Ethernet speaks telnet (RFC 854): it greets with two offers, and a client may
answer, in bytes of which the board would take the first for damage and stop.
"""

from collections.abc import Callable

GREETING = bytes((0xFF, 0xFB, 0x01, 0xFF, 0xFB, 0x03))  # I will echo, I will suppress go-ahead; published drivers wait

_IAC = 0xFF  # begins every command of telnet's
_WILL, _DONT = 0xFB, 0xFE  # and WONT, DO between them: an option's number follows
_SB, _SE = 0xFA, 0xF0  # a sub-negotiation's begin and end
_BRK, _IP, _ABORT = 0xF3, 0xF4, 0xEE  # a person at a telnet program has pressed the key for "interrupt"
_FIRST_COMMAND = 0xEC
_STOP = 0x21
_SUB_MOST = 64  # a longer sub-negotiation is none: it must not swallow what comes, least of all a stop

# Ctrl-C would drop the firmware to its prompt, where text is obeyed as Python; the others are mpremote's keys
_PASSED = [bytes((c,)) for c in range(256)]
_PASSED[0x03] = b"!"
for _c in (0x01, 0x02, 0x04, 0x05, 0x18):
    _PASSED[_c] = b""


class Inlet:
    """The bytes of one client on their way in. With telnet, telnet's own bytes are taken out."""

    def __init__(self, telnet: bool) -> None:
        self._telnet = telnet
        self._state: Callable[[int], bytes] = self._plain
        self._sub_left = 0

    def feed(self, data: bytes) -> bytes:
        """What of data is for the board; data may be cut anywhere."""
        return b"".join([self._state(c) for c in data])

    def _plain(self, c: int) -> bytes:
        if c == _IAC and self._telnet:
            self._state = self._command
            return b""
        return _PASSED[c]

    def _command(self, c: int) -> bytes:
        self._state = self._plain
        if c < _FIRST_COMMAND:  # not telnet after all
            return self._plain(c)
        if _WILL <= c <= _DONT:
            self._state = self._option
        elif c == _SB:
            self._state = self._sub
            self._sub_left = _SUB_MOST
        return b"!" if c in (_BRK, _IP, _ABORT) else b""

    def _option(self, _c: int) -> bytes:
        self._state = self._plain
        return b""

    def _sub(self, c: int) -> bytes:
        self._sub_left -= 1
        if c == _STOP or not self._sub_left:
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
