"""The settings of all axes: their names and ranges, reading and writing them. Imports errors, printable, session.

The board decides: if it refuses a setting, all settings are put back as they were.
"""

import contextlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from mirrormount.common.errors import BadValue, BoardError, NotAMount, NotSupported, SettingRefused
from mirrormount.common.printable import printable
from mirrormount.device.session import Session
from mountfw import codes as wire

_AXIS_NAME = re.compile(r"x|y|axis[3-9]")
_MOST_STEPS = 1_000_000


@dataclass(frozen=True)
class Setting:
    """One setting of an axis. command: its mnemonic on the wire; decimals: how many it keeps; among: all it may be."""

    command: str
    least: float
    most: float
    what: str
    decimals: int = 0
    among: tuple[int, ...] = ()

    def check(self, name: str, value: object) -> None:
        """Raises BadValue that names the setting; nothing is rounded."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadValue(f"{name} is a number, not {printable(repr(value), 60)}")
        if self.among and value not in self.among:
            raise BadValue(f"{name} is one of {', '.join(map(str, self.among))}, not {value}")
        if not self.least <= value <= self.most:
            raise BadValue(f"{name} is within {self.least} … {self.most}, not {value}")
        if self.decimals == 0 and not isinstance(value, int):
            raise BadValue(f"{name} is a whole number, not {value}")
        if round(value, self.decimals) != value:
            raise BadValue(f"{name} has at most {self.decimals} decimals: {value} has more")

    def parse(self, text: str) -> int | float:
        """The board's answer as a number: whole where the value is whole."""
        value = float(text)
        return int(value) if value.is_integer() else value


# In the order in which they are written: the axis's direction first, because limits follow it, and the
# pulse before the velocity that it bounds.
SETTINGS = {
    "inverted": Setting("XI", 0, 1, "1: the axis runs the other way", among=(0, 1)),
    "motor_type": Setting("QM", 0, 3, "3: DC motor connected, 0: none"),
    "pulse_us": Setting("XP", 200, 2_000_000, "length of a step's pulse, us"),
    "step_duty": Setting("XD", 1, 255, "duty of a step, 1 … 255"),
    "run_duty": Setting("XV", 1, 255, "duty of a run, 1 … 255"),
    "take_up_us": Setting("XB", 0, 2_000_000, "drive that takes up the backlash, us; 0: off"),
    "run_limit_ms": Setting("XM", 1, 400_000, "longest run, ms"),
    "search_limit_ms": Setting("XT", 1, 400_000, "longest search for a switch, ms of drive"),
    "velocity": Setting("VA", 0.01, 2000, "steps per second", decimals=2),
    "acceleration": Setting("AC", 1, 200_000, "kept for other programs; pulses do not ramp"),
    "switches": Setting("XL", 0, 7, "switches fitted: 1 positive + 2 negative + 4 home"),
    "soft_minimum": Setting("SL", -_MOST_STEPS, _MOST_STEPS, "negative soft limit, steps"),
    "soft_maximum": Setting("SR", -_MOST_STEPS, _MOST_STEPS, "positive soft limit, steps"),
    "checking": Setting("ZH", 0, 11, "1 ignores end-stops + 8 checks soft limits", among=(0, 1, 2, 3, 8, 9, 10, 11)),
}


def read(session: Session) -> dict[str, dict[str, int | float]]:
    """{"x": {"pulse_us": …}, "y": {…}}, and axis3 … Raises BoardError, NotAMount."""
    return {name: _read_axis(session, number) for name, number in session.board.numbers.items()}


def _read_axis(session: Session, number: int) -> dict[str, int | float]:
    try:
        answers = session.send(";".join(f"{number}{setting.command}?" for setting in SETTINGS.values()))
    except BoardError as e:
        if e.code == wire.NO_SUCH_COMMAND:
            raise NotSupported("the board's firmware is older than its settings: `mirrormount deploy`") from e
        raise
    try:
        pairs = zip(SETTINGS.items(), answers.split("; "), strict=True)
        return {name: setting.parse(text) for (name, setting), text in pairs}
    except ValueError as e:
        raise NotAMount(f"not a mount's settings: {answers[:80]!r}") from e


def write(session: Session, wanted: Mapping[str, Mapping[str, int | float]]) -> None:
    """Change the settings that differ from the board's: all of them, or none.

    Raises BadValue before any byte is sent, SettingRefused when the board refuses one.
    """
    check(wanted)
    for axis in wanted:
        if axis not in session.board.numbers:
            raise _no_axis(axis, session.board.numbers)
    before = read(session)
    check_together(before, wanted)
    try:
        _apply(session, wanted)
    except SettingRefused as e:
        with contextlib.suppress(SettingRefused):  # a refused setting was not changed
            _apply(session, before)
        raise SettingRefused(f"{e}; the settings are as they were") from e


def _apply(session: Session, wanted: Mapping[str, Mapping[str, int | float]]) -> None:
    """Set those that differ. Inverting an axis swaps its limits: it comes first, and the rest is compared after it."""
    for names in (["inverted"], [name for name in SETTINGS if name != "inverted"]):
        now = read(session)
        for axis in wanted:
            for name in names:
                if name in wanted[axis] and wanted[axis][name] != now[axis][name]:
                    _set(session, axis, name, wanted[axis][name])


def _set(session: Session, axis: str, name: str, value: int | float) -> None:
    setting = SETTINGS[name]
    try:
        session.send(f"{session.board.numbers[axis]}{setting.command}{value:.{setting.decimals}f}")
    except BoardError as e:
        raise SettingRefused(f"{axis}.{name} = {value}: {e}") from e


def check(wanted: Mapping[str, Any]) -> None:
    """Raises BadValue for an axis, a name or a value that cannot be."""
    if not isinstance(wanted, Mapping):
        raise BadValue(f"settings are a dict of axes, not {wanted!r}")
    for axis, values in wanted.items():
        if not is_axis(axis) or not isinstance(values, Mapping):
            raise _no_axis(axis, ("x", "y"))
        for name, value in values.items():
            setting(f"{axis}.{name}").check(f"{axis}.{name}", value)


def is_axis(name: object) -> bool:
    """True for the name of an axis: x, y, axis3 … axis9. Whether a board has it, the board shows."""
    return isinstance(name, str) and bool(_AXIS_NAME.fullmatch(name))


def _no_axis(name: object, names: Iterable[str]) -> BadValue:
    return BadValue(f"settings are those of {' and of '.join(names)}; there is no {name!r}")


def check_together(before: Mapping[str, Mapping[str, Any]], wanted: Mapping[str, Mapping[str, Any]]) -> None:
    """Raises BadValue where the wanted settings contradict each other, or those that stay."""
    for axis in wanted:
        after = {**before[axis], **wanted[axis]}
        if after["soft_minimum"] > after["soft_maximum"]:
            raise BadValue(f"{axis}.soft_minimum {after['soft_minimum']} is above its maximum {after['soft_maximum']}")
        if "velocity" in wanted[axis]:  # the board would make fewer steps (n10)
            most = 100_000_000 // (after["pulse_us"] + 1000) / 100
            if after["velocity"] > most:
                raise BadValue(
                    f"{axis}.velocity {after['velocity']} is above {most}: that is all that its pulses fit in"
                )


def setting(name: str) -> Setting:
    """The setting called "x.pulse_us". Raises BadValue with the names of all."""
    axis, _, rest = name.partition(".")
    if not is_axis(axis) or rest not in SETTINGS:
        raise BadValue(f"there is no setting {name!r}: x. or y. and one of {', '.join(SETTINGS)}")
    return SETTINGS[rest]
