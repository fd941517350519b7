"""Recognises what the board itself has sent, when a terminal driver sends it back. Imports ticks.

A serial port in its default mode (ECHO, as after `stty sane`) returns each byte that it receives. The first line
of the reply to a frame is that frame, so it would drive again, and its reply again. What returns is whole and in
order; only line ends change (`\\r\\n` may be `\\r\\n\\r\\n`, `\\n` or `^M`). What follows a frame tells: after the
board's own one comes a line end, the first number alone, and a line end. No host sends that.

A frame that was sent lately is therefore not obeyed before that is decided, unless it is known that nothing returns:
then `wary` is 0, and a frame is obeyed at once. Nothing here allocates.
"""

from mountfw.wire.ticks import diff

# what feed() says
UNDECIDED = 0
OTHER = 1
OWN = 2

DECIDE_US = 20_000  # after this silence, in both directions, a frame is the host's: what returns comes within 1 ms
_QUIET_US = 100_000  # nothing returns if what was sent so long ago has not ...
_QUIET_FOR_US = 2_000_000  # ... and so long that holds: another program may open the port in another mode
_WINDOW_US = 1_000_000  # what was sent is remembered for one of these, at most two
_MUTED_US = 1_000_000  # no reply to frames for so long, after one has returned

_BUCKETS = 29  # of frames: a packed frame modulo this is its bit
_ANSWER = 1 << _BUCKETS  # the bit of all other answers; still a small integer
_MAGNITUDES = 0x3FCFF  # in a packed frame; both 0: it stops, and a stop never waits
_HEAD = 8  # characters of an answer that are compared: those of a frame
_ENDS = 6  # line ends in a row that one line end may become, and more


class OwnReply:
    """What was sent lately. pack is frame.pack()."""

    def __init__(self, pack):
        self._pack = pack
        self.wary = 0  # the bits of the frames that may return
        self.muted = False
        self.sent_at = 0  # when bytes were sent last
        self._recent = 0  # the bits of what was sent in this window,
        self._older = 0  # and in the one before
        self._window_at = 0
        self._watching = False  # is it watched, since _watch_at, whether something returns?
        self._watch_at = 0
        self._quiet = False  # is it known, since _quiet_at, that nothing returns?
        self._quiet_at = 0
        self._muted_at = 0
        self._head = bytearray(_HEAD)  # how the last answer begins
        self._column = 0  # of the answer that is being sent
        self._head_length = 0
        self._number = -1  # a packed frame that an answer began with, such as -1000000
        self._number_is_new = False  # sent in this window?
        self._expected = bytearray(_HEAD)  # what feed() compares with
        self._length = 0
        self._place = 0
        self._ends = 0
        self._caret = False  # was the last byte a `^`?

    # ---- what is sent

    def said(self, packed):
        """The reply to this frame begins to be sent."""
        bit = 1 << packed % _BUCKETS
        self._recent |= bit
        if not self._quiet:
            self.wary |= bit

    def answered(self, c):
        """Byte c of another answer is sent."""
        if c == 10:
            self._column = 0
        elif c != 13 and self._column < _HEAD:
            self._head[self._column] = c
            self._column += 1
            self._head_length = self._column
            self._recent |= _ANSWER
            if self._column == _HEAD and not self._quiet:
                packed = self._pack(self._head, 0, _HEAD - 1)
                if packed >= 0:
                    self._number = packed
                    self._number_is_new = True
                    self.said(packed)

    def sent(self, now_us):
        """Bytes have been sent."""
        self.sent_at = now_us
        if not (self._watching or self.muted):
            self._watching = True
            self._watch_at = now_us

    # ---- what is received

    def suspects(self, packed):
        """May this frame be our own reply, so that it must wait until feed() has decided?"""
        return self.wary >> packed % _BUCKETS & 1 and packed & _MAGNITUDES

    def is_number(self, packed):
        """Is this frame an answer's number? No more follows that, so nothing else tells it from the host's."""
        return packed == self._number

    def expect(self, packed):
        """feed() is to compare what follows this frame with the reply to it."""
        self._ends = 0
        self._caret = False
        self._place = 0
        n = packed >> 10 & 0xFF
        length = 0
        if packed & 0x80000 and n:
            self._expected[0] = 0x2D
            length = 1
        power = 100 if n > 99 else 10 if n > 9 else 1
        while power:
            self._expected[length] = 0x30 + n // power % 10
            length += 1
            power //= 10
        self._length = length

    def may_end_line(self, c):
        """Is c a line end, or how one begins that is shown as `^M`?"""
        return c == 10 or c == 13 or c == 0x5E

    def feed(self, c):
        """Compare byte c: OTHER, OWN, or UNDECIDED so far."""
        place = self._place
        if self._caret:  # `^M`
            return OWN if c == 0x4D or c == 0x4A else OTHER
        if c == 0x5E:
            self._caret = True
            return UNDECIDED if place == 0 or place == self._length else OTHER
        if c == 10 or c == 13:
            if place:
                return OWN if place == self._length else OTHER
            self._ends += 1
            return UNDECIDED if self._ends <= _ENDS else OTHER
        if not self._ends or place >= self._length or c != self._expected[place]:
            return OTHER
        self._place = place + 1
        return OWN if place == _HEAD - 1 else UNDECIDED

    def refused(self, part, c, packed):
        """Compare a part of a message (a Frame or a Line) and c with the reply to this frame, and the last answer."""
        if (self._recent | self._older) >> packed % _BUCKETS & 1:
            self.expect(packed)
            verdict = self._compare(part, c)
            if verdict != OTHER:
                return verdict
        return self.is_answer(part, c)

    def is_answer(self, part, c):
        """Is this part of a message, with c, the last answer or its beginning?"""
        if not (self._recent | self._older) & _ANSWER or (part.length and part.text[0] != self._head[0]):
            return OTHER
        for i in range(_HEAD):
            self._expected[i] = self._head[i]
        self._length = self._head_length
        return self._compare(part, c)

    def _compare(self, part, c):
        self._ends = 1
        self._caret = False
        self._place = 0
        for i in range(part.length):
            verdict = self.feed(part.text[i])
            if verdict:
                return verdict
        return self.feed(c)

    def returned(self, now_us):
        """Our own reply has come back: nothing more is sent that could drive, for a while."""
        self.doubt()
        self.muted = True
        self._muted_at = now_us

    def doubt(self):
        """Something came that no host should send: it is not known any more that nothing returns."""
        self._quiet = False
        self._watching = False
        self.wary = self._recent | self._older

    def tick(self, now_us):
        """Let time pass. To be called some times in 100 ms."""
        if self._watching:
            if diff(now_us, self._watch_at) >= _QUIET_US:
                self._watching = False
                self._quiet = True
                self._quiet_at = now_us
        elif self._quiet and diff(now_us, self._quiet_at) >= _QUIET_FOR_US:
            self._quiet = False
        if self.muted and diff(now_us, self._muted_at) >= _MUTED_US:
            self.muted = False
        if not 0 <= diff(now_us, self._window_at) < _WINDOW_US:
            self._window_at = now_us
            self._older = self._recent
            self._recent = 0
            if not self._number_is_new:
                self._number = -1
            self._number_is_new = False
        self.wary = 0 if self._quiet else self._recent | self._older
