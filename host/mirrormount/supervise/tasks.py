"""A queue of what the worker's thread is to do with the mount, and questions to the mount as futures."""

import contextlib
import queue
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from mirrormount.common.errors import ConnectionLost, MountError, NoAnswer
from mirrormount.device.mount import Mount
from mirrormount.supervise.reconnect import Connection

T = TypeVar("T")


def _ignore(_why: MountError) -> None:
    """The outcome is not awaited."""


class Tasks:
    """Any thread adds tasks, one thread runs them in their order."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[Callable[[], None], Callable[[MountError], None]]] = queue.SimpleQueue()
        self._closed: MountError | None = None

    def add(self, run: Callable[[], None], fail: Callable[[MountError], None] = _ignore) -> None:
        """fail(why): called instead of run() if it cannot be run any more."""
        self._waiting.put((run, fail))
        if self._closed:
            self.close(self._closed)

    def ask(self, connection: Connection, work: Callable[[Mount], T], then: Callable[[Mount], None]) -> "Future[T]":
        """Run work(mount), then then(mount). The future raises MountError, also if another board has come meanwhile."""
        future: Future[T] = Future()
        asked = connection.mount

        def run() -> None:
            if not future.set_running_or_notify_cancel():
                return
            mount = connection.mount
            if mount is None or mount is not asked:
                why = connection.trouble or "the board had gone meanwhile"
                future.set_exception(ConnectionLost(f"nothing was done: {why}"))
                return
            try:
                result = work(mount)
                then(mount)
                future.set_result(result)
            except (ConnectionLost, NoAnswer) as e:
                future.set_exception(e)
                raise
            except Exception as e:
                future.set_exception(e)

        def fail(why: MountError) -> None:
            if future.set_running_or_notify_cancel():
                future.set_exception(why)

        self.add(run, fail)
        return future

    def run_next(self, timeout_s: float) -> None:
        """Wait for a task for at most timeout_s, and run it. Raises what it raises."""
        with contextlib.suppress(queue.Empty):
            run, _ = self._waiting.get(timeout=timeout_s)
            run()

    def close(self, why: MountError) -> None:
        """Run no more: those that wait, and all that are added later, fail."""
        self._closed = why  # before the queue is emptied: what is added meanwhile finds it
        with contextlib.suppress(queue.Empty):
            while True:
                self._waiting.get_nowait()[1](why)
