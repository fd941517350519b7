"""The mounts of a panel, and its pages as their clients.

Each mount has an owner and a lease of its own. A page is a client of each mount, with a secret for each, and there may
be only so many pages. A page's question to the mount is awaited here, and refusals are shown on the page for some
seconds.
"""

import itertools
import secrets
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from nicegui import ui

from mirrormount.errors import MountError
from mirrormount.supervise.lease import Client, Lease
from mirrormount.supervise.worker import Worker

T = TypeVar("T")


# ---- messages on a page


def warn(text: str) -> None:
    """Show a refusal on this page."""
    _show(text, "refused", 6000)


def confirm(text: str) -> None:
    """Show a confirmation on this page."""
    _show(text, "done", 2500)


async def run_on_mount(question: Awaitable[T], done: str = "") -> T | None:
    """Await a question. Returns its result; None after an error, which the page shows."""
    try:
        result = await question
    except MountError as e:
        _show(str(e), "refused", 8000)
        return None
    if done:
        confirm(done)
    return result


def _show(text: str, kind: str, for_ms: int) -> None:
    """Show a message at the bottom, above STOP, where it covers neither the pad nor the header."""
    ok = [{"label": "OK", "color": "white", "noCaps": True}]
    ui.notify(text, position="bottom", timeout=for_ms, classes=f"toast {kind}", actions=ok, badgeColor="grey-10")


# ---- pages

CONNECTED = 24  # So many pages may be open at a time.
WAITING, WAITING_HERE = 32, 8  # Pages that have not connected yet: of all computers, and of one.


class Page(Client):
    """One open page. where: its computer's address.

    key: the secret of this page, in its HTML and nowhere else; its driving socket begins with it. drop(): frees
    what the page takes.
    """

    def __init__(self, number: int, where: str) -> None:
        super().__init__(f"page {number} ({where})", is_person=True)
        self.where = where
        self.key = secrets.token_urlsafe(16)
        self.drop: Callable[[], object] = lambda: None


class Pages:
    """All pages, those included that are built and not connected yet. For one asyncio loop."""

    def __init__(self, lease: Lease) -> None:
        self._lease = lease
        self._numbers = itertools.count(1)
        self._pages: list[Page] = []

    def __len__(self) -> int:
        """How many there are."""
        return len(self._pages)

    def add(self, where: str) -> Page:
        """A page that is being built. Older ones that never connected are dropped."""
        waiting = [page for page in self._pages if not page.connected]
        for most, pages in ((WAITING, waiting), (WAITING_HERE, [p for p in waiting if p.where == where])):
            for page in pages[: max(0, len(pages) + 1 - most)]:
                page.drop()
                self.forget(page)
        page = Page(next(self._numbers), where)
        self._pages.append(page)
        return page

    @property
    def full(self) -> bool:
        """True if no more may connect."""
        return sum(page.connected for page in self._pages) >= CONNECTED

    def find(self, key: str) -> Page | None:
        """The page of that key, connected or not."""
        given = key.encode("utf-8", "replace")  # JSON may hold half a character
        return next((page for page in self._pages if secrets.compare_digest(page.key.encode(), given)), None)

    def forget(self, page: Page) -> None:
        """It will not come back."""
        self._lease.leave(page, page.connection)
        if page in self._pages:
            self._pages.remove(page)

    def close(self) -> None:
        """The panel is ending: free what all pages take."""
        for page in list(self._pages):
            page.drop()
            self.forget(page)


# ---- mounts


class Orders(NamedTuple):
    """Orders beside those of requests.py. by_name: each is called with the page and its message, may raise BadValue.

    give_way(): called before any request of requests.py is carried out.
    """

    by_name: Mapping[str, Callable[[Page, Mapping[str, Any]], None]] = {}
    give_way: Callable[[], None] = lambda: None


@dataclass(frozen=True)
class PanelMount:
    """One mount. name: as the table has it; "" where it is the only one. pages: the parts that pages have for it."""

    name: str
    worker: Worker
    pages: Pages
    orders: Orders = field(default_factory=Orders)


Part = tuple[PanelMount, Page]


def find(mounts: Sequence[PanelMount], key: str) -> Part | None:
    """The mount and the page's part for it that have that key; None if there is none."""
    found = ((mount, mount.pages.find(key)) for mount in mounts)
    return next(((mount, page) for mount, page in found if page), None)


def stop_all(mounts: Sequence[PanelMount], cause: str, *, tell: bool = True) -> None:
    """All motors of all mounts off, now; returns at once. As Worker.stop()."""
    for mount in mounts:
        mount.worker.stop(cause, tell=tell)
