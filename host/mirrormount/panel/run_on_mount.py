"""A page's question to the mount, and the messages that a page shows for some seconds."""

from collections.abc import Awaitable
from typing import TypeVar

from nicegui import ui

from mirrormount.common.errors import MountError

T = TypeVar("T")


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
