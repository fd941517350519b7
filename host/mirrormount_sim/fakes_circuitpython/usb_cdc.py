"""usb_cdc on the virtual CircuitPython board. The host reads one channel: data if there is one, else console."""

import _chip
import _seam

_OUTPUT = 256  # bytes that a channel holds


class Serial:
    """One channel. Which one the host reads is known when boot.py has ended."""

    def __init__(self):
        self.timeout = None
        self.write_timeout = None
        self.wired = False

    @property
    def connected(self):
        _seam.seam.tick(2)
        return self.wired and _seam.seam.opened

    @property
    def in_waiting(self):
        s = _seam.seam
        s.tick(2)
        return s.waiting() if self.wired else 0

    @property
    def out_waiting(self):
        _seam.seam.tick(2)
        return _OUTPUT if self.wired and not _seam.seam.collects else 0

    def readinto(self, buffer):
        s = _seam.seam
        s.tick(10)
        if self.timeout != 0:
            raise NotImplementedError("the virtual board's USB never waits: set timeout = 0")
        n = 0
        while n < len(buffer) and self.wired and s.received():
            buffer[n] = s.take()
            n += 1
        return n

    def write(self, data):
        s = _seam.seam
        s.tick(10)
        if self.write_timeout != 0:
            raise NotImplementedError("the virtual board's USB never waits: set write_timeout = 0")
        if not s.collects:
            return 0
        if self.wired:
            for c in data:
                s.sent(c)
        return len(data)


console = Serial()
data = None


def enable(*, console=True, data=False):
    _arrange(console, data)


def disable():
    _arrange(False, False)


def _arrange(with_console, with_data):
    global console, data
    if not _chip.in_boot_py:
        raise RuntimeError("Cannot change USB devices now")
    console = Serial() if with_console else None
    data = Serial() if with_data else None


def plug_in():
    """boot.py has ended. Returns True if the host reads the console."""
    channel = data or console
    if channel:
        channel.wired = True
    return channel is console
