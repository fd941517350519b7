"""The 8-character frame `sddd sddd` (without the space): two signed speeds. Pure.

`s` is `0` or `+` for positive, `-` for negative; each number is -255 ... 255. It is the frame of the paper's Arduino
sketch, whose clients therefore work unchanged.

A frame is also one integer of 20 bits, "packed": two fields of 10, each with the sign as it was written (2 bits:
0 is `0`, 1 is `+`, 2 is `-`) and the magnitude (8 bits).
"""

from mountfw import const

MORE = const(0)
DONE = const(1)
BAD = const(-1)

LENGTH = const(8)

ZERO = const(0x30)
PLUS = const(0x2B)
MINUS = const(0x2D)
PROBE = const(0x23)  # `#`, a line before the first echo: a port that returns it would return the echo, too (replies.py)


def pack(ring, at, mask):
    """The packed frame in the eight bytes from index `at` of a ring (mask: its size - 1); BAD if they are no frame."""
    packed = 0
    for _ in range(2):
        sign = ring[at & mask]
        n = ring[at + 1 & mask] - ZERO
        tens = ring[at + 2 & mask] - ZERO
        units = ring[at + 3 & mask] - ZERO
        if not (0 <= n <= 2 and 0 <= tens <= 9 and 0 <= units <= 9):
            return BAD
        n = n * 100 + tens * 10 + units
        if n > 255 or (sign != ZERO and sign != PLUS and sign != MINUS):
            return BAD
        packed = packed << 10 | (2 if sign == MINUS else 1 if sign == PLUS else 0) << 8 | n
        at += 4
    return packed


class Frame:
    """Parses a frame byte by byte and refuses it at the first byte that cannot continue it.

    pack is the function above, or a faster one of the same effect.
    """

    def __init__(self, pack=pack):
        self._pack = pack
        self.text = bytearray(LENGTH)
        self.length = self.packed = self.m1 = self.m2 = 0

    def start(self):
        """Clear: the next byte is the first of a frame."""
        self.length = 0
        for i in range(LENGTH):  # a byte that has not come yet is taken as `0`, which always fits
            self.text[i] = ZERO

    def feed(self, c):
        """Parse byte c. MORE, DONE (packed, m1 and m2 are set) or BAD."""
        i = self.length
        before = self.text[i]
        self.text[i] = c
        packed = self._pack(self.text, 0, LENGTH - 1)
        # the hundreds digit alone may be above 2: `05` may still become the address `05>`
        if packed < 0 and not (i & 3 == 1 and ZERO <= c <= ZERO + 9):
            self.text[i] = before
            return BAD
        self.length = i + 1
        if self.length < LENGTH:
            return MORE
        self.unpack(packed)
        return DONE

    def unpack(self, packed):
        """Set packed, m1 and m2 from a packed frame."""
        self.packed = packed
        n = packed >> 10 & 0xFF
        self.m1 = -n if packed & 0x80000 else n
        n = packed & 0xFF
        self.m2 = -n if packed & 0x200 else n
