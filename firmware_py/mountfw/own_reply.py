"""Recognises the board's own reply when a terminal driver returns it. Imports receiver, ticks.

A serial port in its default mode (ECHO, as after `stty sane`) returns each byte that it receives. The first line
of the reply to a frame is that frame, so it would drive again, and its reply again. The bytes return complete and in
order; only line ends change (`\\r\\n` may be `\\r\\n\\r\\n`, `\\n` or `^M`). The bytes after a frame decide: after the
board's own one come a line end, the first number alone, and a line end. No host sends that.

A frame that the board sent lately is therefore executed only after that decision. If the port is known not to
echo, `wary` is 0 and a frame is executed at once. Nothing here allocates.

It stands beside wire/, not in it: the Receiver takes it as an object and knows its three verdicts only.
"""

from mountfw import const
from mountfw.wire.receiver import OTHER, OWN, UNDECIDED
from mountfw.wire.ticks import diff

_QUIET_US = const(100_000)  # the port does not echo if bytes sent so long ago have not returned ...
_QUIET_FOR_US = const(2_000_000)  # ... and that holds so long: another program may open the port in another mode
_WINDOW_US = const(1_000_000)  # sent frames are remembered for one of these, at most two
_MUTED_US = const(1_000_000)  # no reply to frames for so long, after one has returned

_BUCKETS = const(29)  # of frames: a packed frame modulo this is its bit
_ANSWER = 1 << _BUCKETS  # the bit of all other replies; still a small integer
_MAGNITUDES = const(0x3FCFF)  # in a packed frame; both 0: a stop, which never waits
_HEAD = const(8)  # characters of a reply that are compared: as many as a frame has
_ENDS = const(6)  # line ends in a row that one line end may become, and more


class OwnReply:
    """Remembers frames and replies that were sent lately. pack is frame.pack()."""

    def __init__(self, pack):
        self._pack = pack
        self.wary = 0  # the bits of the frames that may return
        self.muted = False
        self.sent_at = 0  # of the last byte
        self._recent = 0  # the bits of frames sent in this window,
        self._older = 0  # and in the one before
        self._window_at = 0
        self._watching = False  # since _watch_at: does anything return?
        self._watch_at = 0
        self._quiet = False  # since _quiet_at: the port does not echo
        self._quiet_at = 0
        self._muted_at = 0
        self._head = bytearray(_HEAD)  # the beginning of the last reply
        self._column = 0  # in the reply that is being sent
        self._head_length = 0
        self._number = -1  # a packed frame that a reply began with, such as -1000000
        self._number_is_new = False  # sent in this window?
        self._expected = bytearray(_HEAD)  # the text that feed() compares with
        self._length = 0
        self._place = 0
        self._ends = 0
        self._caret = False  # was the last byte a `^`?

    # ---- sending

    def sent_frame(self, packed):
        """Record that the reply to this frame begins to be sent."""
        bit = 1 << packed % _BUCKETS
        self._recent |= bit
        if not self._quiet:
            self.wary |= bit

    def sent_byte(self, c):
        """Record that byte c of another reply is sent."""
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
                    self.sent_frame(packed)

    def sent(self, now_us):
        """Record the time: bytes were sent."""
        self.sent_at = now_us
        if not (self._watching or self.muted):
            self._watching = True
            self._watch_at = now_us

    # ---- receiving

    def suspects(self, packed):
        """True if this frame may be the board's own reply, so that it must wait for feed()'s verdict."""
        return self.wary >> packed % _BUCKETS & 1 and packed & _MAGNITUDES

    def is_number(self, packed):
        """True if this frame is a reply's number: nothing follows that, so it cannot be told from the host's."""
        return packed == self._number

    def expect(self, packed):
        """Prepare feed() to compare the bytes after this frame with the reply to it."""
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
        """True if c is a line end, or begins one that is shown as `^M`."""
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

    def compare_refused(self, part, c, packed):
        """Compare a part of a message (a Frame or a Line) and c with the reply to this frame, and the last reply."""
        if (self._recent | self._older) >> packed % _BUCKETS & 1:
            self.expect(packed)
            verdict = self._compare(part, c)
            if verdict != OTHER:
                return verdict
        return self.is_reply(part, c)

    def is_reply(self, part, c):
        """Compare a part of a message and c with the last reply that was no echo."""
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
        """Mute the replies to frames for a while: one has returned."""
        self.doubt()
        self.muted = True
        self._muted_at = now_us

    def doubt(self):
        """Bytes arrived that no host should send: the port may echo again."""
        self._quiet = False
        self._watching = False
        self.wary = self._recent | self._older

    def tick(self, now_us):
        """Update to the time now_us; call it several times in 100 ms."""
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
