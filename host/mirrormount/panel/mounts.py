"""The mounts of a panel. Each has an owner and a lease of its own, so each page has a part for each of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from mirrormount.panel.pages import Page, Pages
from mirrormount.supervise.worker import Worker


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
