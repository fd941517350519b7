"""What is kept of a mount's board for all pages: named positions, and the Zeros that can be undone.

A database may let somebody wait, and one thread has the board. So the databases are read in other threads, when they
have changed; whoever refreshes a page gets what is known, at once. `Back` is a way of the page (page_moves.py).
"""

import asyncio
import itertools
import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from mirrormount.device import presets, records
from mirrormount.device.mount import Mount
from mirrormount.device.presets import Preset, Presets
from mirrormount.errors import BadValue, ConnectionLost, MountError, PositionDoubtful
from mirrormount.supervise.requests import MoveTo
from mirrormount.supervise.worker import Worker
from mirrormount.values import STEPS
from mirrormount_panel.mounts import Page
from mirrormount_panel.page_moves import PageMove, PageMoves, ask_board

if TYPE_CHECKING:
    from mirrormount_panel.spot_moves import SpotMoves

T = TypeVar("T")

_EVERY_S = 0.5  # between two looks whether a database has changed


class Reading(Generic[T]):
    """What a database says of the board of a worker, read anew when it has changed. For one asyncio loop.

    file: its name (records.py); read(mount): in another thread; it must not ask the board. value: None before the first
    reading. trouble: why it cannot be read, "" if it can. number: another one with each reading.
    """

    def __init__(self, worker: Worker, file: str, read: Callable[[Mount], T]) -> None:
        self.value: T | None = None
        self.trouble = ""
        self.number = 0
        self._worker = worker
        self._file = file
        self._read = read
        self._seen: tuple[Mount, bytes] | None = None
        self._next_s = 0.0
        self._task: asyncio.Task[None] | None = None

    def refresh(self) -> None:
        """Look soon whether it has changed; returns at once."""
        mount = self._worker.mount
        if mount and time.monotonic() >= self._next_s and (self._task is None or self._task.done()):
            self._next_s = time.monotonic() + _EVERY_S
            self._task = asyncio.get_running_loop().create_task(self._look(mount))

    async def _look(self, mount: Mount) -> None:
        try:
            version = await asyncio.to_thread(records.version, self._file)
            if self._seen == (mount, version):
                return
            if self._seen is None or self._seen[0] is not mount:
                self.value = None  # of another board: not to be shown if the reading fails
            self._seen = mount, version
            self.value = await asyncio.to_thread(self._read, mount)
            self.trouble = ""
        except MountError as e:
            self._seen = None
            if str(e) == self.trouble:
                return
            self.trouble = str(e)
        self.number += 1


@dataclass(frozen=True)
class Kept:
    """The positions, the last one that was kept first; and the axes that have a Zero to undo."""

    positions: tuple[Preset, ...] = ()
    zeroed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Doubted:
    """A question to a page: go to this position all the same? number: an answer names the question by it."""

    number: int
    preset: Preset
    beam: bool
    doubts: tuple[str, ...]


