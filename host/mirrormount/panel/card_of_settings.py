"""The settings of both axes: look, change, keep on the board, go back. The board has the last word."""

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from mirrormount.client import Mount
from mirrormount.errors import BadValue
from mirrormount.panel.asking import ask, warn
from mirrormount.panel.cards_of_motion import card
from mirrormount.panel.pilot import Pilot
from mirrormount.settings import AXES, SETTINGS

# the board's names in the order and the words of a person at the bench
_GROUPS = (
    ("Pulse and speed", ("pulse_us", "step_duty", "velocity", "run_duty")),
    ("Take-up", ("take_up_us",)),
    ("Limits", ("checking", "soft_minimum", "soft_maximum", "run_limit_ms", "search_limit_ms")),
    ("Wiring", ("inverted", "switches", "motor_type")),
)
_NAMES = [name for _, names in _GROUPS for name in names]


def build(pilot: Pilot, refusal: Callable[[object], str]) -> None:
    """A card that opens to all settings. refusal(tick): why this page may not change them; "" if it may."""
    with card("Settings"), ui.expansion("Limits, take-up, pulse and speed").classes("fold") as fold:
        form = _Form(pilot)

        def button(word: str, action: Callable[[], Awaitable[object]]) -> ui.button:
            async def clicked(event: GenericEventArguments) -> None:
                why = refusal(event.args)
                if why:
                    warn(why)
                else:
                    await action()

            # with the last tick that the page has seen: NiceGUI keeps a click until the network is back
            return ui.button(word).on("click", clicked, js_handler="() => emit(window.mountTick())").props("no-caps")

        with ui.element("div").classes("line"):
            button("Apply", form.apply).props("unelevated")
            button("Save on the board", form.save).props("outline")
            button("Restore saved", form.restore).props("flat")
            button("Factory", form.factory).props("flat")
        ui.label("Applied settings last until the board restarts, unless they are saved.").classes("hint")
    fold.on_value_change(lambda e: form.read() if e.value else None)


class _Form:
    """A field for every setting of both axes, and what the buttons do."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self._fields: dict[tuple[str, str], ui.input] = {}
        self._read: dict[tuple[str, str], str] = {}  # what the board had when it was last asked
        for title, names in _GROUPS:
            ui.label(title).classes("group")
            for name in names:
                self._row(name)

    def _row(self, name: str) -> None:
        what = SETTINGS[name].what
        with ui.element("div").classes("setting"):
            ui.label(what).classes("grow")
            for axis in AXES:
                field = ui.input(axis).props(f'dense outlined inputmode=decimal aria-label="{axis}: {what}"')
                self._fields[axis, name] = field.props("hide-bottom-space")

    async def read(self) -> None:
        """Show what the board has now."""
        settings = await ask(self._pilot, lambda mount: mount.settings())
        if settings:
            for (axis, name), field in self._fields.items():
                self._read[axis, name] = str(settings[axis][name])
                field.set_value(self._read[axis, name])

    async def apply(self) -> bool:
        """Have the board take what was edited: all of it, or nothing. True if it did.

        What was not edited is not sent: another page may have changed it meanwhile.
        """
        try:
            wanted = {
                axis: {name: self._typed(axis, name) for name in _NAMES if self._edited(axis, name)} for axis in AXES
            }
        except BadValue as e:
            warn(f"nothing was changed: {e}")
            return False
        done = await self._change(lambda mount: mount.apply(wanted), "applied")
        if done:
            await self.read()
        return done

    async def save(self) -> None:
        """Apply, and keep it on the board for its next start."""
        if await self.apply():
            await self._change(lambda mount: mount.save(), "saved on the board")

    async def restore(self) -> None:
        """Back to what is saved on the board."""
        if await self._change(lambda mount: mount.recall(), "restored"):
            await self.read()

    async def factory(self) -> None:
        """Back to the settings as made; what is saved stays."""
        if await self._change(lambda mount: mount.recall(factory=True), "factory settings"):
            await self.read()

    async def _change(self, work: Callable[[Mount], None], done: str) -> bool:
        def change(mount: Mount) -> bool:
            work(mount)
            return True

        return bool(await ask(self._pilot, change, done))

    def _edited(self, axis: str, name: str) -> bool:
        return (self._fields[axis, name].value or "").strip() != self._read.get((axis, name), "")

    def _typed(self, axis: str, name: str) -> Any:
        """The number that was typed. Raises BadValue; whether it may be, SETTINGS and the board say."""
        text = (self._fields[axis, name].value or "").strip()
        try:
            return float(text) if SETTINGS[name].decimals else int(text)
        except ValueError:
            raise BadValue(f"{axis}, {SETTINGS[name].what}: a number, not {text!r}") from None
