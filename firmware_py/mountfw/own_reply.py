"""Recognises the board's own reply when a terminal driver returns it. Imports receiver, ticks.

A serial port in its default mode (ECHO, as after `stty sane`) returns each byte that it receives. The first line
of the reply to a frame is that frame, so it would drive again, and its reply again. The bytes return complete and in
order; only line ends change (`\\r\\n` may be `\\r\\n\\r\\n`, `\\n` or `^M`). The bytes after a frame decide: after the
board's own one come a line end, the first number alone, and a line end. No host sends that.

A frame that the board sent lately is therefore executed only after that decision. If the port is known not to
echo, `wary` is 0 and a frame is executed at once. Nothing here allocates.

OwnReply remembers what was sent, and compares. WaryReceiver is the Receiver of a board: it asks that of each message.
"""

from mountfw import codes, const
from mountfw.wire.receiver import BOUNDARY, FRAME, HELD, LINE, NEED_BYTES, SKIPPING, Receiver
from mountfw.wire.ticks import diff

# messages of a WaryReceiver, besides those of a Receiver: obey() acts on them
SUSPECT = const(7)  # a frame that may be the board's own reply; FRAME or OWN_REPLY follows
OWN_REPLY = const(8)  # bytes that the board had sent came back
WAS_OWN_REPLY = const(9)  # the same of bytes that were MALFORMED

# verdicts of OwnReply.feed()
UNDECIDED = const(0)
OTHER = const(1)
OWN = const(2)

_RETURNED = const(5)  # a state: the rest of the board's own reply, up to a gap
_AT_ONCE = const(4)  # bytes that are compared at most in one piece of work

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
        if part.length > 1 and part.text[1] != self._head[1]:  # 0.5 ms sooner than byte by byte
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
        """Update to the time now_us; call it several times a second."""
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


class WaryReceiver(Receiver):
    """A Receiver on a port that may echo. own is an OwnReply."""

    def __init__(self, frame, line, pack, own, size=4096):
        super().__init__(frame, line, pack, size)
        self._own = own
        self._comparing = False  # are skipped bytes compared with the board's own reply?

    def silent_us(self, now_us):
        """Since the last byte; while a frame is held, in both directions."""
        silent_us = diff(now_us, self.received_at)
        if self.state == HELD:
            silent_us = min(silent_us, diff(now_us, self._own.sent_at) & 0x3FFFFFFF)  # it may be long ago
        return silent_us

    def obey(self, message, controller, now_us):
        """Act on SUSPECT, OWN_REPLY or WAS_OWN_REPLY."""
        if message == SUSPECT:
            controller.off_first(self._frame.m1, self._frame.m2)
            return
        if message == WAS_OWN_REPLY:
            controller.errors.retract(codes.MALFORMED)
        controller.malformed(codes.OWN_REPLY)
        self._own.returned(now_us)

    def gap(self):
        """As a Receiver's; the held FRAME, if there is one, and what is behind it stays."""
        self._comparing = False
        if self.state == HELD:
            return self._decided(OTHER)
        if self.state == _RETURNED:
            self.state = SKIPPING
        return super().gap()

    def _whole(self):
        """The frame is complete. FRAME; or SUSPECT or OWN_REPLY, if the board may have sent it."""
        own = self._own
        packed = self._frame.packed
        if own.suspects(packed):
            if own.is_number(packed):
                return self._decided(OWN)
            own.expect(packed)
            self.state = HELD
            return SUSPECT
        if self.unparsed < 2 or not own.may_end_line(self.ring[self.write - self.unparsed & self.mask]):
            return FRAME
        own.expect(packed)
        return self._decide(self.unparsed) or self._decided(UNDECIDED)  # what is here may decide, however old it is

    def _decide(self, most=_AT_ONCE):
        """Compare at most so many bytes after the held frame; they stay unparsed. FRAME, OWN_REPLY, or NEED_BYTES."""
        while most and self.ahead < self.unparsed:
            verdict = self._own.feed(self.ring[self.write - self.unparsed + self.ahead & self.mask])
            self.ahead += 1
            most -= 1
            if verdict:
                return self._decided(verdict)
        return NEED_BYTES

    def _decided(self, verdict):
        self.ahead = 0
        self.state = _RETURNED if verdict == OWN else BOUNDARY
        return OWN_REPLY if verdict == OWN else FRAME

    def _stopped(self):
        self._comparing = False
        if self.state != _RETURNED:
            super()._stopped()

    def _skip(self, c):
        """Skip byte c. WAS_OWN_REPLY if it proves that the skipped bytes are the board's own reply."""
        if self._comparing:
            verdict = self._own.feed(c)
            self._comparing = verdict == UNDECIDED and c != 10 and c != 13
            if verdict == OWN:
                self.state = _RETURNED
                return WAS_OWN_REPLY
        return super()._skip(c)

    def _refuse(self, c, message, part):
        super()._refuse(c, message, part)
        verdict = self._own.compare_refused(part, c, self._frame.packed)
        self._comparing = verdict == UNDECIDED
        return self._decided(OWN) if verdict == OWN else message

    def _ended(self, c):
        return self._decided(OWN) if self._own.is_reply(self._line, c) == OWN else LINE
