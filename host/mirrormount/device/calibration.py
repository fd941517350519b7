"""How far the mirror turns with a step: the file of scales, and the arithmetic that makes them. Never guessed.

A virtual mount in this process brings its own scale, which goes as long as the file has none of its axis.

The file is calibration.toml in the user's folder for settings (or in $MIRRORMOUNT_CONFIG), with a
table for each axis of each board, under the board's unique id:

    [e6616408432f5a21.axis2]
    positive = 0.2152      # mrad of the mirror a step, in the positive direction
    negative = 0.2149
    pulse_us = 200000      # the step that was measured: another one has another scale
    step_duty = 255
    inverted = 0
    beam_per_mirror = 2.0  # by how much the beam turns when the mirror turns by 1; for angles of the beam
    screen_mm = 1500.0     # from the mirror to the screen; for mm on the screen

Angles are the mirror's. A beam that a mirror reflects turns by twice the mirror's angle when the mirror
turns about an axis that is perpendicular to the plane of the beam, and by 2 cos(incidence) when it tips
about an axis in that plane (both follow from r = d - 2 (d·n) n).
"""

import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mirrormount import files
from mirrormount.device.settings import SETTINGS
from mirrormount.errors import BadFile, NotCalibrated
from mirrormount.terminal import printable

_NUMBERS = ("positive", "negative", "beam_per_mirror", "screen_mm")  # of Scale: each above 0, or missing
_LEAST, _MOST = 1e-9, 1e9  # of each number: far beyond any mirror mount, and safe to divide by
_HEADING = """mirrormount: how far the mirror turns with a step (docs/calibration.md).
positive, negative: mrad of the mirror a step. pulse_us, step_duty, inverted: the step that was measured.
beam_per_mirror: beam angle for a mirror angle of 1. screen_mm: from the mirror to the screen.
Written by `mirrormount setup` and `measure`, which keep the numbers of other boards but no remarks."""


@dataclass(frozen=True)
class Step:
    """The step that a scale belongs to: length in us, duty 1 … 255, and whether the axis is inverted."""

    pulse_us: int
    step_duty: int
    inverted: int = 0


@dataclass(frozen=True)
class Scale:
    """mrad of the mirror a step in either direction (None: not measured), and the step it was measured with.

    beam_per_mirror: by how much the beam turns when the mirror turns by 1. screen_mm: from the mirror to the screen.
    """

    positive: float | None
    negative: float | None
    step: Step
    beam_per_mirror: float | None = None
    screen_mm: float | None = None


def path() -> Path:
    """The path of the file of scales."""
    folder = os.environ.get("MIRRORMOUNT_CONFIG")
    if folder:
        return Path(folder) / "calibration.toml"
    from platformdirs import user_config_path  # a stop needs none of it

    return user_config_path("mirrormount", appauthor=False) / "calibration.toml"


def read(board_id: str, axis: int) -> Scale | None:
    """The scale of an axis of a board by its number, or None. Raises BadFile."""
    table = _tables().get(board_id, {})
    name = f"axis{axis}"
    where = f"{path()}: [{board_id}.{name}]"
    if not isinstance(table, Mapping) or not isinstance(table.get(name, {}), Mapping):
        raise BadFile(f"{where} is not a table: correct the file, or move it away and run `mirrormount setup`")
    if name not in table:
        return None
    entry = table[name]
    step = Step(
        _whole(entry, "pulse_us", where),
        _whole(entry, "step_duty", where),
        _whole({"inverted": 0} | entry, "inverted", where),
    )
    numbers = {key: _number(entry, key, where) for key in _NUMBERS}
    return Scale(step=step, **numbers)


def write(board_id: str, scales: Mapping[int, Scale]) -> Path:
    """Store the scales of some axes of a board, by their numbers; the rest of the file stays. Returns its path.

    Raises BadFile if the file that is there is damaged (it is not touched), CannotWrite.
    """
    tables = _tables()
    board = tables.setdefault(board_id, {})
    if not isinstance(board, dict):
        raise BadFile(f"{path()}: [{board_id}] is not a table: correct the file, or move it away")
    for axis, scale in scales.items():
        measured = {key: getattr(scale, key) for key in _NUMBERS}
        board[f"axis{axis}"] = {k: v for k, v in measured.items() if v is not None} | asdict(scale.step)
    # a link in the user's own folder of settings is the user's: the file that it leads to is written
    files.write_atomic(path().resolve(), files.toml_text_for(path(), tables, _HEADING), make_folder=True)
    return path()


