"""A move as axis_model.py follows it, and whether a command is accepted. Numbers are those of docs/protocol.md."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from axis_model import AxisModel

DONE, STOPPED, ABORTED, END_STOP, SOFT_LIMIT, RUN_LIMIT, SUPERSEDED, HOMING_FAILED = 1, 2, 3, 4, 5, 6, 8, 12
UNKNOWN, COUNTED, HOMED, ESTIMATED = 0, 1, 2, 3

_PULSE_SLACK_US = 100
BACK_OFF_STEPS = 20  # so far homing drives off a switch before it says that it is not released


@dataclass
class Move:
    """An accepted move. kind: steps, run, frame, home (MT and OR); way is the axis's own."""

    kind: str
    way: int
    duties: tuple[int, ...]  # that it may drive with
    limit_us: float  # of XM, of XT, or of its steps
    n: int = 0
    period_us: int = 0
    length_us: int = 0  # of its pulses
    soft_limit: int | None = None
    back_off_us: int = 0
    to_zero: bool = False  # OR
    causes: set[int] = field(default_factory=set)  # reasons to end that a stop or a frame has given it
    finishing: bool = False  # by ST: the pulse under way is the last one
    pulses: int = 0
    cut: bool = False  # a pulse was
    on_us: int = 0
    slack_us: int = 0
    moved: float = 0.0  # steps
    drives: int = 0
    pulse_at: int | None = None
    off_at: int | None = None

    def is_part(self) -> bool:
        """Is a part of a step in it? XE? tells whole ones."""
        return self.cut or self.moved != round(self.moved)


def possible_velocity(wanted: int, pulse_us: int) -> int:
    """Hundredths of a step per second: what fits, in whole steps if that is not what was asked for."""
    most = 100_000_000 // (pulse_us + 1000)
    return wanted if wanted <= most else most - most % 100 if most >= 100 else most


def rounded(x: float) -> int:
    """To the nearest integer, halves away from zero."""
    return math.floor(x + 0.5) if x >= 0 else -math.floor(0.5 - x)


def outcomes(model: AxisModel, name: str, value: int) -> dict[int, set[int]]:
    """What may become of a motion command on an axis at rest: error (0: accepted) and the steps it may go."""
    if name in ("PR", "PA"):
        return _of_steps(model, name, value)
    s = model.settings
    if name == "XU":
        return _of_pulse(model, value)
    if name == "MV" and s["ZH"] & 8:
        left = s["SR"] - model.position if value > 0 else model.position - s["SL"]
        code = 106 if value > 0 else 107
        slack = model.slack + 0.002 + s["XV"] / model.step
        return {c: {0} for c, possible in ((0, left > -slack), (code, left <= slack)) if possible}
    if name in ("MT", "OR"):
        fitted = s["XL"] & (1 if model.own(home_way(model, name, value)) > 0 else 2)
        return {0: {0}} if fitted and not s["ZH"] & 1 else {135: {0}}
    return {0: {0}}


def _of_steps(model: AxisModel, name: str, value: int) -> dict[int, set[int]]:
    found: dict[int, set[int]] = {}
    s, slack = model.settings, model.slack + 0.0006 * bool(model.slack)
    for position in (model.position - slack, model.position, model.position + slack):
        n = value if name == "PR" else rounded(value - position)
        target = rounded(position) + n
        code = 0
        if abs(target) > 999_999:
            code = 101
        elif s["ZH"] & 8 and target > s["SR"]:
            code = 106
        elif s["ZH"] & 8 and target < s["SL"]:
            code = 107
        found.setdefault(code, set()).add(n)
    return found


def _of_pulse(model: AxisModel, us: int) -> dict[int, set[int]]:
    """An error by where a pulse of its own length would go, to a thousandth of a step."""
    if abs(us) < 200:
        return {7: {0}}
    s, slack = model.settings, model.slack + 0.0021
    found: dict[int, set[int]] = {}
    for position in (model.position - slack, model.position, model.position + slack):
        target = position + us / s["XP"]
        low, high = (s["SL"], s["SR"]) if s["ZH"] & 8 else (-2e6, 2e6)
        code = 101 if abs(target) > 999_999 else 106 if target > high else 107 if target < low else 0
        found.setdefault(code, set()).add(0)
    return found


def home_way(model: AxisModel, name: str, value: int) -> int:
    """Where MT and OR go: home is the negative end-stop, or the only one."""
    if name == "MT":
        return value
    fitted = model.settings["XL"]
    positive, negative = (fitted & 2, fitted & 1) if model.settings["XI"] else (fitted & 1, fitted & 2)
    return -1 if negative or not positive else 1


def started(model: AxisModel, name: str, value: int, n: int) -> Move:
    """The move that an accepted command begins."""
    s = model.settings
    if name in ("PR", "PA"):
        limit_us = abs(n) * (s["XP"] + _PULSE_SLACK_US) + s["XB"]
        period_us = 100_000_000 // possible_velocity(s["VA"], s["XP"])
        return Move("steps", 1 if n > 0 else -1, (s["XD"],), limit_us, n=n, period_us=period_us, length_us=s["XP"])
    way = 1 if value > 0 else -1
    if name == "XU":
        limit_us = abs(value) + s["XB"] + _PULSE_SLACK_US
        period_us = 100_000_000 // possible_velocity(s["VA"], s["XP"]) - s["XP"] + abs(value)
        return Move("steps", way, (s["XD"],), limit_us, n=way, period_us=period_us, length_us=abs(value))
    if name == "frame":
        return Move("frame", way, (abs(value),), s["XM"] * 1000)
    if name == "MV":
        soft = (s["SR"] if way > 0 else s["SL"]) if s["ZH"] & 8 else None
        return Move("run", way, (s["XV"],), s["XM"] * 1000, soft_limit=soft)
    back_off_us = s["XP"] * BACK_OFF_STEPS + s["XB"]
    return Move(
        "home",
        home_way(model, name, value),
        (s["XD"], s["XV"]),
        s["XT"] * 1000,
        back_off_us=back_off_us,
        to_zero=name == "OR",
    )
