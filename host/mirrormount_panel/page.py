"""The page, made of its cards. Built for every browser that loads it; updates itself."""

import json
import logging
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from nicegui import app, ui

from mirrormount.supervise.worker import Worker
from mirrormount_panel import cards
from mirrormount_panel.auth import CODE_S
from mirrormount_panel.board_settings import BoardSettings
from mirrormount_panel.log_card import log_card
from mirrormount_panel.mounts import Page, PanelMount, Part, warn
from mirrormount_panel.position_cards import positions_card, undo_zero
from mirrormount_panel.positions import Positions
from mirrormount_panel.socket import refusal

if TYPE_CHECKING:
    from mirrormount_beam.live import LiveCamera
    from mirrormount_panel.camera import CameraView

STATIC = Path(__file__).parent / "static"
_REFRESH_S = 0.1
_HEAD = """<link rel="stylesheet" href="/panel/panel.css"><script src="/panel/mode.js"></script>
<script src="/panel/moved.js" defer></script><script src="/panel/panel.js" defer></script>
<script src="/panel/gamepad.js" defer></script><script src="/panel/positions.js" defer></script>
<script src="/panel/screen.js" defer></script><script src="/panel/camera.js" defer></script>"""
_CUT = (
    "No connection to the panel. Nothing can be driven from here; what this page drove has been stopped."
    " See that mirrormount panel still runs, and the network: this page connects again by itself."
)
_MOVED = "Not carried out: the page had just moved what you pressed. Press again."
MODE_BUTTON = '<button type="button" class="mode" data-mode></button>'  # static/mode.js names it


class Board(NamedTuple):
    """What all pages of a mount share of its board."""

    settings: BoardSettings
    positions: Positions


Refresh = Callable[[], None]
Link = Callable[[], str] | None
_log = logging.getLogger("mirrormount_panel")


def register(
    mounts: Sequence[PanelMount],
    positions: Sequence[Positions],
    link: Link,
    view: "CameraView[LiveCamera] | None",
) -> None:
    """Register the page with NiceGUI. link(): a new link for a phone, None if only this computer can open the panel.

    positions: of each mount. view: the camera, if there is one.
    """
    app.add_static_files("/panel", STATIC, max_cache_age=0)
    boards = [Board(BoardSettings(mount.worker), kept) for mount, kept in zip(mounts, positions, strict=True)]

    @ui.page("/", title="Mirror mount", response_timeout=10)
    def index() -> None:
        client = ui.context.client
        if any(mount.pages.full for mount in mounts):
            ui.label("Too many pages of this panel are open: close one, then load this page again.")
            return
        parts = [(mount, mount.pages.add(client.ip or "?")) for mount in mounts]
        for mount, page in parts:
            page.drop = client.delete
            client.on_delete(partial(mount.pages.forget, page))
        _build(parts, boards, link, view)


def _build(parts: Sequence[Part], boards: Sequence[Board], link: Link, view: "CameraView[LiveCamera] | None") -> None:
    ui.add_head_html(_HEAD)
    refreshes: list[tuple[Page, Refresh]] = []
    with ui.element("header").classes("top"):
        ui.label("mirrormount").classes("brand")
        if len(parts) == 1:
            (mount, page) = parts[0]
            refreshes.append((page, _status_bar(page, mount.worker)))
        else:
            for number, (mount, page) in enumerate(parts, 1):
                refreshes.append((page, _mount_link(number, mount)))
            ui.element("span").classes("spring")
        if link:
            ui.button(icon="qr_code_2", on_click=lambda: _show_link([page for _, page in parts], link)).props(
                "flat dense aria-label='Open on a phone'"
            )
        ui.html(MODE_BUTTON, sanitize=False)
    with ui.element("div").classes("banners"):
        _banner("cut", _CUT)
        _banner("moved", _MOVED)
        if len(parts) == 1:
            refreshes += _mount_banners(parts[0])
    if len(parts) == 1:
        (mount, page) = parts[0]
        with ui.element("main").classes("cards").props(f'data-page="{page.key}"') as root:
            # Not by props(): that would parse what a board says. Of no other board (connection.py), so it stays true.
            root.props["data-mount"] = mount.worker.state.board_id
            refreshes += [(page, refresh) for refresh in _cards(0, mount, page, boards[0], view)]
    else:
        with ui.element("main").classes("mounts"):
            for number, (mount, page) in enumerate(parts):
                with _section(number + 1, mount, page):
                    with ui.element("div").classes("mount-bar"):
                        ui.label(mount.name).classes("mount-name").props("role=heading aria-level=1")
                        refreshes.append((page, _status_bar(page, mount.worker)))
                        ui.label("arrow keys").classes("keys").props("title='Arrow keys drive the mount touched last'")
                    with ui.element("div").classes("banners"):
                        refreshes += _mount_banners((mount, page))
                    with ui.element("div").classes("cards"):
                        refreshes += [(page, refresh) for refresh in _cards(number, mount, page, boards[number], None)]
    _footer(len(parts) > 1)
    axes = [mount.worker.state.axes for mount, _ in parts]

    def refresh() -> None:
        if [mount.worker.state.axes for mount, _ in parts] != axes:
            ui.navigate.reload()  # another board has come
        for page, one in list(refreshes):
            try:
                one()
            except Exception:  # or it would fail ten times a second
                refreshes.remove((page, one))
                _log.exception("a part of a page of the panel has failed")
                page.notices.append("a part of this page has failed and shows old values: load it again")

    refresh()  # or what is hidden would be seen until the first one
    ui.timer(_REFRESH_S, refresh)


