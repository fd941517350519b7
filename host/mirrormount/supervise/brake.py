"""A thread that does nothing but send stops: none waits for what another thread does with the mount."""

import contextlib
import logging
import queue
import threading
from collections.abc import Callable

from mirrormount.device.mount import Mount

_log = logging.getLogger("mirrormount.panel")


class Brake:
    """mount(): the one to be stopped, None if there is none."""

    def __init__(self, mount: Callable[[], Mount | None]) -> None:
        self._mount = mount
        self._asked: queue.SimpleQueue[None] = queue.SimpleQueue()  # an Event's set() may not be interrupted by itself
        self._closing = False
        self._thread = threading.Thread(target=self._stand_by, name="brake", daemon=True)

    def start(self) -> None:
        """From now on stops are sent."""
        self._thread.start()

    def pull(self) -> None:
        """Have a stop sent, and return at once. Any thread, and a handler of a signal."""
        self._asked.put(None)

    def close(self) -> None:
        """Send no more."""
        self._closing = True
        self._asked.put(None)
        if self._thread.is_alive():
            self._thread.join(5)

    def _stand_by(self) -> None:
        while not self._closing:
            self._asked.get()
            with contextlib.suppress(queue.Empty):  # one halt serves all stops asked for before it
                while True:
                    self._asked.get_nowait()
            mount = self._mount()
            if mount:
                try:
                    mount.halt()
                except Exception:  # the pilot's next look finds out, and says so; the brake stands by
                    _log.warning("a stop could not be sent", exc_info=True)
