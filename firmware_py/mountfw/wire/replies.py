"""Replies out: texts and numbers are queued whole and made into bytes as they are sent. Pure; imports echo."""

from mountfw.echo import Echo


class Replies(Echo):
    """The sending side: a bounded queue. A reply that does not fit is dropped whole.

    begin(), then add() or field(), then commit(); or echo(). read() while waiting. No text may change until it is sent.
    """

    def __init__(self, own, size=256):
        self._own = own  # an OwnReply: it records each byte that is sent
        self._items = [None] * size  # texts (bytes) and numbers; size is a power of two
        self._mask = size - 1
        self.waiting = False  # True if read() has a byte
        self._tail = 0
        self._head = 0  # end of what may be sent
        self._end = 0  # end of the reply that is being added to
        self._lost = False
        self._at = 0  # in the text that is being sent
        self._power = 0  # of ten: the digit of the number that is being sent; 0 before its first

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

    def read(self):
        """Remove and return the next byte to send."""
        item = self._items[self._tail]
        if item is None:
            return self._echoed(self._items[self._tail + 1 & self._mask])
        if type(item) is int:
            c = self._digit(item)
            if not self._power:
                self._drop_item()
        else:
            c = item[self._at]
            self._at += 1
            if self._at == len(item):
                self._at = 0
                self._drop_item()
        self._own.sent_byte(c)
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