class Positions:
    """The named positions of a worker's mount, for all pages. For one asyncio loop.

    spots: the moves of the spot in the panel's camera, where it has one. doing: what a way to a position does, in a
    line. done: by axis, what the last undo of a Zero has done.
    """

    def __init__(self, worker: Worker, moves: PageMoves, spots: "SpotMoves | None" = None) -> None:
        self.worker = worker
        self.spots = spots
        self.doing = ""
        self.done: dict[str, str] = {}
        self.reading = Reading(worker, presets.FILE, _kept)
        self._moves = moves
        self._numbers = itertools.count(1)
        self._doubted: weakref.WeakKeyDictionary[Page, Doubted] = weakref.WeakKeyDictionary()

    @property
    def kept(self) -> Kept:
        """What is known of the databases."""
        return self.reading.value or Kept()

    # ---- what moves nothing: each waits in another thread; all raise MountError

    async def keep(self, name: str) -> str:
        """Keep the present position, with the spot if the panel's camera sees one. Returns what was done, in words."""

        def keep() -> str:
            kept = self._presets()
            if self.spots is None:
                kept.keep(name)
                return f"{name} is kept"
            before = ask_board(self.worker, _at)
            try:
                spot = self.spots.seen()
            except MountError as e:
                kept.keep(name)
                return f"{name} is kept, without a spot: {e}"
            if kept.keep(name, spot=spot, seen_at=before).spot is None:
                return f"{name} is kept, without a spot: the mount has moved while the camera looked"
            return f"{name} is kept with its spot"

        return await asyncio.to_thread(keep)

    async def remove(self, name: str) -> None:
        """Forget a position."""
        await asyncio.to_thread(lambda: self._presets().remove(name))

    async def undo_zero(self, axis: str) -> str:
        """Give an axis the coordinates from before its last Zero. Returns what was done, in words."""
        self._moves.give_way()
        done = await asyncio.to_thread(lambda: self._presets().undo_zero(axis))
        self.done[axis] = f"{time.strftime('%H:%M:%S')} {done}"
        return done

    # ---- Back

    def back(self, page: Page, message: Mapping[str, Any]) -> None:
        """An order of a page: go to a position, and with "beam" then bring the spot to its place. Raises BadValue.

        Where there are doubts the page is asked (question()), and "sure" in the next order is the question's number.
        """
        name, beam, sure = message.get("name"), message.get("beam") is True, message.get("sure")
        if not isinstance(name, str):
            raise BadValue("a position has a name")
        if beam and self.spots is None:
            raise BadValue("this panel has no camera")
        asked = self._doubted.pop(page, None)
        agreed = asked if asked and asked.number == sure else None
        what = f"the way back to {name[:40]}"
        self._moves.begin(page, what, lambda move: self._back(move, name, beam, agreed), self._say)

    def question(self, page: Page) -> Doubted | None:
        """What this page is asked."""
        return self._doubted.get(page)

    def withdraw(self, page: Page, number: int) -> None:
        """That question is not to be answered any more."""
        asked = self._doubted.get(page)
        if asked and asked.number == number:
            del self._doubted[page]

    def _say(self, text: str) -> None:
        self.doing = text

    def _presets(self) -> Presets:
        mount = self.worker.mount
        if mount is None:
            raise ConnectionLost(f"nothing was done: {self.worker.connection.trouble}")
        return Presets(mount, lambda work: ask_board(self.worker, work))

    # ---- in the way's own thread

    def _back(self, move: PageMove, name: str, beam: bool, agreed: Doubted | None) -> str:
        page = move.page
        assert isinstance(page, Page)
        kept = self._presets()
        preset = kept.get(name)
        spot = self.spots.check(name, preset.spot) if beam and self.spots else None
        if move.ask(lambda mount: mount.status().moving):
            raise BadValue("the mount moves: wait for its end, or press STOP")
        doubts = tuple(kept.doubts(preset))
        if doubts and (agreed is None or agreed != Doubted(agreed.number, preset, beam, doubts)):
            self._doubted[page] = Doubted(next(self._numbers), preset, beam, doubts)
            return ""
        where = ", ".join(f"{axis.name} {place.position:+.3f}" for axis, place in kept.axes(preset)).replace("-", "−")
        move.announce(f"back to {name}: {where} steps")
        for axis, place in kept.axes(preset):
            if tuple(kept.doubts(preset)) != doubts:
                raise PositionDoubtful("something that its numbers hang on was changed on the way")
            if move.ask(lambda mount, name=axis.name: mount.status().by_name[name].position) != place.position:
                move.say(f"back to {name}: {axis.name} goes to {place.position:+.3f}; STOP ends it".replace("-", "−"))
                move.make(MoveTo(axis.name, place.position, STEPS), axis.name)
        if spot is None or self.spots is None:
            return f"back at {name}, by steps"
        arrival = self.spots.bring(move, spot)
        end = "" if arrival.reached else ": press it again"
        return f"back at {name}; the spot is {arrival.off_px:.1f} px from where it was kept{end}"


def _at(mount: Mount) -> dict[int, float]:
    return {number: axis.position for number, axis in enumerate(mount.status().axes, 1)}


def _kept(mount: Mount) -> Kept:
    known = Presets(mount)
    return Kept(tuple(reversed(known.all())), tuple(known.zeroed()))
