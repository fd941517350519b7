"""The card of what has moved: the last lines of the log of motions (docs/presets.md)."""

import asyncio
import io
import time
from collections.abc import Callable

from nicegui import ui

from mirrormount.cli.presets import in_words, write_csv
from mirrormount.device import motion_log
from mirrormount.device.motion_log import LoggedMotion
from mirrormount.device.mount import Mount
from mirrormount.supervise.worker import Worker
from mirrormount_panel.cards import card
from mirrormount_panel.mounts import run_on_mount, warn
from mirrormount_panel.positions import Reading

_SHOWN, _SAVED = 50, 5000  # motions


def log_card(worker: Worker, name: str) -> Callable[[], None]:
    """A card that opens to the last motions of the mount's board. It reads nothing while it is closed.

    name: the mount's, for its file; "" of the only one.
    """
    reading = Reading(worker, motion_log.FILE, _last)

    async def save() -> None:
        mount = worker.mount
        if mount is None:
            warn(f"nothing was done: {worker.connection.trouble}")
        elif text := await run_on_mount(asyncio.to_thread(_csv, mount.board_id)):
            ui.download.content(text, "-".join(["mirrormount-motions", *name.split()]) + ".csv", "text/csv")

    with card("What has moved"), ui.expansion("Which motions, by whom, how they ended").classes("fold") as fold:
        with ui.element("div").classes("line"):
            ui.label(f"The last {_SHOWN}, newest first. The file has the last {_SAVED}, in UTC.").classes("hint grow")
            ui.button("Save as a file", on_click=save).props("no-caps flat dense")
        rows = ui.element("div").classes("news moved").props("role=log tabindex=0 aria-label='What has moved'")
    shown = [-1]

    def refresh() -> None:
        if not fold.value:
            return
        reading.refresh()
        if reading.number == shown[0]:
            return
        shown[0] = reading.number
        rows.clear()
        with rows:
            for motion, what in reversed(reading.value or []):
                _row(motion, what)
            if reading.trouble or not reading.value:
                ui.label(reading.trouble or "Nothing that this board has moved is logged.").classes("hint")

    return refresh


def when(at_s: float) -> str:
    """A time for a person: of today without the day."""
    then = time.localtime(at_s)
    return time.strftime("%H:%M:%S" if then[:3] == time.localtime()[:3] else "%Y-%m-%d %H:%M", then)


def _row(motion: LoggedMotion, what: str) -> None:
    with ui.element("div").classes("notice"):
        ui.label(when(motion.ended)).classes("mono hint")
        with ui.element("div").classes("grow"):
            ui.label(what.replace("-", "−"))
            ui.label(f"by {motion.who}").classes("hint")


def _last(mount: Mount) -> list[tuple[LoggedMotion, str]]:
    return list(in_words(motion_log.read(board=mount.board_id, most=_SHOWN)))


def _csv(board: str) -> str:
    table = io.StringIO()
    write_csv(motion_log.read(board=board, most=_SAVED), table)
    return table.getvalue()
