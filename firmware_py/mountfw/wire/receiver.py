"""Bytes in, messages out. Pure (sans-IO); imports nothing of ours.

receive() stores a byte and reports at once that it completes a stop, before anything is parsed. next() returns the
next message, or NEED_BYTES. Two stops that nothing can swallow: `!` anywhere, and eight `0` bytes in a row anywhere.
"""

# messages
NEED_BYTES = 0
STOP = 1  # `!`
ZEROS = 2  # eight `0` in a row, unless they end a frame or make a line MALFORMED
FRAME = 3
LINE = 4
MALFORMED = 5
TOO_LONG = 6
SUSPECT = 7  # a frame that may be the board's own reply; FRAME or OWN_REPLY follows
OWN_REPLY = 8  # bytes that the board had sent came back
WAS_OWN_REPLY = 9  # the same of bytes that were MALFORMED

# verdicts of OwnReply.feed()
UNDECIDED = 0
OTHER = 1
OWN = 2

FRAME_GAP_US = 50_000  # an unfinished frame, or a skipped tail, times out after this silence
LINE_GAP_US = 1_000_000  # an unfinished line
DECIDE_US = 20_000  # after this silence, in both directions, a held frame is the host's: an echo comes within 1 ms

EIGHTH_ZERO = 0xB0  # stands in the ring for a `0` that completes eight; other bytes above 0x7F are stored as 0x7F

BOUNDARY = 0  # states
IN_FRAME = 1
_IN_LINE = 2
_SKIPPING = 3  # the rest of something refused or cut, up to a line end or a gap
_DECIDING = 4  # a frame is held: the bytes after it decide
_RETURNED = 5  # the rest of the board's own reply, up to a gap
_GAPS_US = (0, FRAME_GAP_US, LINE_GAP_US, FRAME_GAP_US, DECIDE_US, FRAME_GAP_US)  # of these

_STOP = 0x21
_CTRL_C = 0x03  # arrives only on a channel that is not the console
_ZERO = 0x30
_FRAME_LENGTH = 8
_TOO_LONG = -2  # of Line.feed()
_AT_ONCE = 4  # bytes that one call of next() parses at most: a piece of work must be short


