"""What tests of a supervised mount share: a clock that the test turns, a worker on a live board and its log."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from served import wait_for

from mirrormount.supervise.lease import Client, Lease
from mirrormount.supervise.worker import Worker


class AlwaysAlive(Lease):
    """A lease whose connected clients are alive without a beat."""

    def alive(self, client: Client) -> bool:
        return client.connected


@contextmanager
def at_work(lease: Lease, *clock: Callable[[], float]) -> Iterator[Worker]:
    """A worker that has a virtual board of its own, and has seen it."""
    worker = Worker("virtual://", lease, *clock)
    worker.open()
    wait_for(lambda: worker.state.status, "the first poll of the board")
    yield worker
    worker.close()


class Clock:
    """Time in seconds, that passes only when told."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def sent(worker: Worker) -> list[str]:
    """Lines to the board, without the polls."""
    return [entry.text for entry in worker.log.since(0) if entry.to_board and not entry.poll]


def polled(worker: Worker) -> None:
    """Wait until the worker has polled the board twice."""
    for _ in range(2):
        before = worker.state.seen_s
        wait_for(lambda before=before: worker.state.seen_s > before, "a poll")


def moving(worker: Worker) -> bool:
    return worker.state.status is not None and worker.state.status.moving
