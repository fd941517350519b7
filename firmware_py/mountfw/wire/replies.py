"""Replies out: texts and numbers are queued whole and made into bytes as they are sent. Pure; imports frame.

A frame is echoed in five lines, as the paper's sketch does. A serial port in a terminal's default mode (`stty sane`)
returns each byte that it receives, and the first of these lines would drive again. So a line `#` goes before the first
echo after a start, a silence or malformed input. No host sends `#`: where it comes back, the port returns bytes. The
receiver then stops and drops what follows, and no frame is echoed until the next silence. No other answer begins like a
frame: one that comes back is malformed input, and stops.
"""

from mountfw import const
from mountfw.wire.frame import PROBE, ZERO

_PROBE_LINE = bytes((PROBE, 13, 10))

# does the port return what the board sends?
_UNKNOWN = const(0)
_NO = const(1)  # or the probe is on its way, before all echoes
_YES = const(2)

_SIGNS = b"0+-"  # by two bits of a packed frame (frame.py)
_POWERS = (0, 100, 10, 1)  # of the digits of a field
_CR_AT = const(8)  # where in a line of an echo its end stands


class Replies:
    """The sending side: a bounded queue. A reply that does not fit is dropped whole.

    begin(), then add() or field(), then commit(); or echo(). read() while waiting. No text may change until it is sent.
    """

    def __init__(self, size=256):
        self._items = [None] * size  # texts (bytes) and numbers; None and a packed frame: its echo. size: a power of 2
        self._mask = size - 1
        self.waiting = False  # True if read() has a byte
        self._tail = 0
        self._head = 0  # end of what may be sent
        self._end = 0  # end of the reply that is being added to
        self._lost = False
        self._at = 0  # in the text that is being sent; in an echo 16 x line + place
        self._power = 0  # of ten: the digit of the number that is being sent; 0 before its first
        self._returns = _UNKNOWN

    # ---- into the queue

    def begin(self):
        """Start a reply."""
        self._end = self._head
        self._lost = False

    def add(self, item):
        """Add bytes (at least one) as they are, or an integer (between -2**30 and 2**30) in decimal."""
        end = self._end
        after = end + 1 & self._mask
        if after == self._tail:
            self._lost = True
        else:
            self._items[end] = item
            self._end = after

    def field(self, before, n):
        """Add both: bytes, and the integer after them. For an answer of many fields that is faster than twice add()."""
        middle = self._end + 1 & self._mask
        after = middle + 1 & self._mask
        if middle == self._tail or after == self._tail:
            self._lost = True
        else:
            self._items[self._end] = before
            self._items[middle] = n
            self._end = after

    def commit(self):
        """End the reply. False if it did not fit: then no part of it is sent."""
        if not self._lost:
            self._head = self._end
            self.waiting = self._tail != self._head
        return not self._lost

    def echo(self, packed):
        """Queue the echo of a packed frame, if the port does not return it. One that does not fit is dropped whole."""
        if self._returns == _YES:
            return
        self.begin()
        if self._returns == _UNKNOWN:
            self.add(_PROBE_LINE)
        self.field(None, packed)
        if self.commit():
            self._returns = _NO

    def doubt(self, returned):
        """Malformed input: the port may have returned what was sent. returned: it was the probe, so it has."""
        if returned:
            self._returns = _YES
        elif self._returns == _NO:
            self._returns = _UNKNOWN

    def silence(self):
        """Nothing has come for long: another program may open the port, in another mode."""
        self._returns = _UNKNOWN

    # ---- out of it

    def read(self):
        """Remove and return the next byte to send."""
        item = self._items[self._tail]
        if item is None:
            return self._echoed(self._items[self._tail + 1 & self._mask])
        if type(item) is int:
            c = self._digit(item)
            if not self._power:
                self._drop_item()
            return c
        c = item[self._at]
        self._at += 1
        if self._at == len(item):
            self._at = 0
            self._drop_item()
        return c

    def _echoed(self, packed):
        """Five lines: 0 the frame, 1 and 2 its numbers, 3 and 4 their magnitudes."""
        line = self._at >> 4
        place = self._at & 0xF
        self._at += 1
        if place == _CR_AT:
            return 13
        if place > _CR_AT:
            self._at = line + 1 << 4
            if line == 4:
                self._at = 0
                self._drop_item()
                self._drop_item()
            return 10
        if line == 0:
            field = packed >> 10 if place < 4 else packed
            place &= 3
            return _SIGNS[field >> 8 & 3] if place == 0 else ZERO + (field & 0xFF) // _POWERS[place] % 10
        field = packed >> 10 if line & 1 else packed
        n = field & 0xFF
        c = self._digit(-n if line < 3 and field & 0x200 else n)
        if not self._power:
            self._at = line << 4 | _CR_AT
        return c

    def _digit(self, n):
        """The sign or next digit of n; _power is 0 after the last one."""
        power = self._power
        negative = n < 0
        n = abs(n)
        if not power:
            power = 1
            while n // power >= 10:
                power *= 10
            self._power = power
            if negative:
                return 0x2D
        self._power = power // 10
        return 0x30 + n // power % 10

    def _drop_item(self):
        self._tail = self._tail + 1 & self._mask
        self.waiting = self._tail != self._head
