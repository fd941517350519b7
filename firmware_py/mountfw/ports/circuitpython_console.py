"""A CircuitPython board's USB serial channel as a stream of bytes.

It is usb_cdc.data where boot.py has enabled that: the console stays the REPL's, and 0x03 is a stop. Where there are
too few USB endpoints for two channels it is usb_cdc.console, and 0x03 interrupts the program.

A host that disconnects (its program ends, its port closes, the cable is pulled) stops all motion: after all bytes
that the host has sent, the loop receives one more `!`.
"""

import select

import usb_cdc

from mountfw.wire.frame import pack  # noqa: F401 (a verb of this port, too: there is no native code to be faster)


class _NoChannel:
    """The channel where boot.py has enabled none: no byte ever arrives."""

    connected = False
    in_waiting = 0
    out_waiting = 1024

    def readinto(self, _buffer):
        return 0

    def write(self, _data):
        return 0


_channel = usb_cdc.data or usb_cdc.console or _NoChannel()

_STOP = 0x21  # `!`
_GONE_MS = 16  # a host that has gone is noticed within this, though the loop sleeps longer
_OUTPUT = 64  # bytes: the smallest buffer for output that a USB device has; less than that waits if it can take more

_byte_in = bytearray(1)
_byte_out = bytearray(1)
_there = False  # whether a host was connected at the last check


def _prepare():
    """Make the channel non-blocking. Returns the ipoll() of a poll object for input.

    ipoll() allocates only for its first answer, which is given here, for output.
    """
    if isinstance(_channel, _NoChannel):
        return _no_input
    _channel.timeout = 0
    _channel.write_timeout = 0
    poll = select.poll()  # pyright: ignore[reportAttributeAccessIssue]
    poll.register(_channel, select.POLLOUT)  # pyright: ignore
    ipoll = poll.ipoll  # pyright: ignore[reportAttributeAccessIssue]
    for _ in ipoll(0):
        pass
    poll.modify(_channel, select.POLLIN)  # pyright: ignore
    return ipoll


def _no_input(_wait_ms):
    return ()


_ipoll_in = _prepare()
_readinto = _channel.readinto
_write = _channel.write


def any(wait_ms):
    """True as soon as a byte waits, or when the host has gone; False after wait_ms without one."""
    while True:
        for _ in _ipoll_in(min(wait_ms, _GONE_MS)):
            return True
        wait_ms -= _GONE_MS
        if _there != _channel.connected and _has_left():
            return True
        if wait_ms <= 0:
            return False


def drain(receiver, most):
    """Pass received bytes to Receiver.receive(): at most `most`, and none after a stop.

    Returns that stop, or NEED_BYTES.
    """
    taken = 0
    while taken < most and receiver.unparsed <= receiver.mask:
        if not _readinto(_byte_in):
            return receiver.receive(_STOP) if not taken and _take_leave() else 0
        taken += 1
        stop = receiver.receive(_byte_in[0])
        if stop:
            return stop
    return 0


def _has_left():
    """True if a host was connected and none is now. A host that has connected is noted."""
    global _there
    if _channel.connected:
        _there = True
        return False
    return _there


def _take_leave():
    """As _has_left(), once for each host that has left."""
    global _there
    left = _has_left()
    if left:
        _there = False
    return left


def writable():
    """True if write() will not lose its byte."""
    return _channel.out_waiting < _OUTPUT


def write(c):
    """Send byte c."""
    _byte_out[0] = c
    _write(_byte_out)
