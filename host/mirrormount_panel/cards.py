"""The cards of a page, one function each. A function returns what refreshes its card, ten times a second.

Buttons that drive send their requests by static/panel.js, and the camera's picture is drawn by static/camera.js. The
settings go through NiceGUI instead: they move nothing, and a late click is refused by its tick.
"""

import contextlib
import itertools
import json
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from mirrormount.device.settings import ENCODER, SETTINGS, groups
from mirrormount.device.status import AxisStatus
from mirrormount.errors import REASONS, BadValue, remedy_of
from mirrormount.supervise.connection import AxisScale, Point, State
from mirrormount.supervise.log import Entry, Notice
from mirrormount.supervise.requests import FINE, FULL
from mirrormount.supervise.worker import HOLD_S, MOST, Worker
from mirrormount.values import STEPS
from mirrormount_panel.board_settings import BoardSettings
from mirrormount_panel.camera import CameraView, camera_html
from mirrormount_panel.mounts import Page, confirm, run_on_mount, warn

# ---- press and hold, numbers of steps, speeds

_PAD = (  # place in the pad, directions of the axes, arrow, name
    ("up", "y:1", "▲", "UP"),
    ("left", "x:-1", "◀", "LEFT"),
    ("right", "x:1", "▶", "RIGHT"),
    ("down", "y:-1", "▼", "DOWN"),
    ("up-left", "x:-1 y:1", "◤", "UP AND LEFT"),
    ("up-right", "x:1 y:1", "◥", "UP AND RIGHT"),
    ("down-left", "x:-1 y:-1", "◣", "DOWN AND LEFT"),
    ("down-right", "x:1 y:-1", "◢", "DOWN AND RIGHT"),
)
_PAD_AXES = ("x", "y")  # Further axes have a row of buttons each.
_STEP_WORDS = {"x": ("◀ left", "right ▶"), "y": ("▼ down", "up ▲")}
SLOW = 80  # Where the slider starts: a third of full speed (255).

UNITS = {  # The units of values.py, as a person reads them.
    STEPS: "steps",
    "urad": "µrad of the mirror",
    "mrad": "mrad of the mirror",
    "beam-urad": "µrad of the beam",
    "beam-mrad": "mrad of the beam",
    "mm": "mm on the screen",
    "um": "µm on the screen",
}

_SLIDER = (
    f'<input type="range" name="speed" min="1" max="{FULL}" value="{SLOW}" aria-label="Speed" data-remember>'
    f'<output class="mono" data-shows="speed">{SLOW}</output>'
)


def press_card(worker: Worker) -> Callable[[], None]:
    """The pad: a short press is some steps, a long one runs at the slider's speed. Shows how many presses wait."""
    with card("Press and hold"):
        with ui.element("div").classes("pad"):
            for place, press, arrow, word in _PAD:
                _press(place, press, arrow, word, shows_word=" " not in word)
            queued = ui.label().classes("queued").props("role=status")
        for axis in worker.state.axes:
            if axis not in _PAD_AXES:
                with ui.element("div").classes("axis-row"):
                    title = axis_title(axis)
                    _press("minus", f"{axis}:-1", "−", f"{title.upper()} MINUS")
                    ui.label(title).classes("name")
                    _press("plus", f"{axis}:1", "+", f"{title.upper()} PLUS")
        with ui.element("div").classes("line"):
            ui.label("Speed").classes("name")
            # Plain HTML, because Vue would put an input's first value back whenever anything on the page changes.
            ui.html(_SLIDER, sanitize=False).classes("slider")
            ui.label("Step").classes("name")
            number("press_steps", "1", "Steps of a short press", keyboard="numeric", remember=True).classes("short")
        ui.label(
            f"Short press: as many steps as Step says. Longer than {HOLD_S:g} s: runs until you let go. Arrow keys do"
            f" the same, and Enter on a button; with Shift one step, and 1/{FINE} of the speed. Presses while it steps"
            f" are queued, up to {MOST}."
        ).classes("hint")
        # Plain HTML: static/gamepad.js fills it.
        ui.html('<p class="hint" data-gamepad role="status"></p>', sanitize=False).classes("gamepad")

    def refresh() -> None:
        queued.set_text(f"{len(worker.presses)} queued" if worker.presses else "")

    return refresh


