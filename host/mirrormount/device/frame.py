"""The frame that drives both motors: mountfw/wire/frame.py has its grammar, and parses it."""


def encode(m1: int, m2: int) -> bytes:
    """The frame that drives motor 1 at m1 and motor 2 at m2, -255 … 255. Raises ValueError outside that range."""
    for n in (m1, m2):
        if not -255 <= n <= 255:
            raise ValueError("a frame's speed must be within -255 ... 255")
    return b"".join(b"%s%03d" % (b"-" if n < 0 else b"0", abs(n)) for n in (m1, m2))
