"""The card of the named positions, and what undoes a Zero in the card of an axis.

The map is drawn by static/positions.js. Back is a request by static/panel.js; the rest moves nothing.
"""

import json
from collections.abc import Callable

from nicegui import ui

from mirrormount.device.presets import Preset
from mirrormount_panel.cards import Refresh, Refusal, axis_title, card, ticked
from mirrormount_panel.log_card import when
from mirrormount_panel.mounts import Page, confirm, run_on_mount
from mirrormount_panel.positions import Positions

_LISTED = 100  # The list is not longer; the map has all.


def positions_card(positions: Positions, page: Page, refusal: Refusal, mount: int) -> Refresh:
    """The map of x and y, the list of positions, and Keep. mount: its number, as static/panel.js counts."""
    worker = positions.worker

    async def keep() -> None:
        name = (field.value or "").strip()
        if done := await run_on_mount(positions.keep(name)):
            field.set_value("")
            confirm(done)
            positions.reading.refresh()

    with card("Named positions"):
        with ui.element("div").classes("map-box") as box:
            ui.html('<svg class="map" role="img" aria-label="Positions of X and Y, in steps"></svg>', sanitize=False)
        doing = ui.label().classes("camera-doing").props("role=status")
        rows = ui.element("div").classes("places")
        trouble = ui.label().classes("hint")
        with ui.element("div").classes("line"):
            field = ui.input(placeholder="name").props(
                'dense outlined hide-bottom-space autocomplete=off maxlength=31 aria-label="Name of a position"'
            )
            field.classes("grow")
            keeper = ticked("Keep", keep, refusal, mount).props("unelevated")
        field.on("keydown.enter", js_handler=f"() => getElement({keeper.id}).$el.click()")
        ui.label(
            "Keep keeps where all axes are, and moves nothing. Back goes there, one axis after the other; STOP or any"
            " other button ends it."
        ).classes("hint")
    ask_to_remove = _remove_dialog(positions, refusal, mount)
    refresh_question = _question_dialog(positions, page, mount)
    shown: list[object] = [None]

    def refresh() -> None:
        positions.reading.refresh()
        refresh_question()
        state = worker.state
        doing.set_text(positions.doing)
        doing.set_visibility(bool(positions.doing))
        at = None
        if state.last and state.is_known:
            at = [*(round(state.last.by_name[axis].position, 3) for axis in ("x", "y")), state.last.moving]
        _attribute(box, "data-at", json.dumps(at))
        if (positions.reading.number, state.axes) == shown[0]:
            return
        shown[0] = positions.reading.number, state.axes
        kept = positions.kept.positions
        _attribute(box, "data-kept", json.dumps([_on_map(positions, preset) for preset in kept]))
        trouble.set_text(positions.reading.trouble or _count(len(kept)))
        trouble.set_visibility(bool(trouble.text))
        rows.clear()
        with rows:
            for preset in kept[:_LISTED]:
                _row(positions, preset, lambda preset=preset: ask_to_remove(preset))

    return refresh


def undo_zero(positions: Positions, axis: str, refusal: Refusal, mount: int) -> Refresh:
    """A button that undoes the axis's last Zero, if there is one, and below it what it has done."""

    async def undo() -> None:
        await run_on_mount(positions.undo_zero(axis))
        positions.reading.refresh()

    button = ticked("Undo Zero", undo, refusal, mount).classes("undo-zero")
    button.props(f'flat aria-label="Undo Zero of {axis}"')
    done = ui.label().classes("hint undone").props("role=status")

    def refresh() -> None:
        there = axis in positions.kept.zeroed
        button.set_enabled(there)
        button.classes(toggle=None, add="" if there else "none", remove="none" if there else "")
        done.set_text(positions.done.get(axis, ""))

    return refresh


def _attribute(element: ui.element, name: str, value: str) -> None:
    """Set what a script reads; as it is, whatever is in it."""
    if element.props.get(name) != value:
        element.props[name] = value
        element.update()


