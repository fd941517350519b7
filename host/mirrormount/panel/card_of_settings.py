"""The settings of both axes: look, change, keep on the board, go back. The board has the last word."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

from mirrormount.client import Mount
from mirrormount.errors import BadValue
from mirrormount.panel.asking import ask
from mirrormount.panel.cards_of_motion import card
from mirrormount.panel.pilot import Pilot
from mirrormount.settings import AXES, SETTINGS, Setting

# the board's names in the order and the words of a person at the bench
_GROUPS = (
    ("Pulse and speed", ("pulse_us", "step_duty", "velocity", "run_duty")),
    ("Take-up", ("take_up_us",)),
    ("Limits", ("checking", "soft_minimum", "soft_maximum", "run_limit_ms", "move_limit_ms")),
    ("Wiring", ("inverted", "switches", "motor_type")),
)


def build(pilot: Pilot) -> Callable[[], None]:
    """A card that opens to all settings."""
    fields: dict[tuple[str, str], ui.input] = {}
    with card("Settings"), ui.expansion("Limits, take-up, pulse and speed").classes("fold") as fold:
        for title, names in _GROUPS:
            ui.label(title).classes("group")
            for name in names:
                _row(name, fields)
        with ui.element("div").classes("line"):
            ui.button("Apply", on_click=lambda: _apply(pilot, fields)).props("no-caps unelevated")
            ui.button("Save on the board", on_click=lambda: _save(pilot, fields)).props("no-caps outline")
            ui.button("Restore saved", on_click=lambda: _recall(pilot, fields)).props("no-caps flat")
            ui.button("Factory", on_click=lambda: _recall(pilot, fields, factory=True)).props("no-caps flat")
        ui.label("Applied settings last until the board restarts, unless they are saved.").classes("hint")
    fold.on_value_change(lambda e: _read(pilot, fields) if e.value else None)
    return lambda: None


def _row(name: str, fields: dict[tuple[str, str], ui.input]) -> None:
    setting: Setting = SETTINGS[name]
    with ui.element("div").classes("setting"):
        ui.label(setting.what).classes("grow")
        for axis in AXES:
            label = f"{axis}: {setting.what}"
            field = ui.input(axis).props(f'dense outlined inputmode=decimal hide-bottom-space aria-label="{label}"')
            fields[axis, name] = field


async def _read(pilot: Pilot, fields: dict[tuple[str, str], ui.input]) -> None:
    settings = await ask(pilot, lambda mount: mount.settings())
    if settings:
        for (axis, name), field in fields.items():
            field.set_value(f"{settings[axis][name]:g}" if name == "velocity" else str(settings[axis][name]))


async def _apply(pilot: Pilot, fields: dict[tuple[str, str], ui.input]) -> bool:
    try:
        wanted = {axis: {name: _typed(axis, name, fields[axis, name].value) for name in _names()} for axis in AXES}
    except BadValue as e:
        ui.notify(f"nothing was changed: {e}", type="warning", position="top", close_button="OK")
        return False
    done = await ask(pilot, lambda mount: _applied(mount, wanted), "applied")
    await _read(pilot, fields)
    return bool(done)


def _applied(mount: Mount, wanted: dict[str, dict[str, Any]]) -> bool:
    mount.apply(wanted)
    return True


async def _save(pilot: Pilot, fields: dict[tuple[str, str], ui.input]) -> None:
    if await _apply(pilot, fields):
        await ask(pilot, lambda mount: mount.save(), "saved on the board")


async def _recall(pilot: Pilot, fields: dict[tuple[str, str], ui.input], *, factory: bool = False) -> None:
    await ask(pilot, lambda mount: mount.recall(factory=factory), "factory settings" if factory else "restored")
    await _read(pilot, fields)


def _names() -> list[str]:
    return [name for _, names in _GROUPS for name in names]


def _typed(axis: str, name: str, text: str | None) -> int | float:
    """The number that was typed. Raises BadValue; whether it may be is asked of SETTINGS and of the board."""
    text = (text or "").strip()
    try:
        return float(text) if SETTINGS[name].decimals else int(text)
    except ValueError:
        raise BadValue(f"{axis}, {SETTINGS[name].what}: a number, not {text!r}") from None
