"""The owner of one mount for several programs of a process, with or without a panel."""

from collections.abc import Callable
from concurrent.futures import Future
from types import TracebackType
from typing import Self, TypeVar

from mirrormount.common.keep_alive import PATIENCE_S
from mirrormount.device.mount import Mount
from mirrormount.device.status import Status
from mirrormount.supervise.lease import Lease
from mirrormount.supervise.program import Program
from mirrormount.supervise.reconnect import Address
from mirrormount.supervise.worker import Worker

T = TypeVar("T")


class Supervisor:
    """Opens a mount, and carries out the requests of the client that has control. Use `with`.

    address: as Mount.open(); None: the only board that is plugged in; or what opens a port. patience_s: silence of a
    client after which its motion is stopped. A board that goes away is opened again when it is back; no motion is
    resumed.
    worker: for a server of its own, such as the panel.
    """

    def __init__(self, address: Address = None, *, patience_s: float = PATIENCE_S) -> None:
        self.worker = Worker(address, Lease(patience_s=patience_s))

    def open(self, *, absent: bool = False) -> Self:
        """Connect; motors that moved are stopped. Raises MountError if there is no mount at the address.

        absent: begin without it then; it is looked for every second, and status is None.
        """
        try:
            self.worker.open(absent=absent)
        except BaseException:
            self.worker.close()
            raise
        return self

    def close(self) -> None:
        """Motors off, port closed; outcomes that are awaited become ConnectionLost. Raises MountError."""
        self.worker.close()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def join(self, name: str, lost: Callable[[str], object] | None = None) -> Program:
        """A new client, without control. lost(cause): called when its control ends; must return at once."""
        return Program(name, self.worker, lost)

    @property
    def status(self) -> Status | None:
        """The last status, at most POLL_S old; None while it is not known."""
        return self.worker.state.status if self.worker.state.is_known else None

    def stop(self, cause: str = "the program asked for it") -> None:
        """All motors off, now; returns at once. Any thread, with or without control."""
        self.worker.stop(cause)

    def ask(self, question: Callable[[Mount], T]) -> "Future[T]":
        """Run question(mount), which must neither wait nor move, between two polls. The future raises MountError."""
        return self.worker.call(question)
