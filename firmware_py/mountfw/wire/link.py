"""Bytes in, messages out; answers in, bytes out. Pure (sans-IO). Imports own_reply.

receive() only stores a byte, and says at once when it completes a stop: the stops are looked
for before anything is parsed. next() returns the next message, or NEED_BYTES. Every change of
state is in this file. Two stops that nothing can swallow: `!` anywhere, and eight `0` bytes in
a row anywhere.
"""

from mountfw.wire.own_reply import DECIDE_US, OWN, UNDECIDED

# messages
NEED_BYTES = 0
STOP = 1  # `!`
ZEROS = 2  # eight `0` in a row that did not end a frame or spoil a line
FRAME = 3
LINE = 4
MALFORMED = 5
TOO_LONG = 6
SUSPECT = 7  # a frame that may be our own reply; FRAME or OWN_REPLY follows
OWN_REPLY = 8  # what the board has sent came back
WAS_OWN_REPLY = 9  # the same of what has just been MALFORMED

FRAME_GAP_US = 50_000  # an unfinished frame, or a skipped tail, is given up after this silence
LINE_GAP_US = 1_000_000  # an unfinished line

EIGHTH_ZERO = 0xB0  # how a `0` that completes eight is stored; what else is above 0x7F is stored as 0x7F

_BOUNDARY = 0
_IN_FRAME = 1
_IN_LINE = 2
_SKIPPING = 3  # the rest of something refused or cut, up to a line end or a gap
_DECIDING = 4  # a frame is held: what follows it decides
_RETURNED = 5  # the rest of our own reply, up to a gap

_STOP = 0x21
_CTRL_C = 0x03  # reaches us only where it is not the console's
_ZERO = 0x30
_SIGNS = b"0+-"  # frame.SIGNS
_POWERS = (0, 100, 10, 1)  # of the digits of a field
_CR_AT = 8  # where in a line of an echo its end stands
_FRAME_LENGTH = 8
_TOO_LONG = -2  # what line.feed() says
_AT_ONCE = 3  # bytes that one call of next() parses at most: a piece of work must be short


