"""Bytes in, messages out. Pure (sans-IO); imports const, frame.

receive() stores a byte and reports at once that it completes a stop, before anything is parsed. next() returns the
next message, or NEED_BYTES. Two stops that nothing can swallow: `!` anywhere, and eight `0` bytes in a row anywhere.
"""

from mountfw import const
from mountfw.wire.frame import LENGTH, MINUS, PLUS, PROBE, ZERO

NEED_BYTES = const(0)  # the messages
STOP = const(1)  # `!`
ZEROS = const(2)  # eight `0` in a row, unless they end a frame or make a line MALFORMED
FRAME = const(3)
LINE = const(4)
MALFORMED = const(5)
TOO_LONG = const(6)
RETURNED = const(7)  # the probe: the port returns what the board sends (replies.py)

FRAME_GAP_US = const(50_000)  # an unfinished frame, or a skipped tail, times out after this silence
LINE_GAP_US = const(1_000_000)  # an unfinished line

EIGHTH_ZERO = const(0xB0)  # in the ring: a `0` that completes eight; other bytes above 0x7F are stored as 0x7F

BOUNDARY = const(0)  # states
_IN_FRAME = const(1)  # bad, or with a stop or a byte for mpremote in it: others are read whole
_IN_LINE = const(2)
SKIPPING = const(3)  # the rest of something refused or cut, up to a line end or a gap
_TO_GAP = const(4)  # what the board itself has sent, up to a gap

_STOP = const(0x21)
_CTRL_C = const(0x03)  # arrives only on a channel that is not the console
_BAD = const(-1)  # of Line.feed()
_TOO_LONG = const(-2)