def axis_title(name: str) -> str:
    """An axis's name for a person: X, Y, Axis 3."""
    return name.upper() if name in _PAD_AXES else name.replace("axis", "Axis ")


def _press(place: str, press: str, arrow: str, name: str, *, shows_word: bool = False) -> None:
    """A direction button."""
    button = ui.element("button").classes(f"press {place}")
    with button.props(f'type=button data-press="{press}" aria-label="{name}"'):
        ui.label(arrow).classes("arrow")
        if shows_word:
            ui.label(name).classes("word")


def number_cards(worker: Worker) -> Callable[[], None]:
    """Two cards: amounts to move by, and speeds of x and y. Shows what a step is where a scale was measured."""
    with card("Fine steps"):
        with ui.element("div").classes("line"):
            ui.label("Move by").classes("name")
            number("steps", "1", "Number of steps, or of another unit", keyboard="decimal", remember=True)
            refresh_units = unit_choice(worker, "steps_unit", "Unit of fine steps", worker.state.axes)
        with ui.element("div").classes("fine"):
            for axis in worker.state.axes:
                for way, word in zip(
                    (-1, 1), _STEP_WORDS.get(axis) or (f"− {axis_title(axis)}", f"{axis_title(axis)} +"), strict=True
                ):
                    send(word, {"do": "steps", "axis": axis, "way": way}, "n:steps unit:steps_unit").props("outline")
        sizes = ui.label().classes("hint")
    with card("Speeds of both axes" if len(worker.state.axes) == 2 else "Speeds of X and Y"):
        with ui.element("div").classes("line speeds"):
            ui.label("X").classes("name")
            number("speed_x", "0", "Speed of X, right and left")
            ui.label("Y").classes("name")
            number("speed_y", "0", "Speed of Y, up and down")
            send("OK", {"do": "drive"}, "x:speed_x y:speed_y", enter="speed_x speed_y").classes("ok")
        ui.label(
            f"−{FULL} … {FULL}, 0 is off. X: positive is right. Y: positive is up. They run until STOP,"
            " the board's run limit, or the end of this page."
        ).classes("hint")

    def refresh() -> None:
        sizes.set_text(worker.state.step_text())
        refresh_units()

    return refresh


def card(title: str) -> ui.element:
    """An empty card with a title."""
    box = ui.element("section").classes("card")
    with box:
        ui.label(title).classes("title").props("role=heading aria-level=2")
    return box


def unit_choice(
    worker: Worker, name: str, label: str, axes: Sequence[str], chosen: Callable[[str], object] = str
) -> Callable[[], None]:
    """A choice of units for a number beside it. Those without a scale for any of these axes cannot be chosen.

    chosen(unit): called when the page's choice is another one. A chosen unit that loses its scale is told.
    """
    with ui.element("select").classes("unit-choice").props(f'name={name} data-remember aria-label="{label}"') as choice:
        choice.props('title="Units in grey have no scale yet: mirrormount setup measures it"')
        options = {
            unit: ui.html(words, sanitize=False, tag="option").props(f"value={unit}") for unit, words in UNITS.items()
        }
    choice.on("input", lambda event: chosen(event.args), js_handler="(event) => emit(event.target.value)")
    ui.html('<p class="lost" data-lost role="alert"></p>', sanitize=False).classes("lost-box")
    known = set(UNITS)

    def refresh() -> None:
        scales = [worker.state.scales.get(axis) for axis in axes]
        for unit, option in options.items():
            if (unit in known) == any(_is_known(unit, scale) for scale in scales):
                continue
            known.symmetric_difference_update({unit})
            option.props("", remove="disabled") if unit in known else option.props("disabled")

    refresh()
    return refresh


