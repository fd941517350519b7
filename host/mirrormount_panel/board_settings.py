"""The board's settings for all pages: changed, replaced, and kept for an undo."""

import asyncio
from collections.abc import Callable

from mirrormount.device.mount import Mount
from mirrormount.errors import MountError
from mirrormount.supervise.worker import Settings, Worker


class BoardSettings:
    """The settings of a worker's mount, for all clients. For one asyncio loop."""

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        self._before: tuple[str, Settings] | None = None  # of which board

    @property
    def axes(self) -> tuple[str, ...]:
        """The names of the mount's axes."""
        return self._worker.state.axes

    @property
    def before(self) -> Settings | None:
        """The settings that undo() brings back, None: nothing to undo."""
        mount = self._worker.mount
        return self._before[1] if self._before and mount and mount.board_id == self._before[0] else None

    async def read(self) -> Settings:
        """The present settings; clients that ask at the same time share one exchange. Raises MountError."""
        return await asyncio.wrap_future(self._worker.settings())

    async def change(self, work: Callable[[Mount], object]) -> None:
        """Run work(mount), which may change settings. Raises MountError."""
        await asyncio.wrap_future(self._worker.call(work, changes=True))

    async def replace(self, work: Callable[[Mount], object]) -> None:
        """Run work(mount), which replaces all settings (factory, saved); it can be undone. Raises MountError."""

        def change(mount: Mount) -> None:
            before = mount.settings()
            work(mount)
            # a second click on Factory changes nothing, and keeps what the first one has replaced
            if self.before is None or mount.settings() != before:
                self._before = mount.board_id, before

        await self.change(change)

    async def undo(self) -> None:
        """Apply the settings from before replace(). Raises MountError; then it can be tried again."""
        before = self.before
        if before is None:
            raise MountError("nothing was done: there is nothing to undo")
        await self.change(lambda mount: mount.apply(before))
        self._before = None
