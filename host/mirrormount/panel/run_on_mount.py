"""What a page says to its user for a moment, and how a question to the mount ended."""

from collections.abc import Awaitable
from typing import TypeVar

from nicegui import ui

from mirrormount.common.errors import MountError

T = TypeVar("T")


def warn(text: str) -> None:
    """Show this page why nothing was done."""
    _show(text, "refused", 6000)


def confirm(text: str) -> None:
    """Show this page what was done."""
    _show(text, "done", 2500)


async def ask(question: Awaitable[T], done: str = "") -> T | None:
    """What the question returns; None after an error, which the page shows."""
    try:
        result = await question
    except MountError as e:
        _show(str(e), "refused", 8000)
        return None
    if done:
        confirm(done)
    return result


def _show(text: str, kind: str, for_ms: int) -> None:
    """At the bottom, above STOP: no key of the pad is covered there, nor what is in the header."""
    ok = [{"label": "OK", "color": "white", "noCaps": True}]
    ui.notify(text, position="bottom", timeout=for_ms, classes=f"toast {kind}", actions=ok, badgeColor="grey-10")
