"""The board's settings for all pages: read, changed, and what an undo would put back."""

import asyncio
from collections.abc import Callable

from mirrormount.device import settings
from mirrormount.device.mount import Mount
from mirrormount.device.settings import Settings
from mirrormount.errors import NotKept
from mirrormount.supervise.worker import Worker


class BoardSettings:
    """The settings of a worker's mount, for all clients. For one asyncio loop.

    to_undo: what undo() would set, by "x.pulse_us" …; {}: nothing that is known. As of the last read().
    """

    def __init__(self, worker: Worker) -> None:
        self.to_undo: dict[str, int | float] = {}
        self._worker = worker

    @property
    def axes(self) -> tuple[str, ...]:
        """The names of the mount's axes."""
        return self._worker.state.axes

    async def read(self) -> Settings:
        """The present settings; clients that ask at the same time share one exchange. Raises MountError."""
        mount = self._worker.mount
        now = await asyncio.wrap_future(self._worker.settings())
        if mount:
            before = await asyncio.to_thread(settings.former, mount.session.board, now)  # it may wait for a disk
            self.to_undo = settings.differing(now, before) if before else {}
        return now

    async def change(self, work: Callable[[Mount], object]) -> None:
        """Run work(mount), which may change settings; undo() takes it back. Raises MountError."""
        await asyncio.wrap_future(self._worker.call(work, changes=True))

    async def undo(self) -> dict[str, int | float]:
        """Put back the settings from before the last change, as `mirrormount config undo`; twice changes them again.

        Returns what was changed. Raises NotKept also if that would be something else than to_undo; MountError.
        """
        wanted = self.to_undo

        def undo(mount: Mount) -> dict[str, int | float]:
            now = mount.settings()
            before = settings.former(mount.session.board, now)
            if before is None or settings.differing(now, before) != wanted:
                raise NotKept("nothing was done: the settings were changed since this page has read them; look again")
            return mount.undo_settings()

        return await asyncio.wrap_future(self._worker.call(undo, changes=True))
