"""The input of a MicroPython board without a fast lane: native, it takes 24 us a byte in the loop, bytecode 100."""

import micropython

from mountfw.ports.micropython_console import byte_in, ipoll_in, readinto
from mountfw.wire.receiver import EIGHTH_ZERO, STOP, ZEROS

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
