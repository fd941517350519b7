"""select on the virtual CircuitPython board: a poll object for one channel of usb_cdc."""

import _seam

POLLIN = 1
POLLOUT = 4


class _Poll:
    def register(self, channel, events):
        if events not in (POLLIN, POLLOUT):
            raise ValueError("poll for input or for output, one object each")
        self._channel = channel
        self._events = events
        self._ready = ((channel, events),)

    def modify(self, channel, events):
        self.register(channel, events)

    def ipoll(self, timeout=-1):
        s = _seam.seam
        s.tick(5)
        if self._events == POLLOUT:
            return self._ready if self._channel.out_waiting == 0 else ()
        until = s.t + (timeout * 1000 if timeout >= 0 else 1 << 40)
        while self._channel.wired and not s.received() and s.t < until:
            if s.wait(until):
                break  # return to the test
        return self._ready if self._channel.wired and s.received() else ()


def poll():
    return _Poll()