def _is_known(unit: str, scale: AxisScale | None) -> bool:
    return unit == STEPS or (scale is not None and scale.per_step(unit) is not None)


def number(name: str, value: str, label: str, keyboard: str = "text", *, remember: bool = False) -> ui.input:
    """A text field for a number; it is checked when it is sent, and never rounded or clamped.

    keyboard: a phone's; "numeric" has no minus on some. remember: the browser does (static/panel.js).
    """
    return ui.input(value=value).props(
        f'name={name} inputmode={keyboard} autocomplete=off dense outlined hide-bottom-space aria-label="{label}"'
        + " data-remember" * remember
    )


def send(word: str, request: dict, fields: str = "", *, enter: str = "") -> ui.button:
    """A button that sends a request."""
    props = f"no-caps unelevated data-send='{json.dumps(request)}' data-fields='{fields}'"
    return ui.button(word).props(f"{props} data-enter='{enter}'")


# ---- the camera


def camera_card(view: CameraView) -> None:
    """The picture with the spot and the target, and how the spot is moved.

    The browser draws the picture and the lines, and asks for them (camera.py).
    """
    with card("Camera"):
        ui.html(camera_html(1, view.live.name, clicks=True), sanitize=False).classes("camera-box")
        with ui.element("div").classes("line"):
            ui.label("x, y in px").classes("name")
            number("place_x", "", "x of the place, in pixels of the picture")
            number("place_y", "", "y of the place, in pixels of the picture")
            send("Move the spot there", {"do": "place"}, "x:place_x y:place_y", enter="place_x place_y")
            send("Learn", {"do": "learn"}).props("outline")
        ui.label(
            "Click on the picture: the spot goes there, a second later, in small moves that the camera checks."
            " Learn first: it measures what a step of each axis does to the spot. STOP or any other button ends it."
        ).classes("hint")


# ---- settings

_DONE = "done"
_SHOWN_S = 5  # as long as a page may take to show what was read


Refusal = Callable[[object], str]  # refusal(tick): why this page may not do it; "" if it may


def ticked(word: str, action: Callable[[], Awaitable[object]], refusal: Refusal, mount: int) -> ui.button:
    """A button of NiceGUI's own, for what moves nothing. mount: its number, as static/panel.js counts.

    A click carries the last tick that the page has seen: NiceGUI keeps a click until the network is back.
    """

    async def clicked(event: GenericEventArguments) -> None:
        why = refusal(event.args)
        if why:
            warn(why)
        else:
            await action()

    tick = f"() => emit(window.mountTick({mount}))"
    return ui.button(word).on("click", clicked, js_handler=tick).props("no-caps")


