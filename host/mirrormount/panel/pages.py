"""The panel's pages, as clients of a mount: each with a secret, and bounds for how many there may be. Pure.

Where a panel has several mounts, a page is a client of each, with a secret for each.
"""

import itertools
import secrets
from collections.abc import Callable

from mirrormount.supervise.lease import Client, Lease

CONNECTED = 24  # pages that may be open at a time
WAITING, WAITING_HERE = 32, 8  # pages without a connection, of all computers and of one


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