def _cards(
    number: int, mount: PanelMount, page: Page, board: Board, view: "CameraView[LiveCamera] | None"
) -> list[Refresh]:
    """The cards of one mount, in three columns. number: of the mount, from 0, as static/panel.js counts them."""
    worker = mount.worker
    refreshes: list[Refresh] = []

    def refused(tick: object) -> str:
        return refusal(worker, page, tick)

    def undo(axis: str) -> Refresh:
        return undo_zero(board.positions, axis, refused, number)

    with ui.element("div").classes("column"):
        refreshes += [cards.press_card(worker)]
        refreshes += [cards.number_cards(worker)]
    with ui.element("div").classes("column"):
        if view:
            cards.camera_card(view)
        refreshes += [cards.axis_card(worker, name, undo) for name in worker.state.axes]
        refreshes += [cards.plot_card(worker), cards.news_card(page, worker, mount.name)]
    with ui.element("div").classes("column"):
        if worker.connection.spot_mm() and not view:
            cards.screen_card(number)
        refreshes += [positions_card(board.positions, page, refused, number)]
        refreshes += [cards.settings_card(board.settings, refused, number)]
        refreshes += [log_card(worker, mount.name), cards.wire_card(worker, mount.name)]
    return refreshes


def _section(number: int, mount: PanelMount, page: Page) -> ui.element:
    """What holds all of one mount. Its name is one of names.NAME_RULE, or of several that share a board."""
    box = ui.element("section").classes("mount").props(f'id="mount-{number}" aria-label="{mount.name}"')
    return box.props(f'data-page="{page.key}" data-mount="{mount.name}"')


def _mount_link(number: int, mount: PanelMount) -> Refresh:
    """A link to the mount's part of the page, with its lamp."""
    with ui.element("a").classes("way").props(f'href="#mount-{number}"'):
        lamp = ui.element("span").classes("lamp")
        ui.label(mount.name)

    def refresh() -> None:
        moving = mount.worker.state.is_known and mount.worker.driver is not None
        there = mount.worker.mount is not None
        lamp.classes(replace="lamp moves" if moving else "lamp on" if there else "lamp bad")

    return refresh


def _status_bar(page: Page, worker: Worker) -> Refresh:
    """Which board it is, and whether this page has control."""
    lamp = ui.element("span").classes("lamp")
    board = ui.label().classes("board")
    ui.element("span").classes("spring")
    role = ui.label().classes("role")
    claim = ui.button("Take control").props("""dense no-caps outline data-send='{"do": "claim"}'""")

    def refresh() -> None:
        controls = worker.lease.holder is page
        mount = worker.mount
        lamp.classes(replace="lamp on" if mount else "lamp bad")
        board.set_text(" · ".join(mount.identity.split(",")[1:]) if mount else "no board")
        others = len(worker.lease.clients) - 1
        holder = worker.lease.holder
        program = "" if holder is None or holder.is_person else holder.name
        role.set_text("you control" if controls else f"{program} controls" if program else "you watch")
        role.set_visibility(others > 0 or not controls)
        claim.set_visibility(not controls)
        role.classes(toggle=None, add="watching" if not controls else "", remove="" if not controls else "watching")

    return refresh


def _banner(state: str, text: str) -> None:
    """A banner that the page shows itself, while its body has this class."""
    with ui.element("div").classes(f"banner {state}-banner").props("role=alert"):
        ui.label(text)


def _mount_banners(part: Part) -> list[tuple[Page, Refresh]]:
    """The banners of a mount."""
    mount, page = part
    return [(page, _trouble(mount.worker)), (page, _question(page, mount.worker))]


def _trouble(worker: Worker) -> Refresh:
    """Why there is no board."""
    banner = ui.label().classes("banner trouble").props("role=alert")

    def refresh() -> None:
        trouble = worker.connection.trouble
        told = f"No board: {trouble}. Look at its cable and power. The panel looks for it every second."
        banner.set_text(told if trouble else "")
        banner.set_visibility(bool(trouble))

    return refresh


def _question(page: Page, worker: Worker) -> Refresh:
    """A program's question for control, on the page that has it."""
    with ui.element("div").classes("banner question").props("role=alert") as banner:
        label = ui.label().classes("grow")
        answers = {
            ui.button(word).props("dense no-caps outline"): what
            for word, what in (("Hand over", "hand over"), ("Keep control", "keep"))
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


def _show_link(pages: Sequence[Page], link: Callable[[], str]) -> None:
    import segno

    # A page whose driving socket is connected has shown the key; without the key there is no link for others either.
    if not all(page.connected for page in pages):
        warn("nothing was done: this page has no connection of its own to the panel; load it again")
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


def _footer(several: bool) -> None:
    with ui.element("footer").classes("bottom"), ui.element("button").classes("stop") as button:
        button.props("data-stop type=button aria-label='STOP all motors (Space, or Escape)'")
        ui.label("STOP ALL" if several else "STOP")
        ui.label("Space · Esc").classes("key")
