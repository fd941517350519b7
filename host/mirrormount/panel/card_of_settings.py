"""The settings of all axes: read, apply, save on the board, restore. The board checks each."""

import contextlib
from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from mirrormount.common.errors import BadValue
from mirrormount.device.settings import ENCODER, SETTINGS, groups
from mirrormount.panel.cards_of_motion import card
from mirrormount.panel.run_on_mount import confirm, run_on_mount, warn
from mirrormount.supervise.board_settings import BoardSettings

_DONE = "done"
_SHOWN_S = 5  # as long as a page may take to show what was read


def build(settings: BoardSettings, refusal: Callable[[object], str], mount: int) -> Callable[[], None]:
    """A card that opens to all settings. refusal(tick): why this page may not change them; "" if it may.

    mount: its number, as static/panel.js counts.
    """

    def button(word: str, action: Callable[[], Awaitable[object]]) -> ui.button:
        async def clicked(event: GenericEventArguments) -> None:
            why = refusal(event.args)
            if why:
                warn(why)
            else:
                await action()

        # with the last tick that the page has seen: NiceGUI keeps a click until the network is back
        tick = f"() => emit(window.mountTick({mount}))"
        return ui.button(word).on("click", clicked, js_handler=tick).props("no-caps")

    with card("Settings"), ui.expansion(", ".join(groups()).capitalize()).classes("fold") as fold:
        form = _Form(settings)
        with ui.dialog() as question, ui.card():
            ui.label("Replace all settings by the factory's?").classes("title")
            ui.label(
                "All settings of all axes change at once: direction, switches, limits, pulse and speed."
                " What is saved on the board stays saved. The present settings are kept, to be put back."
            )
            with ui.element("div").classes("line"):

                async def agreed() -> None:
                    question.close()
                    await form.factory()

                button("Replace them", agreed).props("unelevated")
                ui.button("Cancel", on_click=question.close).props("flat no-caps")

        async def inquire() -> None:
            question.open()

        with ui.element("div").classes("line"):
            button("Apply", form.apply).props("unelevated")
            button("Save on the board", form.save).props("outline")
            button("Restore saved", form.restore).props("flat")
            button("Factory …", inquire).props("flat")
        with ui.element("div").classes("line undo") as undo:
            ui.label("All settings were replaced. The ones before are kept.").classes("grow")
            button("Put them back", form.undo).props("outline")
        ui.label("Applied settings last until the board restarts, unless they are saved.").classes("hint")
    fold.on_value_change(lambda e: form.read() if e.value else form.rest())

    def refresh() -> None:
        undo.set_visibility(settings.before is not None)

    refresh()
    return refresh


class _Form:
    """A field for every setting of every axis, and the actions of the buttons."""

    def __init__(self, settings: BoardSettings) -> None:
        self._settings = settings
        self._axes = settings.axes
        self._fields: dict[tuple[str, str], ui.input] = {}
        self._read: dict[tuple[str, str], str] = {}  # what the board had when it was last asked
        title = ""
        of_all = ui.element("div")
        with ui.element("div") as self._of_encoders:
            pass
        self._of_encoders.set_visibility(False)  # until an axis turns out to have one
        for name, setting in SETTINGS.items():
            box = self._of_encoders if name in ENCODER else of_all
            with box:
                if setting.group != title:
                    title = setting.group
                    ui.label(title).classes("group")
                self._row(name)

    def _row(self, name: str) -> None:
        what = SETTINGS[name].what
        with ui.element("div").classes("setting"):
            ui.label(what).classes("grow")
            for axis in self._axes:
                field = ui.input(axis.upper()).props(f'dense outlined inputmode=decimal aria-label="{axis}: {what}"')
                self._fields[axis, name] = field.props("hide-bottom-space")
                field.set_enabled(False)

    def rest(self) -> None:
        """Take nothing: the values are old, or not read yet."""
        for field in self._fields.values():
            field.set_enabled(False)

    async def read(self) -> None:
        """Show the board's present settings. Fields take what is typed once the page has shown them."""
        settings = await run_on_mount(self._settings.read())
        if settings:
            for (axis, name), field in self._fields.items():
                there = name in settings[axis]
                self._read[axis, name] = str(settings[axis][name]) if there else ""
                field.set_value(self._read[axis, name])
            self._of_encoders.set_visibility(any(name in ENCODER for values in settings.values() for name in values))
            # a value comes to the page in two messages: the second undid what was typed after the first
            with contextlib.suppress(TimeoutError):  # a page that is away gets all of them in order
                await ui.run_javascript("0", timeout=_SHOWN_S)
            for (axis, name), field in self._fields.items():
                field.set_enabled(name in settings[axis])

    async def apply(self, done: str = "applied") -> bool:
        """Apply all edited settings, or none. True if the board took them.

        Others are not sent: another page may have changed them meanwhile.
        """
        try:
            wanted = {
                axis: {name: self._typed(axis, name) for name in SETTINGS if self._edited(axis, name)}
                for axis in self._axes
            }
        except BadValue as e:
            warn(f"nothing was changed: {e}")
            return False
        return await self._made(self._settings.change(lambda mount: mount.apply(wanted)), done)

    async def save(self) -> None:
        """Apply, and save on the board."""
        if await self.apply(""):
            await self._made(self._settings.change(lambda mount: mount.save()), "saved on the board")

    async def restore(self) -> None:
        """Load the settings that are saved on the board."""
        await self._made(self._settings.replace(lambda mount: mount.recall()), "restored")

    async def factory(self) -> None:
        """Load the defaults; saved settings stay."""
        await self._made(self._settings.replace(lambda mount: mount.recall(factory=True)), "factory settings")

    async def undo(self) -> None:
        """Apply the settings from before restore() or factory()."""
        await self._made(self._settings.undo(), "the earlier settings are back")

    async def _made(self, change: Awaitable[None], done: str) -> bool:
        """Await a change and show the settings after it. True if the board took it."""

        async def make() -> str:
            await change
            return _DONE

        if await run_on_mount(make()) != _DONE:
            return False
        await self.read()
        if done:
            confirm(done)
        return True

    def _edited(self, axis: str, name: str) -> bool:
        return (self._fields[axis, name].value or "").strip() != self._read.get((axis, name), "")

    def _typed(self, axis: str, name: str) -> Any:
        """The typed number; its range is checked elsewhere. Raises BadValue."""
        text = (self._fields[axis, name].value or "").strip()
        try:
            return float(text) if SETTINGS[name].decimals else int(text)
        except ValueError:
            raise BadValue(f"{axis}, {SETTINGS[name].what}: a number, not {text!r}") from None