class Link:
    """The receiving side. frame and line are mountfw's Frame and Line; pack is frame.pack(); own an OwnReply.

    The port fills the ring: by receive(), or with faster code that does the same. So these are for both:
    ring, mask (its size is a power of two), write (the index of the next byte), unparsed
    and zeros. The ring is larger than the buffers below us together (USB and stdin: 0.8 KB on the
    RP2040), so that what waits there can be searched for stops at once, however slowly it is obeyed.
    """

    def __init__(self, frame, line, pack, own, size=4096):
        self.stops_ahead = 0  # received, not yet parsed: nothing may start before them
        self.unparsed = 0  # bytes received, not yet parsed
        self.ahead = 0  # of these: compared already with our own reply, and not enough to decide
        self.ring = bytearray(size)
        self.mask = size - 1
        self.write = 0
        self.zeros = 0  # that came last, in a row
        self._frame = frame
        self._line = line
        self._pack = pack
        self._own = own
        self._comparing = False  # is what is skipped compared with our own reply?
        self._state = _BOUNDARY

    def receive(self, c):
        """Store byte c, if unparsed <= mask. STOP or ZEROS if it completes that stop, else NEED_BYTES."""
        stop = NEED_BYTES
        if c == _ZERO:
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

    def next(self):
        """The next message, or NEED_BYTES: all that was received is parsed, or enough for one call."""
        read = self.write - self.unparsed
        if self._state == _BOUNDARY and self.unparsed >= _FRAME_LENGTH:
            packed = self._pack(self.ring, read, self.mask)  # no frame if there is a stop in it
            if packed >= 0:
                self._frame.take(packed)
                self.unparsed -= _FRAME_LENGTH
                return self._judge() if self._own.wary or self.unparsed > 1 else FRAME
        if self._state == _DECIDING:
            return self._decide()
        for _ in range(_AT_ONCE):
            if not self.unparsed:
                break
            c = self.ring[read & self.mask]
            read += 1
            self.unparsed -= 1
            # in a line, what is neither a stop nor mpremote goes straight to it
            message = self._in_line(c) if self._state == _IN_LINE and 0x22 <= c < 0x80 else self._parse(c)
            if message:
                return message
        return NEED_BYTES

    def gap_us(self):
        """How long a silence the present state bears; 0 at a message boundary: for ever."""
        state = self._state
        if state == _BOUNDARY:
            return 0
        if state == _DECIDING:
            return DECIDE_US
        return LINE_GAP_US if state == _IN_LINE else FRAME_GAP_US

    def deciding(self):
        """Is a frame held? Then silence is counted from what was sent, too."""
        return self._state == _DECIDING

    def gap(self):
        """That silence is over (a poll has just said that nothing waits). MALFORMED, NEED_BYTES, or the held FRAME."""
        state = self._state
        self._state = _BOUNDARY
        self._comparing = False
        self.ahead = 0
        if state == _DECIDING:
            return FRAME
        return MALFORMED if state == _IN_FRAME or state == _IN_LINE else NEED_BYTES

    # ---- our own reply

    def _judge(self):
        """A frame is whole. FRAME; or SUSPECT or OWN_REPLY, if it may be our own."""
        own = self._own
        packed = self._frame.packed
        if own.suspects(packed):
            if own.is_number(packed):
                return self._decided(OWN)
            own.expect(packed)
            self._state = _DECIDING
            return SUSPECT
        if self.unparsed < 2 or not own.may_end_line(self.ring[self.write - self.unparsed & self.mask]):
            return FRAME
        own.expect(packed)
        while self.ahead < self.unparsed:  # what is here already may tell, however long ago it was sent
            verdict = own.feed(self._after())
            if verdict:
                return self._decided(verdict)
        return self._decided(UNDECIDED)

    def _decide(self):
        """Compare what follows the held frame. FRAME, OWN_REPLY, or NEED_BYTES."""
        for _ in range(_AT_ONCE):
            if self.ahead >= self.unparsed:
                break
            verdict = self._own.feed(self._after())
            if verdict:
                return self._decided(verdict)
        return NEED_BYTES

    def _after(self):
        """The next byte after the held frame; it is not parsed yet."""
        at = self.write - self.unparsed + self.ahead
        self.ahead += 1
        return self.ring[at & self.mask]

    def _decided(self, verdict):
        self.ahead = 0
        if verdict == OWN:
            self._state = _RETURNED
            return OWN_REPLY
        self._state = _BOUNDARY
        return FRAME

    def _skip(self, c):
        """Byte c of what is skipped. WAS_OWN_REPLY if it tells that this is our own reply."""
        if self._comparing:
            verdict = self._own.feed(c)
            self._comparing = verdict == UNDECIDED
            if verdict == OWN:
                self._state = _RETURNED
                return WAS_OWN_REPLY
        if c == 10 or c == 13:
            self._state = _BOUNDARY
            self._comparing = False
        return NEED_BYTES

    # ---- parsing

    def _parse(self, c):
        state = self._state
        if c == _STOP or c == _CTRL_C:
            self.stops_ahead -= 1
            self._comparing = False
            if state != _BOUNDARY and state != _RETURNED:
                self._state = _SKIPPING  # the tail of the cut message is never obeyed
            return STOP
        if c < 0x20 and (c == 1 or c == 2 or c == 4 or c == 5 or c == 0x18):
            return NEED_BYTES  # mpremote, knocking
        stopped = c == EIGHTH_ZERO
        if stopped:
            self.stops_ahead -= 1
            c = _ZERO
        message = NEED_BYTES
        if state == _IN_LINE:
            # in text, zeros would go on
            message = self._refuse(c, MALFORMED, self._line) if stopped else self._in_line(c)
        elif state == _IN_FRAME:
            message = self._in_frame(c)
        elif state == _BOUNDARY:
            message = self._first_byte(c)
        elif state == _SKIPPING:
            message = self._skip(c)
        return ZEROS if stopped and not message else message

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
        self._line.start()
        return self._refuse(c, MALFORMED, self._line)

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
            return self._judge() if self._own.wary or self.unparsed > 1 else FRAME
        return self._refuse(c, MALFORMED, frame)

    def _in_line(self, c):
        line = self._line
        result = line.feed(c)
        if result > 0:
            self._state = _BOUNDARY
            return self._decided(OWN) if self._own.is_answer(line, c) == OWN else LINE
        if result < 0:
            return self._refuse(c, TOO_LONG if result == _TOO_LONG else MALFORMED, line)
        return NEED_BYTES

    def _refuse(self, c, message, part):
        """This part of a message (a Frame or a Line) and c cannot be parsed."""
        self._state = _BOUNDARY if c == 10 or c == 13 else _SKIPPING
        verdict = self._own.refused(part, c, self._frame.packed)
        self._comparing = verdict == UNDECIDED
        return self._decided(OWN) if verdict == OWN else message