def settings_card(settings: BoardSettings, refusal: Refusal, mount: int) -> Callable[[], None]:
    """A card that opens to all settings. mount: its number, as static/panel.js counts."""

    def button(word: str, action: Callable[[], Awaitable[object]]) -> ui.button:
        return ticked(word, action, refusal, mount)

    with card("Settings"), ui.expansion(", ".join(groups()).capitalize()).classes("fold") as fold:
        form = _Form(settings)
        with ui.dialog() as question, ui.card():
            ui.label("Replace all settings by the factory's?").classes("title")
            ui.label(
                "All settings of all axes change at once: direction, switches, limits, pulse and speed."
                " What is saved on the board stays saved. The present settings are kept, for an undo."
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
            before = ui.label().classes("grow")
            button("Undo the last change", form.undo).props("outline")
        ui.label("Applied settings last until the board restarts, unless they are saved.").classes("hint")
    fold.on_value_change(lambda e: form.read() if e.value else form.rest())

    def refresh() -> None:
        undo.set_visibility(bool(settings.to_undo))
        before.set_text(f"Before the last change: {_listed(settings.to_undo)}")

    refresh()
    return refresh


def _listed(values: Mapping[str, object], most: int = 4) -> str:
    """The first of some settings, and how many more there are."""
    more = len(values) - most
    return ", ".join(f"{name} = {value}" for name, value in [*values.items()][:most]) + (
        f", and {more} more" if more > 0 else ""
    )


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
            # A value comes to the page in two messages: the second would undo what was typed after the first.
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
        await self._made(self._settings.change(lambda mount: mount.recall()), "restored")

    async def factory(self) -> None:
        """Load the defaults; saved settings stay."""
        await self._made(self._settings.change(lambda mount: mount.recall(factory=True)), "factory settings")

    async def undo(self) -> None:
        """Put back the settings from before the last change, and tell which."""
        changed: dict[str, int | float] = {}

        async def undo() -> None:
            changed.update(await self._settings.undo())

        if await self._made(undo(), ""):
            confirm(f"put back: {_listed(changed)}")

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
            raise BadValue(f"{axis}, {SETTINGS[name].what}: type a number, not {text!r}") from None


# ---- the wire log

_SHOWN = 300


def wire_card(worker: Worker, name: str) -> Callable[[], None]:
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


# ---- the mount's state: axes, plot, virtual screen, events

_TITLES = {"x": "X · right and left", "y": "Y · up and down"}
_CERTAINTY = {
    "unknown": ("position unknown", "Counted since the board started, from nowhere known. Zero it, or home it."),
    "counted": ("counted", "Counted in steps since it was called zero."),
    "homed": ("homed", "Counted from its home switch."),
    "estimated": ("estimated", "Part of it was run by time, not by steps; or an encoder lost counts, or is silent."),
    "measured": ("measured", "Counted by the encoder since it was zeroed or homed: a hand on the knob shows, too."),
}
_SWITCHES = ((1, "+ end-stop"), (2, "− end-stop"), (4, "home"))
_PLOT_S = 60.0
_PLOT_EVERY_S = 0.5
_PLOT_POINTS = 300
_GAP_S = 1.0  # No line is drawn where the position was not known for longer.
_GREY = "#737b82"  # readable on the cards of both themes
_COLOURS = ("#0b8f98", "#d9480f", "#6741d9", "#5c940d")

Refresh = Callable[[], None]


def axis_card(worker: Worker, name: str, undo: Callable[[str], Refresh] | None = None) -> Refresh:
    """Position, target, lamps and reason of one axis; go to, zero, home. undo(axis): builds what undoes a Zero."""
    with card(_TITLES.get(name, axis_title(name))) as box:
        with ui.element("div").classes("line"):
            position = ui.label().classes("position mono")
            unit = ui.label().classes("unit")
            with ui.label().classes("mrad mono") as beside:
                ui.tooltip("≈: steps times the measured scale, the mean of both directions; mrad are of the mirror.")
            ui.element("span").classes("spring")
            target = ui.label().classes("hint mono")
        with ui.element("div").classes("lamps"):
            moving, certain = _Lamp("moving"), _Lamp("")
            switches = [(bit, _Lamp(word)) for bit, word in _SWITCHES]
        reason = ui.label().classes("hint reason").props("role=status")
        with ui.element("div").classes("line"):
            number(f"target_{name}", "0", f"Target of {name}").classes("grow")
            wanted_unit = [STEPS]
            refresh_units = unit_choice(
                worker, f"unit_{name}", f"Unit for {name}", [name], lambda one: wanted_unit.__setitem__(0, one)
            )
            fields = f"to:target_{name} unit:unit_{name}"
            send("Go to", {"do": "goto", "axis": name}, fields, enter=f"target_{name}")
            send("Home", {"do": "home", "axis": name}).props("flat")
            send("Zero", {"do": "zero", "axis": name}).props("flat")
            refresh_undo = undo(name) if undo else None

    def refresh() -> None:
        refresh_units()
        if refresh_undo:
            refresh_undo()
        state = worker.state
        known = state.is_known
        box.classes(toggle=None, add="" if known else "stale", remove="stale" if known else "")
        status = state.last.by_name.get(name) if state.last else None
        for label, text in zip((position, unit, beside), _texts(state, name, status, wanted_unit[0]), strict=True):
            label.set_text(text.replace("-", "−"))
        wanted = state.targets.get(name)
        if status is None or not known:
            target.set_text("")
            for lamp in (moving, certain, *(lamp for _, lamp in switches)):
                lamp.show("unknown")
            certain.show("unknown", "not known now")
            reason.set_text("" if status is None else f"not known since {state.seen_at}: the number is the last one")
            return
        target.set_text(
            "" if wanted is None or not status.moving else f"on the way to {wanted:+.10g}".replace("-", "−")
        )
        moving.show("on" if status.moving else "")
        word, why = _CERTAINTY[status.certainty]
        certain.show({"unknown": "", "estimated": "warn"}.get(status.certainty, "on"), word, why)
        for bit, lamp in switches:
            lamp.show("warn" if status.limits & bit else "")
        reason.set_text(_reason(status, state.stopped_by.get(name, "")))

    return refresh


def _texts(state: State, name: str, status: AxisStatus | None, unit: str) -> tuple[str, str, str]:
    """A position, its unit, and what stands beside it: in the chosen unit first, if its scale is known."""
    if status is None:
        return "–", UNITS[STEPS], ""
    steps = f"{status.position:+.3f}"
    scale = state.scales.get(name)
    per_step = scale.per_step(unit) if scale and unit in UNITS and unit != STEPS else None
    if per_step is None:
        return steps, UNITS[STEPS], state.angle_text(name, status.position)
    decimals = 0 if unit.endswith("urad") or unit == "um" else 2
    return f"≈ {status.position * per_step:+.{decimals}f}", UNITS[unit], f"{steps} {UNITS[STEPS]}"


def _reason(status: AxisStatus, stopped_by: str) -> str:
    """The end of the last move in words, and what has stopped it."""
    if status.moving:
        return "it moves"
    text = f"last move: {REASONS.get(status.reason, status.reason)}"
    return f"{text} ({stopped_by})" if stopped_by else text


class _Lamp:
    """A dot with a word; its state is in words, too."""

    def __init__(self, word: str) -> None:
        with ui.element("span").classes("lamp-box") as self._box:
            self._dot = ui.element("span").classes("lamp")
            self._word = ui.label(word)
            self._why = ui.tooltip("")
        self._state: tuple[str, str, str] | None = None

    def show(self, state: str, word: str = "", why: str = "") -> None:
        """state: "" (off), on, warn, bad, or unknown."""
        if (state, word, why) == self._state:
            return
        self._state = (state, word, why)
        self._dot.classes(replace=f"lamp {state}")
        self._box.classes(replace=f"lamp-box {state or 'off'}")
        if word:
            self._word.set_text(word)
        self._why.set_text(why)
        self._why.set_visibility(bool(why))


def plot_card(worker: Worker) -> Refresh:
    """The positions of the last minute."""
    with card("Position over time"):
        chart = ui.echart(_empty_plot(worker.state.axes)).classes("plot")
    drawn = [0.0, 0.0]  # when, and up to which point

    def refresh() -> None:
        now = time.monotonic()
        points = list(worker.state.positions)
        if now - drawn[0] < _PLOT_EVERY_S or not points or points[-1][0] == drawn[1]:
            return
        drawn[:] = now, points[-1][0]
        series = chart.options["series"]
        for one, data in zip(series, curves(points, now, len(series)), strict=True):
            one["data"] = data
        chart.update()

    return refresh


def curves(points: list[Point], now: float, axes: int = 2) -> list[list[list[float | None]]]:
    """Position over time for the plot, a list of (time, steps) an axis.

    Thinned out; where positions were not known for a while there is a gap (None).
    """
    recent = [p for p in points if now - p[0] < _PLOT_S]
    every = max(1, len(recent) // _PLOT_POINTS)
    drawn: list[list[list[float | None]]] = [[] for _ in range(axes)]
    before = None
    for i, (at_s, positions) in enumerate(recent):
        gap = before is not None and at_s - before > _GAP_S
        before = at_s
        t = round(at_s - now, 2)
        for axis, line in enumerate(drawn):
            known = positions is not None and axis < len(positions)
            if gap:
                line.append([t, None])
            if gap or not known or i % every == 0 or i == len(recent) - 1:
                line.append([t, positions[axis] if positions is not None and known else None])
    return drawn


def _empty_plot(axes: Sequence[str]) -> dict:
    line = {"type": "line", "showSymbol": False, "animation": False, "data": []}
    grey = {"lineStyle": {"color": "#88888844"}}
    low = {"onZero": False, "lineStyle": {"color": "#88888888"}}
    return {
        "animation": False,
        "grid": {"left": 44, "right": 12, "top": 28, "bottom": 34},
        "legend": {"top": 0, "right": 8, "icon": "roundRect", "itemHeight": 3, "textStyle": {"color": _GREY}},
        "xAxis": {
            "type": "value",
            "min": -_PLOT_S,
            "max": 0,
            "name": "s",
            "nameGap": 4,
            "axisLine": low,
            "axisLabel": {"color": _GREY},
            "splitLine": grey,
        },
        "yAxis": {
            "type": "value",
            "position": "left",
            "axisLine": low,
            "scale": True,
            "minInterval": 1,
            "name": "steps",
            "nameTextStyle": {"color": _GREY},
            "axisLabel": {"color": _GREY},
            "splitLine": grey,
        },
        "series": [
            {**line, "name": axis_title(name), "lineStyle": {"width": 2}, "color": colour}
            for name, colour in zip(axes, itertools.cycle(_COLOURS), strict=False)
        ],
    }


def screen_card(mount: int) -> None:
    """The virtual board's screen, drawn by static/screen.js. mount: its number, as static/panel.js counts."""
    with card("Virtual screen, 7.62 m away"):
        ui.element("canvas").classes("screen").props("data-screen role=img aria-label='The spot on the screen'")
        with ui.element("div").classes("line"):
            ui.label("The spot and its trail. Turn back, and see the backlash before it follows.").classes("hint grow")
            ui.button("Clear trail", on_click=lambda: ui.run_javascript(f"mountScreenClear({mount})")).props(
                "no-caps flat dense"
            )


def news_card(page: Page, worker: Worker, name: str) -> Refresh:
    """Events, newest first, with causes and remedies; refusals of this page at once, as messages under that name."""
    with card("What happened"):
        keep_alive = _Lamp("keep-alive")
        rows = ui.element("div").classes("news").props("role=log aria-live=polite")
    shown = [-1]

    def refresh() -> None:
        while page.notices:
            text = page.notices.popleft()
            warn(f"{name}: {text}" if name else text)
        driver = worker.driver
        keep_alive.show(
            "on" if driver else "", f"keep-alive: {driver.name} drives" if driver else "keep-alive: at rest"
        )
        notices = list(worker.notices)
        newest = notices[-1].number if notices else 0
        if newest == shown[0]:
            return
        shown[0] = newest
        rows.clear()
        with rows:
            for notice in reversed(notices[-12:]):
                _row(notice)
            if not notices:
                ui.label("Nothing since the panel was started.").classes("hint")

    return refresh


def _row(notice: Notice) -> None:
    known = remedy_of(notice.error)
    with ui.element("div").classes("notice"):
        ui.label(time.strftime("%H:%M:%S", time.localtime(notice.at_s))).classes("mono hint")
        with ui.element("div").classes("grow"):
            ui.label(notice.text)
            if known:
                ui.label(f"Cause: {known.cause}").classes("hint")
                ui.label(f"Remedy: {known.remedy}").classes("hint")
