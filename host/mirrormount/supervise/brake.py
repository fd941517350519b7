"""A thread that sends stops and nothing else: a stop waits for no other use of the mount."""

import contextlib
import logging
import queue
import threading
from collections.abc import Callable

from mirrormount.device.mount import Mount

_log = logging.getLogger("mirrormount.supervise")


class Brake:
    """Stops the mount that mount() returns; None: there is none."""

    def __init__(self, mount: Callable[[], Mount | None]) -> None:
        self._mount = mount
        self._asked: queue.SimpleQueue[None] = queue.SimpleQueue()  # reentrant, unlike Event.set(): for signal handlers
        self._closing = False
        self._thread = threading.Thread(target=self._send_stops, name="brake", daemon=True)

    def start(self) -> None:
        """Begin to send stops."""
        self._thread.start()

    def pull(self) -> None:
        """Send a stop; returns at once. Any thread, and a signal handler."""
        self._asked.put(None)

    def close(self) -> None:
        """End the thread."""
        self._closing = True
        self._asked.put(None)
        if self._thread.is_alive():
            self._thread.join(5)

    def _send_stops(self) -> None:
        while not self._closing:
            self._asked.get()
            with contextlib.suppress(queue.Empty):  # one halt serves all stops that were asked for before it
                while True:
                    self._asked.get_nowait()
            mount = self._mount()
            if mount:
                try:
                    mount.halt()
                except Exception:  # the worker's next poll finds the cause
                    _log.warning("a stop could not be sent", exc_info=True)
