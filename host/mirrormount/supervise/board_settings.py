"""The board's settings as all pages see them: read once, known until somebody changes them, kept for an undo."""

import asyncio
from collections.abc import Callable, Mapping

from mirrormount.common.errors import MountError
from mirrormount.device.mount import Mount
from mirrormount.supervise.worker import Pilot

Settings = Mapping[str, Mapping[str, int | float]]


class BoardSettings:
    """One for all pages. before: what was in force before they were last replaced as a whole; None: nothing to undo."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self._known: tuple[Mount, Settings] | None = None
        self._reading: asyncio.Future[Settings] | None = None
        self._before: tuple[str, Settings] | None = None  # of which board

    @property
    def before(self) -> Settings | None:
        """What undo() brings back."""
        mount = self._pilot.mount
        return self._before[1] if self._before and mount and mount.board_id == self._before[0] else None

    async def read(self) -> Settings:
        """What the board has now. However many pages ask, the board is asked once. Raises MountError."""
        if self._known and self._known[0] is self._pilot.mount:
            return self._known[1]
        if self._reading is None:
            self._reading = asyncio.wrap_future(self._pilot.call(self._ask))
            self._reading.add_done_callback(self._read)
        return await asyncio.shield(self._reading)

    async def change(self, work: Callable[[Mount], object]) -> None:
        """Have work(mount) change something. Raises MountError."""

        def change(mount: Mount) -> None:
            try:
                work(mount)
            finally:
                self._known = None

        await asyncio.wrap_future(self._pilot.call(change, changes=True))

    async def replace(self, work: Callable[[Mount], object]) -> None:
        """The same for a change of all at once (factory, saved), which can be undone. Raises MountError."""

        def change(mount: Mount) -> None:
            before = mount.settings()
            work(mount)
            # a second click on Factory changes nothing, and keeps what the first one has replaced
            if self.before is None or mount.settings() != before:
                self._before = mount.board_id, before

        await self.change(change)

    async def undo(self) -> None:
        """Bring back what was in force before replace(). Raises MountError; then it can be tried again."""
        before = self.before
        if before is None:
            raise MountError("nothing was done: there is nothing to undo")
        await self.change(lambda mount: mount.apply(before))
        self._before = None

    def _ask(self, mount: Mount) -> Settings:
        settings = mount.settings()
        self._known = mount, settings
        return settings

    def _read(self, reading: "asyncio.Future[Settings]") -> None:
        self._reading = None
        if not reading.cancelled():
            reading.exception()  # whoever waits for it raises it
