"""select on the virtual board: a poll object for stdin or stdout."""

import _seam

POLLIN = 1
POLLOUT = 4


class _Poll:
    def __init__(self):
        self._events = 0
        self._ready = ()

    def register(self, stream, events):
        if events not in (POLLIN, POLLOUT):
            raise ValueError("poll for input or for output, one object each")
        self._events = events
        self._ready = ((stream, events),)

    def modify(self, stream, events):
        self.register(stream, events)

    def ipoll(self, timeout=-1):
        s = _seam.seam
        s.tick(5)
        if self._events == POLLOUT:
            return self._ready if s.collects else ()
        if timeout and not s.received():
            s.wait(s.t + (timeout * 1000 if timeout > 0 else 60_000_000))
        return self._ready if s.received() else ()


def poll():
    return _Poll()
