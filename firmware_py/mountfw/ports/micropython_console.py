"""The console of a MicroPython board as a stream of bytes: sys.stdin and sys.stdout.

Native code, since it runs for every byte: pack() takes 15 us for a frame instead of 300. It depends on the processor.
"""

import select
import sys

import micropython

from mountfw.wire.receiver import EIGHTH_ZERO, STOP, ZEROS


def _ipoll(stream, events):
    """The ipoll() of a poll object for events of stream. It allocates nothing, once it has given an answer:
    so it gives one here, about output, which is ready when nothing has been sent yet."""
    poll = select.poll()
    poll.register(stream, select.POLLOUT)
    ipoll = poll.ipoll  # pyright: ignore[reportAttributeAccessIssue]
    for _ in ipoll(0):
        pass
    poll.modify(stream, events)
    return ipoll


ipoll_in = _ipoll(sys.stdin, select.POLLIN)
_ipoll_out = _ipoll(sys.stdout, select.POLLOUT)
readinto = sys.stdin.buffer.readinto  # pyright: ignore[reportAttributeAccessIssue]
_write = sys.stdout.buffer.write
byte_in = bytearray(1)
_byte_out = bytearray(1)


def interrupts():
    """Each turn of this iterator raises a Ctrl-C, if one came, and ends with it. Native code does not look for one."""
    jumps = True
    while jumps:  # no constant, so that the first turn does, too. A call of a function would take twice as long
        yield


@micropython.viper
def pack(ring: ptr8, at: int, mask: int) -> int:  # noqa: F821 # pyright: ignore[reportUndefinedVariable]
    """As frame.pack()."""
    packed = 0
    for _ in range(2):
        sign = ring[at & mask]
        n = ring[(at + 1) & mask] - 0x30
        tens = ring[(at + 2) & mask] - 0x30
        units = ring[(at + 3) & mask] - 0x30
        if n < 0 or n > 2 or tens < 0 or tens > 9 or units < 0 or units > 9:
            return -1
        n = n * 100 + tens * 10 + units
        if n > 255:
            return -1
        packed = (packed << 10) | n
        if sign == 0x2D:
            packed |= 0x200
        elif sign == 0x2B:
            packed |= 0x100
        elif sign != 0x30:
            return -1
        at += 4
    return packed


def writable():
    """True if write() will not block."""
    for _ in _ipoll_out(0):
        return True
    return False


def write(c):
    """Send byte c."""
    _byte_out[0] = c
    _write(_byte_out)


# ---- the input of a board without a fast lane: native, it takes 24 us a byte in the loop, bytecode 100

_eighth_zero = EIGHTH_ZERO
_stop = STOP
_zeros = ZEROS


@micropython.native
def any(wait_ms):
    """True as soon as a byte waits; False after wait_ms without one."""
    for _ in ipoll_in(wait_ms):
        return True
    return False


@micropython.viper
def drain(receiver, most: int) -> int:
    """Do as Receiver.receive() with each byte that waits, at most `most` and no further than to a stop.

    Returns that stop, or NEED_BYTES.
    """
    ring = ptr8(receiver.ring)  # noqa: F821 # pyright: ignore[reportUndefinedVariable] (known to viper)
    mask = int(receiver.mask)
    unparsed = int(receiver.unparsed)
    at = int(receiver.write)
    zeros = int(receiver.zeros)
    byte = ptr8(byte_in)  # noqa: F821 # pyright: ignore[reportUndefinedVariable]
    stop = 0
    waits = 1
    while stop == 0 and waits and most and unparsed <= mask:
        waits = 0
        for _ in ipoll_in(0):
            waits = 1
        if waits:
            readinto(byte_in)
            c = byte[0]
            if c == 0x30:
                zeros += 1
                if zeros == 8:
                    zeros = 0
                    c = int(_eighth_zero)
                    stop = int(_zeros)
            else:
                zeros = 0
                if c == 0x21 or c == 3:
                    stop = int(_stop)
                elif c > 0x7F:
                    c = 0x7F
            ring[at] = c
            at = (at + 1) & mask
            unparsed += 1
            most -= 1
    receiver.write = at
    receiver.unparsed = unparsed
    receiver.zeros = zeros
    if stop:
        receiver.stops_ahead = int(receiver.stops_ahead) + 1
    return stop