def check_writable() -> None:
    """Raise BadFile or CannotWrite if write() would: for work whose result must not be lost. Makes the folder."""
    files.toml_text_for(path(), _tables(), _HEADING)
    files.check_writable(path().resolve(), make_folder=True)


def scale_of(
    board_id: str, axis: int, name: str, direction: int, step: Step, own: Scale | None = None
) -> tuple[Scale, float]:
    """The scale, and mrad of the mirror a step in direction 1 or -1, if it was measured with steps like `step`.

    own: that of a virtual mount, which goes where none was measured. Raises NotCalibrated, BadFile.
    """
    scale = read(board_id, axis) or own
    which = "positive" if direction > 0 else "negative"
    value = getattr(scale, which) if scale else None
    if scale is None or value is None:
        raise NotCalibrated(
            f"{name}: no scale in the {which} direction: run `mirrormount setup` or, with a camera,"
            f" `mirrormount measure steps --apply`, or write {which}, pulse_us and"
            f" step_duty under [{board_id}.axis{axis}] in {path()} (docs/calibration.md)"
        )
    if scale.step != step:
        raise NotCalibrated(
            f"{name}: the scale is that of another step ({_words(scale.step)}; now {_words(step)}):"
            " set that again, or run `mirrormount setup`"
        )
    return scale, value


def _tables() -> dict[str, Any]:
    try:
        return files.read_toml(path())
    except BadFile as e:
        raise BadFile(f"{e}: correct it, or move it away and run `mirrormount setup`") from e


def _words(step: Step) -> str:
    return f"{step.pulse_us} us at duty {step.step_duty}{', inverted' if step.inverted else ''}"


def _number(entry: Mapping[str, Any], key: str, where: str) -> float | None:
    value = entry.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not (_LEAST <= value <= _MOST):
        shown = printable(repr(value), 60)
        raise BadFile(f"{where}: {key} is a number above 0 ({_LEAST:g} … {_MOST:g}), not {shown}")
    return float(value)


def _whole(entry: Mapping[str, Any], key: str, where: str) -> int:
    value = entry.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise BadFile(f"{where}: {key} is a whole number, not {printable(repr(value), 60)}")
    return value


# ---- from marks on a screen to a scale and a backlash


def beam_per_mirror(name: str, incidence_deg: float) -> float:
    """By how much the beam turns when the mirror turns by 1, for axis x or y and a beam in a horizontal plane."""
    return 2.0 if name == "x" else 2.0 * math.cos(math.radians(incidence_deg))


def take_up(lost_us: float) -> tuple[int, str]:
    """The setting take_up_us for what a turn loses, in us of drive; and words where that is beyond its range, or ""."""
    most = int(SETTINGS["take_up_us"].most)
    if lost_us <= most:
        return max(0, round(lost_us)), ""
    return most, f"a turn loses {lost_us * 1e-6:.3g} s of drive, and the board takes up {most * 1e-6:g} s at most"


@dataclass(frozen=True)
class Marks:
    """Where the spot was, in mm along the axis's positive direction, at rest after each of these moves.

    start: after an approach in the positive direction; then n steps forward, n back (the backlash is in
    these), n more back, and n forward again (with the backlash of the other turn).
    """

    start: float
    forward: float
    turned: float
    back: float
    again: float


@dataclass(frozen=True)
class Measured:
    """mrad of the mirror a step, and the steps that were lost in each turn (to negative, to positive)."""

    positive: float
    negative: float
    lost: tuple[float, float]

    @property
    def backlash(self) -> float:
        """Steps that a turn loses, the mean of both; not less than 0."""
        return max(0.0, sum(self.lost) / 2)


def measure_scale(marks: Marks, n: int, distance_mm: float, factor: float) -> Measured | None:
    """The scale from marks that are n steps apart, on a screen at distance_mm across the beam.

    factor is beam_per_mirror(). None if the marks do not go the way that the axis went.
    """

    def mrad(mm: float) -> float:
        return math.atan(mm / distance_mm) / factor * 1e3

    positive = mrad(marks.forward - marks.start) / n
    negative = mrad(marks.turned - marks.back) / n
    if positive <= 0 or negative <= 0:
        return None
    lost = (
        n - mrad(marks.forward - marks.turned) / negative,
        n - mrad(marks.again - marks.back) / positive,
    )
    return Measured(positive, negative, lost)
