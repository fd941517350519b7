"""Cards that drive: press and hold, numbers of steps, typed speeds. static/panel.js sends their requests."""

import json
from collections.abc import Callable

from nicegui import ui

from mirrormount.supervise.presses import HOLD_S, MOST
from mirrormount.supervise.requests import COARSE_STEPS, FINE_STEPS, FULL
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
    """Two cards: steps by a number, and speeds of x and y. Shows what a step is where a scale was measured."""
    with card("Fine steps"):
        with ui.element("div").classes("line"):
            ui.label("Steps").classes("name")
            number("steps", "1", "Number of steps", keyboard="numeric")
        with ui.element("div").classes("fine"):
            for axis in worker.state.axes:
                for way, word in zip(
                    (-1, 1), _STEP_WORDS.get(axis) or (f"− {axis_title(axis)}", f"{axis_title(axis)} +"), strict=True
                ):
                    send(word, {"do": "steps", "axis": axis, "way": way}, "n:steps").props("outline")
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

    return refresh


def card(title: str) -> ui.element:
    """An empty card with a title."""
    box = ui.element("section").classes("card")
    with box:
        ui.label(title).classes("title").props("role=heading aria-level=2")
    return box


def number(name: str, value: str, label: str, keyboard: str = "text") -> ui.input:
    """A text field for a whole number; it is checked when it is sent, and never rounded or clamped.

    keyboard: a phone's; "numeric" has no minus on some.
    """
    return ui.input(value=value).props(
        f'name={name} inputmode={keyboard} autocomplete=off dense outlined hide-bottom-space aria-label="{label}"'
    )


def send(word: str, request: dict, fields: str = "", *, enter: str = "") -> ui.button:
    """A button that sends a request."""
    props = f"no-caps unelevated data-send='{json.dumps(request)}' data-fields='{fields}'"
    return ui.button(word).props(f"{props} data-enter='{enter}'")
