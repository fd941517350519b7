"""Bytes in, messages out; answers in, bytes out. Pure (sans-IO); imports nothing of ours.

receive() only stores a byte, and says at once when it completes a stop: the stops are looked
for before anything is parsed. next() returns the next message, or NEED_BYTES. Every change of
state is in this file. Two stops that nothing can swallow: `!` anywhere, and eight `0` bytes in
a row anywhere.
"""

# messages
NEED_BYTES = 0
STOP = 1  # `!`
ZEROS = 2  # eight `0` in a row that did not end a frame or spoil a line
FRAME = 3
LINE = 4
MALFORMED = 5
TOO_LONG = 6

FRAME_GAP_US = 50_000  # an unfinished frame, or a skipped tail, is given up after this silence
LINE_GAP_US = 1_000_000  # an unfinished line

_BOUNDARY = 0
_IN_FRAME = 1
_IN_LINE = 2
_SKIPPING = 3  # the rest of something refused or cut, up to a line end or a gap

_STOP = 0x21
_CTRL_C = 0x03  # reaches us only where it is not the console's
_ZERO = 0x30
_TOO_LONG = -2  # what line.feed() says


class Link:
    """The receiving side. frame and line are mountfw's Frame and Line, or things that feed alike.

    size is more than the buffers below us hold together (USB and stdin: 0.8 KB on the RP2040), so that
    all that waits can be searched for stops at once, however slowly it is obeyed.
    """

    def __init__(self, frame, line, size=1024):
        self.stops_ahead = 0  # received, not yet parsed: nothing may start before them
        self.unparsed = 0  # bytes received, not yet parsed
        self._frame = frame
        self._line = line
        self._rx = bytearray(size)
        self._size = size
        self._read = 0  # where next() reads
        self._state = _BOUNDARY
        self._zeros_in = 0
        self._zeros = 0

    def room(self):
        """True while receive() may be called."""
        return self.unparsed < self._size

    def receive(self, c):
        """Store byte c. STOP or ZEROS if it completes that stop, else NEED_BYTES."""
        self._rx[(self._read + self.unparsed) % self._size] = c
        self.unparsed += 1
        if c == _ZERO:
            self._zeros_in += 1
            if self._zeros_in < 8:
                return NEED_BYTES
            self._zeros_in = 0
            self.stops_ahead += 1
            return ZEROS
        self._zeros_in = 0
        if c == _STOP or c == _CTRL_C:
            self.stops_ahead += 1
            return STOP
        return NEED_BYTES

    def next(self):
        """The next message, or NEED_BYTES when all that was received is parsed."""
        while self.unparsed:
            c = self._rx[self._read]
            self._read = (self._read + 1) % self._size
            self.unparsed -= 1
            message = self._parse(c)
            if message:
                return message
        return NEED_BYTES

    def gap_us(self):
        """How long a silence the present state bears; 0 at a message boundary: for ever."""
        if self._state == _BOUNDARY:
            return 0
        return LINE_GAP_US if self._state == _IN_LINE else FRAME_GAP_US

    def gap(self):
        """That silence is over (a poll has just said that nothing waits). MALFORMED or NEED_BYTES."""
        cut = self._state == _IN_FRAME or self._state == _IN_LINE
        self._state = _BOUNDARY
        return MALFORMED if cut else NEED_BYTES

    def _parse(self, c):
        state = self._state
        if c == _STOP or c == _CTRL_C:
            self._zeros = 0
            self.stops_ahead -= 1
            if state != _BOUNDARY:
                self._state = _SKIPPING  # the tail of the cut message is never obeyed
            return STOP
        stopped = self._count_zeros(c)
        if c < 0x20 and (c == 1 or c == 2 or c == 4 or c == 5 or c == 0x18):
            return NEED_BYTES  # mpremote, knocking
        message = NEED_BYTES
        if state == _SKIPPING:
            if c == 10 or c == 13:
                self._state = _BOUNDARY
        elif state == _BOUNDARY:
            message = self._first_byte(c)
        elif state == _IN_FRAME:
            message = self._in_frame(c)
        else:
            message = self._in_line(c)
        return ZEROS if stopped and not message else message

    def _count_zeros(self, c):
        if c != _ZERO:
            self._zeros = 0
            return False
        self._zeros += 1
        if self._zeros < 8:
            return False
        self._zeros = 0
        self.stops_ahead -= 1
        return True

    def _first_byte(self, c):
        if c == 10 or c == 13 or c == 0x20 or c == 0:
            return NEED_BYTES
        if c == _ZERO or c == 0x2D or c == 0x2B:
            self._frame.start()
            self._frame.feed(c)
            self._state = _IN_FRAME
            return NEED_BYTES
        if 0x31 <= c <= 0x39 or 0x41 <= c & 0xDF <= 0x5A or c == 0x2A:
            self._line.start()
            self._state = _IN_LINE
            return self._in_line(c)
        self._state = _SKIPPING
        return MALFORMED

    def _in_frame(self, c):
        frame = self._frame
        if c == 0x3E and frame.length < 3 and frame.text[0] == _ZERO:  # `0>` or `0d>`: an address
            self._line.start()
            self._state = _IN_LINE
            for i in range(frame.length):
                self._line.feed(frame.text[i])
            return self._in_line(c)
        result = frame.feed(c)
        if result == 0:
            return NEED_BYTES
        if result > 0:
            self._state = _BOUNDARY
            return FRAME
        return self._refuse(c, MALFORMED)

    def _in_line(self, c):
        result = self._line.feed(c)
        if result < 0:
            return self._refuse(c, TOO_LONG if result == _TOO_LONG else MALFORMED)
        if result and (c == 10 or c == 13):
            self._state = _BOUNDARY
            return LINE
        return NEED_BYTES

    def _refuse(self, c, message):
        self._state = _BOUNDARY if c == 10 or c == 13 else _SKIPPING
        return message


class Replies:
    """The sending side: a bounded buffer. A reply that does not fit is dropped whole.

    begin(), then put(), text() and number(), then commit(); read() while waiting().
    """

    def __init__(self, size=1024):
        self._buffer = bytearray(size)
        self._tail = 0
        self._head = 0  # end of what may be sent
        self._end = 0  # end of the reply in the making
        self._lost = False

    def begin(self):
        """Start a reply."""
        self._end = self._head
        self._lost = False

    def put(self, c):
        """Add byte c."""
        after = self._end + 1
        if after == len(self._buffer):
            after = 0
        if after == self._tail:
            self._lost = True
        else:
            self._buffer[self._end] = c
            self._end = after

    def text(self, data):
        """Add bytes."""
        for c in data:
            self.put(c)

    def number(self, n):
        """Add integer n (below 2**30) in decimal."""
        if n < 0:
            self.put(0x2D)
            n = -n
        power = 1
        while n // power >= 10:
            power *= 10
        while power:
            self.put(_ZERO + n // power % 10)
            power //= 10

    def commit(self):
        """End the reply. False if it did not fit: then nothing of it is sent."""
        if not self._lost:
            self._head = self._end
        return not self._lost

    def waiting(self):
        """True while read() has a byte."""
        return self._tail != self._head

    def read(self):
        """The next byte to send."""
        c = self._buffer[self._tail]
        after = self._tail + 1
        self._tail = 0 if after == len(self._buffer) else after
        return c
