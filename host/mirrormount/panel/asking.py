"""One question to the mount from a page's button: wait for it without blocking, and say how it ended."""

import asyncio
from collections.abc import Callable
from typing import TypeVar

from nicegui import ui

from mirrormount.client import Mount
from mirrormount.errors import MountError
from mirrormount.panel.pilot import Pilot

T = TypeVar("T")


def warn(text: str) -> None:
    """Show this page why nothing was done."""
    ui.notify(text, type="warning", textColor="white", position="top", timeout=6000, close_button="OK")


async def ask(pilot: Pilot, work: Callable[[Mount], T], done: str = "") -> T | None:
    """What work(mount) returns, done in the mount's thread; None after an error, which the page shows."""
    try:
        result = await asyncio.wrap_future(pilot.call(work))
    except MountError as e:
        ui.notify(str(e), type="negative", position="top", timeout=8000, close_button="OK")
        return None
    if done:
        ui.notify(done, type="positive", position="top", timeout=2500)
    return result
