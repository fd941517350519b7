"""Keeps a motion alive from a thread: each status query restarts the board's keep-alive. Imports errors."""

import threading
import time
from collections.abc import Callable

from mirrormount.common.errors import MountError

FEED_S = 0.1  # between two queries


class KeepAlive:
    """is_moving: asks the board whether anything moves; called in the thread. threaded: False in lockstep.

    Without a thread only `active` is kept, and the caller queries the board while it is set.
    """

    def __init__(self, is_moving: Callable[[], bool], threaded: bool) -> None:
        self._is_moving = is_moving
        self._threaded = threaded
        self._active = False
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._starts = 0  # a thread that ends checks whether a motion was started meanwhile
        self._failure: MountError | None = None

    @property
    def active(self) -> bool:
        """True while a motion is kept alive."""
        return self._active

    def start(self) -> None:
        """Keep the motion that was just started alive until it ends."""
        with self._lock:
            self._starts += 1
            self._active = True
            if not self._threaded or self._thread:
                return
            self._thread = threading.Thread(target=self._feed, name="keep-alive", daemon=True)
            self._thread.start()

    def end(self) -> None:
        """Stop feeding. Does not wait for the thread."""
        self._active = False

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for the end of the thread: at the end of the motion, or of end()."""
        thread = self._thread
        if thread:
            thread.join(timeout_s)

    def check(self) -> None:
        """Raise the error that ended the thread, once."""
        failure, self._failure = self._failure, None
        if failure:
            raise failure

    def _feed(self) -> None:
        while True:
            starts, moving = self._starts, False
            try:
                moving = self._active and self._is_moving()
            except MountError as e:
                self._failure = e
            with self._lock:
                if not moving and starts == self._starts:
                    self._active = False
                    self._thread = None
                    return
            time.sleep(FEED_S)
