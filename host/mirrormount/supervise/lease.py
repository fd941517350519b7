"""Who has the panel open, who of them controls, and whose page is alive. Pure: told the time, it waits for nothing.

The panel sends every page a tick many times a second: its own clock. A page that is alive says the last tick
that it has seen with all that it sends. So the age of a tick that comes back is how long ago that page, its
browser and the network between were known to work; an order that a sleeping phone or a broken network has
kept back carries an old tick, and is refused. No clock but the panel's own is needed.
"""

import itertools
import secrets
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

TICK_S = 0.05  # between two ticks
CONNECTED = 24  # pages that may be open at a time
WAITING, WAITING_HERE = 32, 8  # pages that have no connection, of all clients and of one
SILENT_S = 0.35  # a page that has not been heard of for so long is not alive: its motion is stopped (--patience)


@dataclass(eq=False)
class Page:
    """One open page. heard_s: the tick, in seconds, that it was last known to have seen.

    key: the secret of this page, in its HTML and nowhere else; its driving socket begins with it.
    """

    number: int
    where: str
    key: str = field(default_factory=lambda: secrets.token_urlsafe(16))
    heard_s: float = float("-inf")
    drop: Callable[[], object] = lambda: None  # free what it takes
    connection: object = None
    notices: deque[str] = field(default_factory=lambda: deque(maxlen=20))  # to be shown there, and nowhere else

    @property
    def connected(self) -> bool:
        """True while its driving socket is open."""
        return self.connection is not None

    @property
    def name(self) -> str:
        """What the others call it."""
        return f"page {self.number} ({self.where})"


class Desk:
    """All open pages. At most one controls; the others watch, and may stop.

    silent_s: a page that has not been heard of for so long is not alive.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, silent_s: float = SILENT_S) -> None:
        self._clock = clock
        self._silent_s = silent_s
        self._numbers = itertools.count(1)
        self._pages: list[Page] = []
        self.controller: Page | None = None

    @property
    def pages(self) -> tuple[Page, ...]:
        """Those that are connected."""
        return tuple(page for page in self._pages if page.connected)

    def tick(self) -> int:
        """The panel's clock, in ms."""
        return int(self._clock() * 1000)

    def add(self, where: str) -> Page:
        """A page that is being built, and has not sent anything yet. Older ones that never did are dropped."""
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
        """True if there is no room for one more connected page."""
        return len(self.pages) >= CONNECTED

    def find(self, key: str) -> Page | None:
        """The page of that key, connected or not."""
        given = key.encode("utf-8", "replace")  # JSON may hold half a character
        return next((page for page in self._pages if secrets.compare_digest(page.key.encode(), given)), None)

    def enter(self, page: Page, connection: object) -> None:
        """It has come by this connection; an older one of it counts no more. Who comes first controls."""
        page.connection = connection
        page.heard_s = self._clock()
        if self.controller is None:
            self.controller = page

    def leave(self, page: Page, connection: object) -> bool:
        """This connection has ended. True if the page has gone with it: then nobody controls, if it did."""
        if page.connection is not connection:
            return False
        page.connection = None
        page.heard_s = float("-inf")
        if self.controller is page:
            self.controller = None
        return True

    def forget(self, page: Page) -> None:
        """It will not come back."""
        self.leave(page, page.connection)
        if page in self._pages:
            self._pages.remove(page)

    def hear(self, page: Page, tick: object) -> bool:
        """A message with this tick has come from it. True if the tick is fresh."""
        if isinstance(tick, bool) or not isinstance(tick, int):
            return False
        seen_s = max(0, min(tick, self.tick())) / 1000
        page.heard_s = max(page.heard_s, seen_s)
        return self._clock() - seen_s <= self._silent_s

    def alive(self, page: Page) -> bool:
        """True if it was known to work a moment ago."""
        return page.connected and self._clock() - page.heard_s <= self._silent_s

    def claim(self, page: Page) -> None:
        """From now on this page controls."""
        if page.connected:
            self.controller = page
