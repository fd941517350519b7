"""Random messages for the board, good and bad. All choices are the given generator's.

Ctrl-C (0x03) is never in them: it belongs to the interpreter and would end the firmware.
"""

import random

from mirrormount.device.frame import encode

_SETTINGS = (("XP", 200, 2_000_000), ("XD", 1, 255), ("XV", 1, 255), ("XM", 1, 400_000), ("XT", 1, 400_000))
_FLAGS = (("XI", 1), ("XL", 3), ("ZH", 1))
_QUERIES = (
    *("*IDN?", "VE?", "TE?", "TB?", "PH?", "XS?", "XK?", "XF?"),
    *("TP?", "PA?", "PR?", "MV?", "MD?", "DH?", "VA?", "XP?", "XD?", "XV?", "XI?", "XL?", "XM?", "XT?", "XE?", "ZH?"),
)
_ENDS = (b"\n", b"\r", b"\r\n")


def frame(r: random.Random) -> bytes:
    """A good frame, with or without a line end."""
    m1, m2 = (r.choice((0, 255, -255, r.randrange(-255, 256))) for _ in range(2))
    text = encode(m1, m2)
    if r.random() < 0.1:
        text = text.replace(b"0", b"+", 1) if text[:1] == b"0" else text
    return text + r.choice((b"", b"", *_ENDS))


def line(r: random.Random) -> bytes:
    """A line that is well formed; not all of it can be done."""
    text = ";".join(_command(r) for _ in range(r.choice((1, 1, 1, 2, 3, 5))))
    if r.random() < 0.1:
        text = f"{r.randrange(32)}>{text}"
    if r.random() < 0.1:
        text = text.lower()
    return text.encode() + r.choice(_ENDS)


def _command(r: random.Random) -> str:
    axis = r.choice(("1", "1", "1", "2", "2", "2", "3", "9", ""))
    kind = r.random()
    if kind < 0.35:
        return _motion(r, axis)
    if kind < 0.6:
        return r.choice((axis, axis, "")) + r.choice(_QUERIES)
    if kind < 0.7:
        name, most = r.choice(_FLAGS)
        return f"{axis}{name}{r.randrange(most + 1)}"
    if kind < 0.8:
        return f"XK{r.choice((0, r.randrange(20, 3000)))}"
    if kind < 0.95:
        name, least, most = r.choice(_SETTINGS)
        return f"{axis}{name}{round(least * (most / least) ** r.random())}"
    return r.choice(("AT", f"{axis}XP1", f"{axis}PR", f"{axis}VA0", f"{axis}OR", "ZZ9", f"{axis}XM400001"))


def _motion(r: random.Random, axis: str) -> str:
    return r.choice(
        (
            f"{axis}PR{r.randrange(-20, 21)}",
            f"{axis} PR {r.randrange(-3, 4)}",
            f"{axis}PA{r.randrange(-50, 51)}",
            f"{axis}PR{r.randrange(-2_000_000, 2_000_001)}",
            f"{axis}MV{r.choice('+-')}",
            f"{axis}MV{r.choice('+-')}",
            f"{axis}ST",
            "ST",
            "AB",
            f"{axis}DH{r.randrange(-1000, 1000)}",
            f"{axis}VA{r.randrange(1, 5000)}.{r.randrange(100):02d}",
        )
    )


def malformed(r: random.Random) -> bytes:
    """A message that was damaged on its way, or noise; now and then it is still a good one."""
    if r.random() < 0.3:
        return bytes(r.choice((*range(3), *range(4, 256))) for _ in range(r.randrange(1, 40)))
    data = bytearray(good_message(r))
    for _ in range(r.choice((1, 1, 2))):
        i = r.randrange(len(data))
        data[i : i + r.randrange(2)] = bytes(
            r.choice(b"0123456789+-;?!XPRMV\n \x00\xff") for _ in range(r.randrange(2))
        )
        data = data or bytearray(b"#")
    return bytes(data)


def good_message(r: random.Random) -> bytes:
    """A frame or a line."""
    return r.choice((frame, line))(r)


def any_message(r: random.Random) -> bytes:
    """A good one, or a damaged one."""
    return r.choice((good_message,) * 4 + (malformed,))(r)
