"""The card with the wire log."""

import time
from collections.abc import Callable

from nicegui import ui

from mirrormount.panel.cards_of_motion import card
from mirrormount.supervise.wire_log import Entry
from mirrormount.supervise.worker import Worker

_SHOWN = 300


def build(worker: Worker, name: str) -> Callable[[], None]:
    """A card that opens to the last lines of both directions. name: the mount's, for its file; "" of the only one."""
    with card("Wire log"), ui.expansion("What goes over the wire").classes("fold") as fold:
        with ui.element("div").classes("line"):
            polls = ui.checkbox("with the questions after the state")
            ui.element("span").classes("spring")
            ui.button("Save as a file", on_click=lambda: _download(worker, name)).props("no-caps flat dense")
        log = ui.log(max_lines=_SHOWN).classes("wire mono")
    seen = [0]

    def refresh() -> None:
        if not fold.value:
            return
        entries = worker.log.since(seen[0])
        if entries:
            seen[0] = entries[-1].number
            for entry in [e for e in entries if polls.value or not e.poll][-_SHOWN:]:
                log.push(_text(entry))

    return refresh


def _text(entry: Entry) -> str:
    clock = time.strftime("%H:%M:%S", time.localtime(entry.at_s)) + f"{entry.at_s % 1:.3f}"[1:]
    return f"{clock} {'→' if entry.to_board else '←'} {entry.text}"


def _download(worker: Worker, name: str) -> None:
    file = "-".join(["mirrormount-wire", *name.split()]) + ".txt"
    ui.download.content("\n".join(map(_text, worker.log.since(0))) + "\n", file, "text/plain")
