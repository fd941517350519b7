"""The input of a port without a fast lane (docs/lane.md): its bytes into the ring. Pure; imports nothing of ours."""


class Look:
    """The input of a port without a lane."""

    def __init__(self, port, lane, receiver):
        self._lane = lane
        self._any = port.any
        self._drain = port.drain
        self._ticks_us = port.ticks_us
        self._receiver = receiver

    def look(self, most, wait_ms):
        """Wait so long for a byte, and read at most so many, no further than to a stop.

        Returns that stop or NEED_BYTES; -1 if no byte came. The lane's woke_at is when the wait was over. With -1 ms it
        does not wait, and a port's own look() takes no frame: something else is under way.
        """
        came = self._any(max(0, wait_ms))
        self._lane.woke_at = self._ticks_us()
        if not came:
            return -1
        stop = self._drain(self._receiver, most)
        self._receiver.received_at = self._ticks_us()
        return stop
