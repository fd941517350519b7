"""How far the mirror turns with a step: a file of scales, one for each axis and direction. Never guessed.

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

Imports errors, toml_file, whole_file.
"""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from platformdirs import user_config_path

from mirrormount.common import toml_file, whole_file
from mirrormount.common.errors import BadFile, NotCalibrated
from mirrormount.common.printable import printable

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
    return (Path(folder) if folder else user_config_path("mirrormount", appauthor=False)) / "calibration.toml"


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
    toml_file.write(path().resolve(), toml_file.text_for(path(), tables, _HEADING), make_folder=True)
    return path()


def check_writable() -> None:
    """Raise BadFile or CannotWrite if write() would: for work whose result must not be lost. Makes the folder."""
    toml_file.text_for(path(), _tables(), _HEADING)
    whole_file.check_writable(path().resolve(), make_folder=True)


def scale_of(board_id: str, axis: int, name: str, direction: int, step: Step) -> tuple[Scale, float]:
    """The scale, and mrad of the mirror a step in direction 1 or -1, if it was measured with steps like `step`.

    Raises NotCalibrated, BadFile.
    """
    scale = read(board_id, axis)
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
        return toml_file.read(path())
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
