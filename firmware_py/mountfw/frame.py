"""The 8-character frame `sddd sddd` (without the space): two signed speeds. Pure.

`s` is `0` or `+` for positive, `-` for negative; each number is -255 ... 255. It is the
frame of the paper's Arduino sketch, whose clients therefore work unchanged. The host uses
encode() for the other direction.
"""

MORE = 0
DONE = 1
BAD = -1

_ZERO = 0x30
_PLUS = 0x2B
_MINUS = 0x2D


class Frame:
    """Takes a frame a byte at a time and refuses it at the first byte that cannot continue it."""

    def __init__(self):
        self.text = bytearray(8)
        self.length = 0
        self.m1 = 0
        self.m2 = 0
        self._magnitude = 0

    def start(self):
        """Forget what was there; the next byte is the first of a frame."""
        self.length = 0

    def feed(self, c):
        """Take byte c. MORE, DONE (m1, m2 and text are the frame's) or BAD."""
        i = self.length
        place = i & 3
        if place == 0:
            if c != _ZERO and c != _PLUS and c != _MINUS:
                return BAD
            self._magnitude = 0
        else:
            n = self._magnitude * 10 + c - _ZERO
            # the hundreds digit alone is not judged: `05` may still become the address `05>`
            if not _ZERO <= c <= _ZERO + 9 or n > 255 or (place == 2 and n > 25):
                return BAD
            self._magnitude = n
        self.text[i] = c
        self.length = i + 1
        if place < 3:
            return MORE
        n = -self._magnitude if self.text[i - 3] == _MINUS else self._magnitude
        if i == 3:
            self.m1 = n
            return MORE
        self.m2 = n
        return DONE


def encode(m1, m2):
    """The frame that drives motor 1 at m1 and motor 2 at m2 (integers, -255 ... 255), as bytes.

    Raises ValueError outside that range. Host side only: it allocates.
    """
    for n in (m1, m2):
        if not -255 <= n <= 255:
            raise ValueError("a frame's speed must be within -255 ... 255")
    return b"".join(b"%s%03d" % (b"-" if n < 0 else b"0", abs(n)) for n in (m1, m2))