class Receiver:
    """The receiving side. frame is a Frame, line a Line (dialect/line.py); pack is frame.pack().

    The port fills the ring, by receive() or with faster code of the same effect: ring, mask (size - 1; the size is a
    power of two), write (index of the next byte), unparsed, zeros and received_at are for both. It holds more than the
    buffers below it together (0.8 KB on the RP2040), so no stop waits there for messages to be executed.
    """

    def __init__(self, frame, line, pack, size=4096):
        self.stops_ahead = 0  # received, not yet parsed: nothing may start before them
        self.unparsed = 0  # bytes received, not yet parsed
        self.ahead = 0  # of these: looked at, and still undecided
        self.ring = bytearray(size)
        self.mask = size - 1
        self.write = 0
        self.zeros = 0  # that came last, in a row
        self.received_at = 0  # when the last byte came (ticks)
        self.state = BOUNDARY
        self._frame = frame
        self._line = line
        self._pack = pack

    def receive(self, c):
        """Store byte c, if unparsed <= mask. STOP or ZEROS if it completes that stop, else NEED_BYTES."""
        stop = NEED_BYTES
        if c == ZERO:
            self.zeros += 1
            if self.zeros == 8:
                self.zeros = 0
                c = EIGHTH_ZERO
                stop = ZEROS
        else:
            self.zeros = 0
            if c == _STOP or c == _CTRL_C:
                stop = STOP
            elif c > 0x7F:
                c = 0x7F
        self.ring[self.write] = c
        self.write = self.write + 1 & self.mask
        self.unparsed += 1
        if stop:
            self.stops_ahead += 1
        return stop

    def waits(self):
        """True if there are bytes for next(): more than those that it has looked at."""
        return self.unparsed > self.ahead

    def begun(self):
        """True if what waits may be the first bytes of a frame, and nothing else does."""
        return self.state == BOUNDARY and 0 < self.unparsed < LENGTH and self._begins_frame()

    def next(self) -> int:
        """Parse a frame or one byte, for a piece of work must be short. The message that it ends, or NEED_BYTES."""
        state = self.state
        self.ahead = 0
        c = self.ring[self.write - self.unparsed & self.mask]
        if state == BOUNDARY and (c == ZERO or c == PLUS or c == MINUS) and self._begins_frame():
            if self.unparsed < LENGTH:
                self.ahead = self.unparsed
                return NEED_BYTES
            self.unparsed -= LENGTH
            return FRAME
        self.unparsed -= 1
        zeros = NEED_BYTES
        if not 0x21 < c < 0x80:
            if c == _STOP or c == _CTRL_C:
                self.stops_ahead -= 1
                self._stopped()
                return STOP
            if c == 1 or c == 2 or c == 4 or c == 5 or c == 0x18:
                return NEED_BYTES  # mpremote looks for a prompt
            if c == EIGHTH_ZERO:
                self.stops_ahead -= 1
                c = ZERO
                zeros = ZEROS
        if state == _IN_LINE:  # in text, zeros would continue it
            result = _BAD if zeros else self._line.feed(c)
            return self._in_line(c, result) if result else NEED_BYTES
        if state == BOUNDARY:
            return self._first_byte(c) or zeros
        if state == _IN_FRAME:
            return self._in_frame(c) or zeros
        self._skip(c)
        return zeros

    def _begins_frame(self):
        """True if the bytes that are unparsed are a frame, which is unpacked, or may be the first of one."""
        read = self.write - self.unparsed
        for i in range(self.unparsed, LENGTH):  # a byte that has not come yet is taken as `0`, which always fits
            self.ring[read + i & self.mask] = ZERO
        packed = self._pack(self.ring, read, self.mask)  # no frame if there is a stop in it
        if packed >= 0 and self.unparsed >= LENGTH:
            self._frame.unpack(packed)
        return packed >= 0

    def gap_us(self) -> int:
        """The silence after which gap() is due; 0 at a message boundary: never."""
        if self.state == BOUNDARY:
            return FRAME_GAP_US if self.ahead else 0
        return LINE_GAP_US if self.state == _IN_LINE else FRAME_GAP_US

    def gap(self) -> int:
        """Time out (a poll has just found no byte). MALFORMED, or NEED_BYTES where nothing was unfinished."""
        message = NEED_BYTES if self.state >= SKIPPING else MALFORMED
        self.state = BOUNDARY
        self.unparsed -= self.ahead
        self.ahead = 0
        return message

    def _skip(self, c):
        """Skip byte c."""
        if c == PROBE:
            self.state = _TO_GAP
        elif self.state == SKIPPING and (c == 10 or c == 13):
            self.state = BOUNDARY

    def _refuse(self, c, message):
        """Byte c cannot continue the message."""
        if c == PROBE:
            self.state = _TO_GAP
            return RETURNED
        self.state = BOUNDARY if c == 10 or c == 13 else SKIPPING
        return message

    def _stopped(self):
        """A stop is parsed: the tail of the message that it has cut is never executed."""
        if self.state != BOUNDARY and self.state != _TO_GAP:
            self.state = SKIPPING

    def _first_byte(self, c):
        if 0x41 <= c & 0xDF <= 0x5A or 0x31 <= c <= 0x39 or c == 0x2A:
            self._line.start()
            self.state = _IN_LINE
            self.unparsed += 1  # one piece of work: the line takes it in the next
        elif c == ZERO or c == MINUS or c == PLUS:
            self._frame.start()
            self._frame.feed(c)
            self.state = _IN_FRAME
        elif c != 10 and c != 13 and c != 0x20 and c != 0:
            return self._refuse(c, MALFORMED)
        return NEED_BYTES

    def _in_frame(self, c):
        frame = self._frame
        if c == 0x3E and frame.length < 3 and frame.text[0] == ZERO:  # `0>` or `0d>`: an address
            self._line.start()
            self.state = _IN_LINE
            for i in range(frame.length):
                self._line.feed(frame.text[i])
            return self._in_line(c, self._line.feed(c))
        result = frame.feed(c)
        if result < 0:
            return self._refuse(c, MALFORMED)
        if result == 0:
            return NEED_BYTES
        self.state = BOUNDARY
        return FRAME

    def _in_line(self, c, result):
        if result > 0:
            self.state = BOUNDARY
            return LINE
        if result < 0:
            return self._refuse(c, TOO_LONG if result == _TOO_LONG else MALFORMED)
        return NEED_BYTES
