"""What a deploy answers to `mirrormount stop` (transport/stop_socket.py), as long as it has the port."""

import contextlib
import threading
from collections.abc import Iterator

from mirrormount.common.errors import MountError
from mirrormount.transport.lines import Link
from mirrormount.transport.stop_socket import SENT, STOPPED, StopListener

_OPENS_S = 1.0  # longest time until the port is open


class StopAnswer:
    """Answers a stop: nothing drives once the firmware was found at rest.

    An interrupted firmware turns the motors off, and one that starts has them off. Until then the stop is written.
    """

    def __init__(self) -> None:
        self._link: Link | None = None
        self._at_rest = False
        self._known = threading.Event()

    def asking(self, link: Link) -> None:
        """On this link the firmware is asked whether a motor moves."""
        self._link = link
        self._known.set()

    def found(self, at_rest: bool) -> None:
        """It said that none does. False: no firmware of ours has answered, so a stop means nothing to the board."""
        self._at_rest = at_rest
        self._link = None

    def stop(self) -> str:
        """STOPPED or SENT. Raises MountError."""
        if not self._known.wait(_OPENS_S):
            raise MountError("it has yet to open the port")
        if self._at_rest:
            return STOPPED
        if (link := self._link) is None:
            raise MountError("the board had no firmware that takes a stop; what ran there was interrupted")
        link.port.write(b"!\n")  # without the link's lock, which a hanging exchange may hold
        return SENT


@contextlib.contextmanager
def stop_answered(port: str) -> Iterator[StopAnswer]:
    """A socket for stops, for as long as this lasts."""
    answer = StopAnswer()
    listener = StopListener([port], answer.stop)
    try:
        yield answer
    finally:
        listener.close()
