"""The page, made of its cards. Built for every browser that loads it; updates itself."""

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import app, ui

from mirrormount.panel import card_of_settings, card_of_wire, cards_of_motion, cards_of_state
from mirrormount.panel.pages import Page, Pages
from mirrormount.panel.run_on_mount import warn
from mirrormount.panel.sign_in import CODE_S
from mirrormount.panel.socket import refusal
from mirrormount.supervise.board_settings import BoardSettings
from mirrormount.supervise.worker import Worker

if TYPE_CHECKING:
    from mirrormount.beam.live import LiveCamera
    from mirrormount.panel.camera_view import CameraView

STATIC = Path(__file__).parent / "static"
_REFRESH_S = 0.1
_HEAD = """<link rel="stylesheet" href="/panel/panel.css">
<script src="/panel/panel.js" defer></script><script src="/panel/screen.js" defer></script>
<script src="/panel/camera.js" defer></script>"""
_MODES = {None: "brightness_auto", False: "light_mode", True: "dark_mode"}

Refresh = Callable[[], None]
Link = Callable[[], str] | None
_log = logging.getLogger("mirrormount.panel")


def register(pages: Pages, worker: Worker, link: Link, view: "CameraView[LiveCamera] | None") -> None:
    """Register the page with NiceGUI. link(): a new link for a phone, None if only this computer can open the panel.

    view: the camera, if there is one.
    """
    app.add_static_files("/panel", STATIC, max_cache_age=0)
    settings = BoardSettings(worker)

    @ui.page("/", title="Mirror mount", response_timeout=10)
    def index() -> None:
        client = ui.context.client
        if pages.full:
            ui.label("Too many pages of this panel are open: close one, then load this page again.")
            return
        page = pages.add(client.ip or "?")
        page.drop = client.delete
        client.on_delete(lambda: pages.forget(page))
        _build(page, worker, settings, link, view)


def _build(
    page: Page, worker: Worker, settings: BoardSettings, link: Link, view: "CameraView[LiveCamera] | None"
) -> None:
    ui.add_head_html(_HEAD)
    axes = worker.state.axes
    refreshes: list[Refresh] = [_header(page, worker, link), _question(page, worker)]
    with ui.element("main").classes("cards").props(f'data-page="{page.key}"'):
        with ui.element("div").classes("column"):
            refreshes += [cards_of_motion.hold(worker)]
            refreshes += [cards_of_motion.by_numbers(worker)]
        with ui.element("div").classes("column"):
            if view:
                from mirrormount.panel import card_of_camera  # and with it OpenCV

                card_of_camera.build(view)
            refreshes += [cards_of_state.axis(worker, name) for name in axes]
            refreshes += [cards_of_state.plot(worker), cards_of_state.news(page, worker)]
        with ui.element("div").classes("column"):
            if worker.connection.spot_mm() and not view:
                cards_of_state.screen()
            refreshes += [card_of_settings.build(settings, lambda tick: refusal(worker, page, tick))]
            refreshes += [card_of_wire.build(worker)]
    _footer()

    def refresh() -> None:
        if worker.state.axes != axes:
            ui.navigate.reload()  # another board has come
        for one in list(refreshes):
            try:
                one()
            except Exception:  # or it would fail ten times a second
                refreshes.remove(one)
                _log.exception("a part of a page of the panel has failed")
                page.notices.append("a part of this page has failed and shows old values: load it again")

    ui.timer(_REFRESH_S, refresh)


def _header(page: Page, worker: Worker, link: Link) -> Refresh:
    with ui.element("header").classes("top"):
        ui.label("mirrormount").classes("brand")
        lamp = ui.element("span").classes("lamp")
        board = ui.label().classes("board")
        ui.element("span").classes("spring")
        role = ui.label().classes("role")
        claim = ui.button("Take control").props("""dense no-caps outline data-send='{"do": "claim"}'""")
        if link:
            ui.button(icon="qr_code_2", on_click=lambda: _show_link(page, link)).props(
                "flat dense aria-label='Open on a phone'"
            )
        _mode_button()
    with ui.element("div").classes("banner cut-banner").props("role=alert"):
        ui.label("No connection to the panel. Nothing can be driven from here; what this page drove has been stopped.")
    banner = ui.label().classes("banner trouble").props("role=alert")

    def refresh() -> None:
        controls = worker.lease.holder is page
        mount = worker.mount
        lamp.classes(replace="lamp on" if mount else "lamp bad")
        board.set_text(" · ".join(mount.identity.split(",")[1:]) if mount else "no board")
        banner.set_text(
            f"No board: {worker.connection.trouble}. The panel looks for it every second."
            if worker.connection.trouble
            else ""
        )
        banner.set_visibility(bool(worker.connection.trouble))
        others = len(worker.lease.clients) - 1
        holder = worker.lease.holder
        program = "" if holder is None or holder.is_person else holder.name
        role.set_text("you control" if controls else f"{program} controls" if program else "you watch")
        role.set_visibility(others > 0 or not controls)
        claim.set_visibility(not controls)
        role.classes(toggle=None, add="watching" if not controls else "", remove="" if not controls else "watching")

    return refresh


def _question(page: Page, worker: Worker) -> Refresh:
    """A program's question for control, on the page that has it."""
    with ui.element("div").classes("banner question").props("role=alert") as banner:
        label = ui.label().classes("grow")
        answers = {
            ui.button(word).props("dense no-caps outline"): what
            for word, what in (("Hand over", "hand over"), ("Keep", "keep"))
        }
    asked = 0

    def refresh() -> None:
        nonlocal asked
        question = worker.lease.question
        banner.set_visibility(question is not None and worker.lease.holder is page)
        if question and question.number != asked:
            asked = question.number
            label.set_text(f"{question.client.name} asks for control.")
            for button, what in answers.items():
                button.props(f"""data-send='{json.dumps({"do": what, "question": asked})}'""")

    return refresh


def _show_link(page: Page, link: Callable[[], str]) -> None:
    import segno

    if not page.connected:  # its driving socket has shown the key; without it there is no link for others either
        warn("nothing was done: this page has no connection of its own to the panel")
        return
    text = link()
    with ui.dialog() as dialog, ui.card():
        ui.label("Open this panel on a phone in the same network").classes("title")
        ui.html(segno.make(text, error="m").svg_inline(scale=5, dark="#000", light="#fff"), sanitize=False)
        ui.label(text).classes("mono link")
        ui.label(
            f"Whoever has this link can drive the mount. It works once, within {CODE_S / 60:.0f} minutes."
        ).classes("hint")
        ui.button("Close", on_click=dialog.close).props("no-caps flat")
    dialog.open()


def _mode_button() -> None:
    mode = ui.dark_mode(None)
    button = ui.button(icon=_MODES[None]).props("flat dense aria-label='Light, dark, or as the system'")

    def change() -> None:
        order = (None, True, False)
        mode.value = order[(order.index(mode.value) + 1) % 3]
        button.props(f"icon={_MODES[mode.value]}")

    button.on_click(change)


def _footer() -> None:
    with ui.element("footer").classes("bottom"), ui.element("button").classes("stop") as button:
        button.props("data-stop type=button aria-label='STOP all motors (Escape)'")
        ui.label("STOP")
        ui.label("Esc").classes("key")
