"""Cards that drive: press and hold, numbers of steps, typed speeds. static/panel.js sends their requests."""

import json
from collections.abc import Callable, Sequence

from nicegui import ui

from mirrormount.supervise.presses import HOLD_S, MOST
from mirrormount.supervise.requests import COARSE_STEPS, FINE_STEPS, FULL
from mirrormount.supervise.scales import AxisScale
from mirrormount.supervise.worker import Worker

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
_PAD_AXES = ("x", "y")  # further axes have a row of buttons each
_STEP_WORDS = {"x": ("◀ left", "right ▶"), "y": ("▼ down", "up ▲")}
SLOW = 80  # of 255, where the slider starts: a third of full speed

UNITS = {  # of units.UNITS, as a person reads them
    "steps": "steps",
    "urad": "µrad of the mirror",
    "mrad": "mrad of the mirror",
    "beam-urad": "µrad of the beam",
    "beam-mrad": "mrad of the beam",
    "mm": "mm on the screen",
}

_SLIDER = (
    f'<input type="range" name="speed" min="1" max="{FULL}" value="{SLOW}" aria-label="Speed">'
    f'<output class="mono" data-shows="speed">{SLOW}</output>'
)


def hold(worker: Worker) -> Callable[[], None]:
    """The pad: a short press is one step, a long one runs at the slider's speed. Shows how many presses wait."""
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
            # as plain HTML: Vue would put an input's first value back whenever anything on the page changes
            ui.html(_SLIDER, sanitize=False).classes("slider")
        ui.label(
            f"Short press: {FINE_STEPS} step. Longer than {HOLD_S:g} s: runs until you let go. Arrow keys do the same;"
            f" with Shift {COARSE_STEPS} steps, and full speed. Presses while it steps are queued, up to {MOST}."
        ).classes("hint")

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


def by_numbers(worker: Worker) -> Callable[[], None]:
    """Two cards: amounts to move by, and speeds of x and y. Shows what a step is where a scale was measured."""
    with card("Fine steps"):
        with ui.element("div").classes("line"):
            ui.label("Move by").classes("name")
            number("steps", "1", "Number of steps, or of another unit", keyboard="decimal")
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


def unit_choice(worker: Worker, name: str, label: str, axes: Sequence[str]) -> Callable[[], None]:
    """A choice of units for a number beside it. Those without a scale for any of these axes cannot be chosen."""
    with ui.element("select").classes("unit-choice").props(f'name={name} aria-label="{label}"'):
        options = {
            unit: ui.html(words, sanitize=False, tag="option").props(f"value={unit}") for unit, words in UNITS.items()
        }
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
    match unit:
        case "steps":
            return True
        case "mrad" | "urad":
            return scale is not None
        case "mm":
            return scale is not None and scale.screen_mm is not None
        case _:
            return scale is not None and scale.beam_mrad is not None


def number(name: str, value: str, label: str, keyboard: str = "text") -> ui.input:
    """A text field for a number; it is checked when it is sent, and never rounded or clamped.

    keyboard: a phone's; "numeric" has no minus on some.
    """
    return ui.input(value=value).props(
        f'name={name} inputmode={keyboard} autocomplete=off dense outlined hide-bottom-space aria-label="{label}"'
    )


def send(word: str, request: dict, fields: str = "", *, enter: str = "") -> ui.button:
    """A button that sends a request."""
    props = f"no-caps unelevated data-send='{json.dumps(request)}' data-fields='{fields}'"
    return ui.button(word).props(f"{props} data-enter='{enter}'")
