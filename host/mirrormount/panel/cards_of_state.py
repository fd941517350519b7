"""Cards of the mount's state: position and lamps of an axis, its past, events, and the virtual screen."""

import itertools
import time
from collections.abc import Callable, Sequence

from nicegui import ui

from mirrormount.common.errors import REASONS
from mirrormount.common.remedies import remedy_of
from mirrormount.device.status import AxisStatus
from mirrormount.panel.cards_of_motion import axis_title, card, number, send, unit_choice
from mirrormount.panel.pages import Page
from mirrormount.panel.run_on_mount import warn
from mirrormount.supervise.notices import Notice
from mirrormount.supervise.state import Point
from mirrormount.supervise.worker import Worker

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
_GAP_S = 1.0  # without a position for longer: no line is drawn
_GREY = "#737b82"  # readable on the cards of both themes
_COLOURS = ("#0b8f98", "#d9480f", "#6741d9", "#5c940d")

Refresh = Callable[[], None]


def axis(worker: Worker, name: str) -> Refresh:
    """Position, target, lamps and reason of one axis; go to, zero, home."""
    with card(_TITLES.get(name, axis_title(name))) as box:
        with ui.element("div").classes("line"):
            position = ui.label().classes("position mono")
            ui.label("steps").classes("unit")
            with ui.label().classes("mrad mono") as mrad:
                ui.tooltip(
                    "mrad of the mirror, mm on the screen: steps times the measured scale, the mean of both directions."
                )
            ui.element("span").classes("spring")
            target = ui.label().classes("hint mono")
        with ui.element("div").classes("lamps"):
            moving, certain = _Lamp("moving"), _Lamp("")
            switches = [(bit, _Lamp(word)) for bit, word in _SWITCHES]
        reason = ui.label().classes("hint reason").props("role=status")
        with ui.element("div").classes("line"):
            number(f"target_{name}", "0", f"Target of {name}").classes("grow")
            refresh_units = unit_choice(worker, f"unit_{name}", f"Unit for {name}", [name])
            fields = f"to:target_{name} unit:unit_{name}"
            send("Go to", {"do": "goto", "axis": name}, fields, enter=f"target_{name}")
            send("Home", {"do": "home", "axis": name}).props("flat")
            send("Zero", {"do": "zero", "axis": name}).props("flat")

    def refresh() -> None:
        refresh_units()
        state = worker.state
        known = state.is_known
        box.classes(toggle=None, add="" if known else "stale", remove="stale" if known else "")
        status = state.last.by_name.get(name) if state.last else None
        position.set_text("–" if status is None else f"{status.position:+.3f}".replace("-", "−"))
        mrad.set_text("" if status is None else state.angle_text(name, status.position))
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


def plot(worker: Worker) -> Refresh:
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


def screen(mount: int) -> None:
    """The virtual board's screen, drawn by static/screen.js. mount: its number, as static/panel.js counts."""
    with card("Virtual screen, 7.62 m away"):
        ui.element("canvas").classes("screen").props("data-screen role=img aria-label='The spot on the screen'")
        with ui.element("div").classes("line"):
            ui.label("The spot and its trail. Turn back, and see the backlash before it follows.").classes("hint grow")
            ui.button("Clear trail", on_click=lambda: ui.run_javascript(f"mountScreenClear({mount})")).props(
                "no-caps flat dense"
            )


def news(page: Page, worker: Worker, name: str) -> Refresh:
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
