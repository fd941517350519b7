"""The three ways to drive: press and hold, numbers of steps, typed speeds. What they send: static/panel.js."""

import json
from collections.abc import Callable

from nicegui import ui

from mirrormount.supervise.presses import HOLD_S, MOST
from mirrormount.supervise.requests import COARSE_STEPS, FINE_STEPS, FULL
from mirrormount.supervise.worker import Pilot

_PAD = (  # place in the pad, x and y, arrow, name
    ("up", "0 1", "▲", "UP"),
    ("left", "-1 0", "◀", "LEFT"),
    ("right", "1 0", "▶", "RIGHT"),
    ("down", "0 -1", "▼", "DOWN"),
    ("up-left", "-1 1", "◤", "UP AND LEFT"),
    ("up-right", "1 1", "◥", "UP AND RIGHT"),
    ("down-left", "-1 -1", "◣", "DOWN AND LEFT"),
    ("down-right", "1 -1", "◢", "DOWN AND RIGHT"),
)
SLOW = 80  # of 255, where the slider starts: a third of full speed

_SLIDER = (
    f'<input type="range" name="speed" min="1" max="{FULL}" value="{SLOW}" aria-label="Speed">'
    f'<output class="mono" data-shows="speed">{SLOW}</output>'
)


def hold(pilot: Pilot) -> Callable[[], None]:
    """The pad: a short press is one step, a long one runs at the slider's speed while it lasts. Shows how many wait."""
    with card("Press and hold"):
        with ui.element("div").classes("pad"):
            for place, press, arrow, word in _PAD:
                with (
                    ui.element("button")
                    .classes(f"press {place}")
                    .props(f'type=button data-press="{press}" aria-label="{word}"')
                ):
                    ui.label(arrow).classes("arrow")
                    if " " not in word:
                        ui.label(word).classes("word")
            queued = ui.label().classes("queued").props("role=status")
        with ui.element("div").classes("line"):
            ui.label("Speed").classes("name")
            # as plain HTML: Vue would put an input's first value back whenever anything on the page changes
            ui.html(_SLIDER, sanitize=False).classes("slider")
        ui.label(
            f"Short press: {FINE_STEPS} step. Longer than {HOLD_S:g} s: runs until you let go. Arrow keys do the same;"
            f" with Shift {COARSE_STEPS} steps, and full speed. Presses while it steps are queued, up to {MOST}."
        ).classes("hint")

    def refresh() -> None:
        queued.set_text(f"{len(pilot.presses)} queued" if pilot.presses else "")

    return refresh


def by_numbers() -> None:
    """Steps by a stated number, and speeds for both motors with OK."""
    with card("Fine steps"):
        with ui.element("div").classes("line"):
            ui.label("Steps").classes("name")
            number("steps", "1", "Number of steps", keyboard="numeric")
        with ui.element("div").classes("fine"):
            for axis, words in (("x", ("◀ left", "right ▶")), ("y", ("▼ down", "up ▲"))):
                for way, word in zip((-1, 1), words, strict=True):
                    send(word, {"do": "steps", "axis": axis, "way": way}, "n:steps").props("outline")
    with card("Speeds of both axes"):
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


def card(title: str) -> ui.element:
    """A box with a title, to be filled."""
    box = ui.element("section").classes("card")
    with box:
        ui.label(title).classes("title").props("role=heading aria-level=2")
    return box


def number(name: str, value: str, label: str, keyboard: str = "text") -> ui.input:
    """A field for a whole number, as text: what is in it is checked when it is sent, and never changed unasked.

    keyboard: a phone's; "numeric" has no minus on some.
    """
    return ui.input(value=value).props(
        f'name={name} inputmode={keyboard} autocomplete=off dense outlined hide-bottom-space aria-label="{label}"'
    )


def send(word: str, order: dict, fields: str = "", *, enter: str = "") -> ui.button:
    """A button that gives an order."""
    props = f"no-caps unelevated data-send='{json.dumps(order)}' data-fields='{fields}'"
    return ui.button(word).props(f"{props} data-enter='{enter}'")