class Receiver:
    """The receiving side. frame is a Frame, line a Line (dialect/line.py), own an OwnReply; pack is frame.pack().

    The port fills the ring, by receive() or with faster code of the same effect: ring, mask (size - 1; the size is a
    power of two), write (index of the next byte), unparsed and zeros are for both. The ring holds more than the buffers
    below it together (USB and stdin: 0.8 KB on the RP2040), so that no stop waits there for messages to be executed.
    """

    def __init__(self, frame, line, pack, own, size=4096):
        self.stops_ahead = 0  # received, not yet parsed: nothing may start before them
        self.unparsed = 0  # bytes received, not yet parsed
        self.ahead = 0  # of these: compared with the board's own reply, still undecided
        self.ring = bytearray(size)
        self.mask = size - 1
        self.write = 0
        self.zeros = 0  # that came last, in a row
        self._frame = frame
        self._line = line
        self._pack = pack
        self._own = own
        self._comparing = False  # are skipped bytes compared with the board's own reply?
        self.state = BOUNDARY

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
        """The next message; NEED_BYTES if every byte is parsed, or enough of them for one call."""
        read = self.write - self.unparsed
        if self.state == BOUNDARY and self.unparsed >= _FRAME_LENGTH:
            packed = self._pack(self.ring, read, self.mask)  # no frame if there is a stop in it
            if packed >= 0:
                self._frame.unpack(packed)
                self.unparsed -= _FRAME_LENGTH
                return self._judge() if self._own.wary or self.unparsed > 1 else FRAME
        if self.state == _DECIDING:
            return self._decide(_AT_ONCE)
        for _ in range(_AT_ONCE):
            if not self.unparsed:
                break
            c = self.ring[read & self.mask]
            read += 1
            self.unparsed -= 1
            # in a line, bytes that are neither a stop nor mpremote's go straight to it
            message = self._in_line(c) if self.state == _IN_LINE and 0x22 <= c < 0x80 else self._parse(c)
            if message:
                return message
        return NEED_BYTES

    def gap_us(self):
        """The silence after which gap() is due; 0 at a message boundary: never."""
        return _GAPS_US[self.state]

    def deciding(self):
        """True while a frame is held: then silence counts from the last byte sent, too."""
        return self.state == _DECIDING

    def gap(self):
        """Time out (a poll has just found no byte). MALFORMED, NEED_BYTES, or the held FRAME."""
        state = self.state
        self.state = BOUNDARY
        self._comparing = False
        self.ahead = 0
        if state == _DECIDING:
            return FRAME
        return MALFORMED if state == IN_FRAME or state == _IN_LINE else NEED_BYTES

    # ---- the board's own reply

    def _judge(self):
        """A frame is complete. FRAME; or SUSPECT or OWN_REPLY, if the board may have sent it."""
        own = self._own
        packed = self._frame.packed
        if own.suspects(packed):
            if own.is_number(packed):
                return self._decided(OWN)
            own.expect(packed)
            self.state = _DECIDING
            return SUSPECT
        if self.unparsed < 2 or not own.may_end_line(self.ring[self.write - self.unparsed & self.mask]):
            return FRAME
        own.expect(packed)
        return self._decide(self.unparsed) or self._decided(UNDECIDED)  # what is here may decide, however old it is

    def _decide(self, most):
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

    def _skip(self, c):
        """Skip byte c. WAS_OWN_REPLY if it proves that the skipped bytes are the board's own reply."""
        if self._comparing:
            verdict = self._own.feed(c)
            self._comparing = verdict == UNDECIDED
            if verdict == OWN:
                self.state = _RETURNED
                return WAS_OWN_REPLY
        if c == 10 or c == 13:
            self.state = BOUNDARY
            self._comparing = False
        return NEED_BYTES

    # ---- parsing

    def _parse(self, c):
        state = self.state
        if c == _STOP or c == _CTRL_C:
            self.stops_ahead -= 1
            self._comparing = False
            if state != BOUNDARY and state != _RETURNED:
                self.state = _SKIPPING  # the tail of the cut message is never executed
            return STOP
        if c < 0x20 and (c == 1 or c == 2 or c == 4 or c == 5 or c == 0x18):
            return NEED_BYTES  # mpremote looks for a prompt
        stopped = c == EIGHTH_ZERO
        if stopped:
            self.stops_ahead -= 1
            c = _ZERO
        message = NEED_BYTES
        if state == _IN_LINE and stopped:  # in text, zeros would continue it
            message = self._refuse(c, MALFORMED, self._line)
        elif state == _IN_LINE:
            message = self._in_line(c)
        elif state == IN_FRAME:
            message = self._in_frame(c)
        elif state == BOUNDARY:
            message = self._first_byte(c)
        elif state == _SKIPPING:
            message = self._skip(c)
        return message or (ZEROS if stopped else NEED_BYTES)

    def _first_byte(self, c):
        if c == 10 or c == 13 or c == 0x20 or c == 0:
            return NEED_BYTES
        if c == _ZERO or c == 0x2D or c == 0x2B:
            self._frame.start()
            self._frame.feed(c)
            self.state = IN_FRAME
            return NEED_BYTES
        if 0x31 <= c <= 0x39 or 0x41 <= c & 0xDF <= 0x5A or c == 0x2A:
            self.state = _IN_LINE
        self._line.start()
        return self._in_line(c) if self.state == _IN_LINE else self._refuse(c, MALFORMED, self._line)

    def _in_frame(self, c):
        frame = self._frame
        if c == 0x3E and frame.length < 3 and frame.text[0] == _ZERO:  # `0>` or `0d>`: an address
            self._line.start()
            self.state = _IN_LINE
            for i in range(frame.length):
                self._line.feed(frame.text[i])
            return self._in_line(c)
        result = frame.feed(c)
        if result < 0:
            return self._refuse(c, MALFORMED, frame)
        if result == 0:
            return NEED_BYTES
        self.state = BOUNDARY
        return self._judge() if self._own.wary or self.unparsed > 1 else FRAME

    def _in_line(self, c):
        line = self._line
        result = line.feed(c)
        if result > 0:
            self.state = BOUNDARY
            return self._decided(OWN) if self._own.is_reply(line, c) == OWN else LINE
        if result < 0:
            return self._refuse(c, TOO_LONG if result == _TOO_LONG else MALFORMED, line)
        return NEED_BYTES

    def _refuse(self, c, message, part):
        """This part of a message (a Frame or a Line) and c cannot be parsed."""
        self.state = BOUNDARY if c == 10 or c == 13 else _SKIPPING
        verdict = self._own.compare_refused(part, c, self._frame.packed)
        self._comparing = verdict == UNDECIDED
        return self._decided(OWN) if verdict == OWN else message