_CHARACTERS = tuple([bytes((c,)) for c in range(0x20, 0x40)])


class Replies:
    """The sending side: a bounded queue. A reply that does not fit is dropped whole.

    begin(), then add() and put(), then commit(); or echo(). read() while waiting. It holds texts,
    numbers and frames as they are and makes bytes of them as they are sent, so that answering takes
    little of one pass. A text must not change until it is sent.
    """

    def __init__(self, own, size=256):
        self._own = own  # an OwnReply: it is told what is sent
        self._items = [None] * size  # texts (bytes), numbers and echoes; size is a power of two
        self._mask = size - 1
        self.waiting = False  # has read() a byte?
        self._tail = 0
        self._head = 0  # end of what may be sent
        self._end = 0  # end of the reply in the making
        self._lost = False
        self._at = 0  # in the text or echo that is being sent
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

    def put(self, c):
        """Add character c: a digit, a sign or a space, 0x20 ... 0x3F."""
        self.add(_CHARACTERS[c - 0x20])

    def echo(self, packed):
        """The echo of a packed frame, as the paper's sketch gives it: a whole reply. False if it did not fit."""
        head = self._head
        mask = self._mask
        if head - self._tail & mask > mask - 2:
            return False
        self._items[head] = None  # says that a frame follows
        self._items[head + 1 & mask] = packed
        self._head = head + 2 & mask
        self.waiting = True
        return True

    def commit(self):
        """End the reply. False if it did not fit: then nothing of it is sent."""
        if not self._lost:
            self._head = self._end
            self.waiting = self._tail != self._head
        return not self._lost

    def read(self):
        """The next byte to send."""
        item = self._items[self._tail]
        if item is None:
            return self._echoed(self._items[self._tail + 1 & self._mask])
        if type(item) is int:
            c = self._digit(item)
            if not self._power:
                self._sent()
        else:
            c = item[self._at]
            self._at += 1
            if self._at == len(item):
                self._at = 0
                self._sent()
        self._own.answered(c)
        return c

    def _digit(self, n):
        """The sign or next digit of n; it was the last one if _power is 0 then."""
        power = self._power
        negative = n < 0
        if negative:
            n = -n
        if not power:
            power = 1
            while n // power >= 10:
                power *= 10
            self._power = power
            if negative:
                return 0x2D
        self._power = power // 10
        return _ZERO + n // power % 10

    def _echoed(self, packed):
        """Five lines: 0 the frame, 1 and 2 its numbers, 3 and 4 their magnitudes. _at is 16 x line + place."""
        line = self._at >> 4
        place = self._at & 0xF
        if self._at == 0:
            self._own.said(packed)
        self._at += 1
        if place == _CR_AT:
            return 13
        if place > _CR_AT:
            self._at = line + 1 << 4
            if line == 4:
                self._at = 0
                self._sent()
                self._sent()
            return 10
        if line == 0:
            field = packed >> 10 if place < 4 else packed
            place &= 3
            return _SIGNS[field >> 8 & 3] if place == 0 else _ZERO + (field & 0xFF) // _POWERS[place] % 10
        field = packed >> 10 if line & 1 else packed
        n = field & 0xFF
        c = self._digit(-n if line < 3 and field & 0x200 else n)
        if not self._power:
            self._at = line << 4 | _CR_AT
        return c

    def _sent(self):
        self._tail = self._tail + 1 & self._mask
        self.waiting = self._tail != self._head