def _count(kept: int) -> str:
    if not kept:
        return "No position of this board is kept."
    return f"The list has {_LISTED} of {kept}: `mirrormount keep` lists all." if kept > _LISTED else ""


def _names(positions: Positions) -> dict[int, str]:
    mount = positions.worker.mount
    return {axis.number: axis.name for axis in mount.axes} if mount else {}


def _on_map(positions: Positions, preset: Preset) -> list[object]:
    """Name, x and y; null where the board has no such axis."""
    names = _names(positions)
    places = {names.get(number): place.position for number, place in preset.places.items()}
    return [preset.name, places.get("x"), places.get("y")]


def _row(positions: Positions, preset: Preset, remove: Callable[[], None]) -> None:
    names = _names(positions)
    where = ", ".join(
        f"{axis_title(names.get(number, f'axis {number}'))} {place.position:+.10g}"
        for number, place in preset.places.items()
    )
    spot = f"; the spot at ({preset.spot.x:.1f}, {preset.spot.y:.1f}) px" if preset.spot else ""
    with ui.element("div").classes("place"):
        with ui.element("div").classes("grow"):
            ui.label(preset.name).classes("place-name")
            ui.label(f"{where.replace('-', '−')}{spot}; kept {when(preset.at)}").classes("hint")
        _send(positions, "Back", preset.name).props("outline")
        if preset.spot and positions.spots:
            _send(positions, "Back by the beam", preset.name, beam=True).props("outline").classes("by-beam")
        button = ui.button("Remove", on_click=remove).props("flat no-caps")
        button.props["aria-label"] = f"Remove {preset.name}"


def _send(positions: Positions, word: str, name: str, *, beam: bool = False, sure: int | None = None) -> ui.button:
    request = {"do": "back", "name": name} | ({"beam": True} if beam else {}) | ({"sure": sure} if sure else {})
    button = ui.button(word).props("no-caps")
    button.props["data-send"] = json.dumps(request)
    if sure is None:
        button.props["aria-label"] = f"{word} to {name}" if not beam else f"Back to {name} by the beam"
    return button


def _remove_dialog(positions: Positions, refusal: Refusal, mount: int) -> Callable[[Preset], None]:
    """What asks before a position is forgotten."""
    asked: list[Preset] = []

    async def agreed() -> None:
        dialog.close()
        await run_on_mount(positions.remove(asked[0].name), f"{asked[0].name} is forgotten")
        positions.reading.refresh()

    with ui.dialog() as dialog, ui.card():
        ui.label("Forget this position?").classes("title")
        name = ui.label()
        with ui.element("div").classes("line"):
            ticked("Forget it", agreed, refusal, mount).props("unelevated")
            ui.button("Cancel", on_click=dialog.close).props("flat no-caps")

    def ask(preset: Preset) -> None:
        asked[:] = [preset]
        name.set_text(str(preset))
        dialog.open()

    return ask


def _question_dialog(positions: Positions, page: Page, mount: int) -> Refresh:
    """What asks whether to go all the same where there are doubts."""
    with ui.dialog() as dialog, ui.card().props(f'data-of="mount-{mount + 1}"'):
        ui.label("It may be another place now").classes("title")
        name = ui.label()
        why = ui.element("div")
        buttons = ui.element("div").classes("line")
    asked = [0]
    dialog.on("hide", lambda: positions.withdraw(page, asked[0]))

    def refresh() -> None:
        question = positions.question(page)
        if question is None or question.number == asked[0]:
            return
        asked[0] = question.number
        name.set_text(str(question.preset))
        why.clear()
        buttons.clear()
        with why:
            for doubt in question.doubts:
                ui.label(doubt)
        with buttons:
            go = _send(positions, "Go all the same", question.preset.name, beam=question.beam, sure=question.number)
            go.props("unelevated").on_click(dialog.close)
            ui.button("Cancel", on_click=dialog.close).props("flat no-caps")
        dialog.open()

    return refresh
