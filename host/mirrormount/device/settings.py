"""The settings of all axes: their table, reading and writing them.

mountfw/settings.py declares them. The board decides: if it refuses a setting, all settings are restored.
"""

import contextlib
import logging
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mirrormount.device import presets
from mirrormount.device.session import Session
from mirrormount.device.status import Board
from mirrormount.errors import (
    BadValue,
    BoardError,
    ConnectionLost,
    MountError,
    NoAnswer,
    NotAMount,
    NotKept,
    NotSupported,
    SettingRefused,
    doc_texts,
    one_line,
)
from mirrormount.terminal import Terminated, printable
from mirrormount.values import axis_name, did_you_mean, is_axis
from mountfw import board_file
from mountfw import codes as wire
from mountfw import settings as declared

_log = logging.getLogger(__name__)

# The gearbox of the 1000:1 LP motor bears 25 kg mm for a moment, and its extrapolated stall torque at 6 V is 55 kg mm
# (Pololu's page of #3058). On a DRV8833 at 6 V a duty of 100 stalls at 22 kg mm, if the current follows the duty.
MOST_STALL_DUTY = 100

_FORMER = "settings"  # as presets.remember() calls them

Settings = Mapping[str, Mapping[str, int | float]]  # of each axis, by name: {"x": {"pulse_us": …}, …}


@dataclass(frozen=True)
class Setting:
    """One setting of an axis, as mountfw/settings.py declares it.

    command: its mnemonic on the wire; decimals: how many it keeps; among: all values that it may have, if not
    each within least … most; at_rest: refused while the axis moves.
    """

    name: str
    command: str
    least: int | float
    most: int | float
    default: int | float
    decimals: int
    among: tuple[int, ...]
    at_rest: bool

    @property
    def group(self) -> str:
        """The settings that belong together, for the panel."""
        return self._words()[0]

    @property
    def what(self) -> str:
        """Its words for a person, with the unit."""
        return self._words()[1]

    @property
    def details(self) -> str:
        """What else docs/protocol.md says of it, in Markdown; "" if nothing."""
        return self._words()[2]

    def _words(self) -> tuple[str, str, str]:
        words, _, details = doc_texts("settings", "_setting")[self.name].partition("\n\n")
        group, _, what = one_line(words).partition(": ")
        return group, what, one_line(details)

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


def _setting(command: bytes, name: str, least: int, most: int, default: int, flags: int) -> Setting:
    decimals = 2 if flags & declared.HUNDREDTHS else 0
    lower, upper, made = (n / 10**decimals if n % 10**decimals else n // 10**decimals for n in (least, most, default))
    among = tuple(n for n in range(most + 1) if not n & ~most) if flags & declared.BITS else ()
    return Setting(name, command.decode(), lower, upper, made, decimals, among, bool(flags & declared.AT_REST))


# in the order in which they are written: the direction first, because limits follow it
SETTINGS = {entry[1]: _setting(*entry) for entry in [*declared.SETTINGS, *declared.ENCODER_SETTINGS]}
ENCODER = {entry[1]: SETTINGS[entry[1]] for entry in declared.ENCODER_SETTINGS}  # those of an encoder
_OF_ALL = {name: setting for name, setting in SETTINGS.items() if name not in ENCODER}


def groups() -> list[str]:
    """The groups of the settings that every axis has, in the order of their declarations."""
    return list(dict.fromkeys(setting.group for setting in _OF_ALL.values()))


def read(session: Session) -> dict[str, dict[str, int | float]]:
    """{"x": {"pulse_us": …}, "y": {…}}, and axis3 … Those of an encoder, where one is. Raises BoardError, NotAMount."""
    return {name: _read_axis(session, number) for name, number in session.board.numbers.items()}


def _read_axis(session: Session, number: int) -> dict[str, int | float]:
    try:
        return _read_some(session, number, _OF_ALL) | (
            _read_some(session, number, ENCODER) if has_encoder(session, number) else {}
        )
    except BoardError as e:
        if e.code == wire.NO_SUCH_COMMAND:
            raise NotSupported("the board's firmware is older than its settings: `mirrormount deploy`") from e
        raise


def _read_some(session: Session, number: int, some: Mapping[str, Setting]) -> dict[str, int | float]:
    answers = session.send(";".join(f"{number}{setting.command}?" for setting in some.values()))
    try:
        pairs = zip(some.items(), answers.split("; "), strict=True)
        return {name: setting.parse(text) for (name, setting), text in pairs}
    except ValueError as e:
        raise NotAMount(f"not a mount's settings: {answers[:80]!r}") from e


def has_encoder(session: Session, number: int) -> bool:
    """Does the board say that this axis has an encoder? It is asked once."""
    known = session.board.encoders
    if number not in known:
        try:
            session.send(f"{number}XC?")
            known[number] = True
        except BoardError as e:
            known[number] = e.code % 100 == wire.AXIS_ENCODER_LOST  # fitted, but it does not answer
    return known[number]


def read_one(session: Session, axis: str, name: str) -> int | float:
    """The setting `name` of an axis. Raises BoardError, NotAMount."""
    setting = SETTINGS[name]
    answer = session.send(f"{session.board.numbers[axis]}{setting.command}?")
    try:
        return setting.parse(answer)
    except ValueError as e:
        raise NotAMount(f"not the answer to {setting.command}?: {answer[:80]!r}") from e


def write(session: Session, wanted: Mapping[str, Mapping[str, int | float]]) -> None:
    """Change the settings that differ from the board's: all of them, or none, also where an interrupt ends it.

    Raises BadValue before any byte is sent, SettingRefused when the board refuses one; NoAnswer, ConnectionLost. The
    error says if the settings are not as they were.
    """
    check(wanted)
    for axis in wanted:
        if axis not in session.board.numbers:
            raise _no_axis(axis, session.board.numbers)
    before = read(session)
    check_together(before, wanted)
    try:
        changed = False
        for one in _differing(session, wanted):
            if not changed:
                _remember(session, before)
            changed = True
            _set(session, *one)
        _warn(wanted)
    except (SettingRefused, NoAnswer, ConnectionLost) as e:
        raise type(e)(f"{e}; {_undone(session, before)}") from e
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; {_undone(session, before)}") from None
    except Terminated as e:
        e.args = (f"{e}; {_undone(session, before)}",)
        raise
    except BaseException:
        _undone(session, before)
        raise


def _warn(wanted: Mapping[str, Mapping[str, int | float]]) -> None:
    """Tell of values that are allowed and may do harm."""
    for axis, values in wanted.items():
        if values.get("stall_duty", 0) > MOST_STALL_DUTY:
            _log.warning(
                "%s.stall_duty %d: above %d a stall may break the gears (docs/bring-up.md, Encoder)",
                *(axis, values["stall_duty"], MOST_STALL_DUTY),
            )


def _undone(session: Session, before: Mapping[str, Mapping[str, int | float]]) -> str:
    """Put the settings back. Returns how they are, for an error."""
    try:
        put_back(session, before)
    except SettingRefused as e:
        return str(e)
    except MountError:
        return "which settings are changed is not known: `mirrormount config get` shows them"
    return "the settings are as they were"


def put_back(session: Session, before: Mapping[str, Mapping[str, int | float]]) -> None:
    """Write settings that the board had before; one that it refuses does not keep the others from it.

    Where an encoder has failed meanwhile, the board says so when its loop is closed again or soon after that, once for
    each axis: that refuses nothing. Raises SettingRefused if some are not as they were.
    """
    for _ in range(1 + len(before)):
        with contextlib.suppress(BoardError):
            if not _set_differing(session, before):
                return
    if left := _set_differing(session, before):
        raise SettingRefused(f"the board does not take back {', '.join(left)}")


def recall(session: Session, *, factory: bool) -> None:
    """Take the settings that are saved on the board, or the factory's. Raises BoardError."""
    before = read(session)
    session.send("*RCL0" if factory else "*RCL1")
    if read(session) != before:
        _remember(session, before)


def _remember(session: Session, before: Mapping[str, Mapping[str, int | float]]) -> None:
    """Keep the settings for undo(): by the axes' numbers, for which axis is called x may change meanwhile."""
    numbers = session.board.numbers
    presets.remember(session.board.id, _FORMER, {str(numbers[name]): values for name, values in before.items()})


def undo(session: Session) -> dict[str, int | float]:
    """Put back the settings from before the last change that this computer has made, all or none.

    A second undo() changes them again. Returns what was changed, by "x.pulse_us" … Raises NotKept, and as write().
    """
    now = read(session)
    before = former(session.board, now)
    if before is None:
        raise NotKept("this computer knows of no change of this board's settings that could be undone")
    write(session, before)
    return differing(now, read(session))


def former(board: Board, now: Settings) -> Settings | None:
    """The settings from before the last change that this computer has made; None if it knows of none.

    now: the present ones. The board is not asked. Raises BadFile, CannotWrite.
    """
    names = {str(number): name for name, number in board.numbers.items()}
    for _, _, entry in presets.former(board.id, _FORMER):
        before = {names[number]: values for number, values in entry.items() if number in names}
        if before != now:
            return before
    return None


def differing(now: Settings, other: Settings) -> dict[str, int | float]:
    """What of the others is not as it is now, by "x.pulse_us" …"""
    return {
        f"{axis}.{name}": value
        for axis, values in other.items()
        for name, value in values.items()
        if value != now[axis].get(name)
    }


def _set_differing(session: Session, before: Mapping[str, Mapping[str, int | float]]) -> list[str]:
    """Set those that differ, also after a refusal, which may depend on a later one. Returns them: [] if none did."""
    found: list[str] = []
    for axis, name, value in _differing(session, before):
        found.append(f"{axis}.{name} = {value}")
        with contextlib.suppress(SettingRefused):
            _set(session, axis, name, value)
    return found


def _differing(
    session: Session, wanted: Mapping[str, Mapping[str, int | float]]
) -> Iterator[tuple[str, str, int | float]]:
    """Axis, name and value of those that differ from the board's, each to be set before the next one is taken.

    Inverting an axis swaps its limits: it comes first, and the rest is compared after it.
    """
    for names in (["inverted"], [name for name in SETTINGS if name != "inverted"]):
        now = read(session)
        for axis in wanted:
            for name in names:
                if name in wanted[axis] and wanted[axis][name] != now[axis].get(name, 0):  # 0: no encoder
                    yield axis, name, wanted[axis][name]


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
        if not is_axis(axis):
            raise _no_axis(axis, ("x", "y"))
        if not isinstance(values, Mapping):
            raise BadValue(f"[{axis}] is not a table of settings, as [{axis}] and a line such as velocity = 1 are")
        for name, value in values.items():
            setting(f"{axis}.{name}").check(f"{axis}.{name}", value)


def saved_file(wanted: Mapping[str, Mapping[str, Any]]) -> bytes:
    """The file that keeps these settings on a board on which x is axis 2, as made but for them. Raises BadValue."""
    check(wanted)
    made = {name: setting.default for name, setting in SETTINGS.items()}
    check_together(dict.fromkeys(wanted, made), wanted)
    numbers = {axis_name(number, 2): number for number in range(1, len(board_file.AXES) + 1)}
    lines: list[str] = []
    for axis, values in wanted.items():
        if axis not in numbers:
            raise _no_axis(axis, numbers)
        for name in (name for name in SETTINGS if name in values):
            raw = round(values[name] * 10 ** SETTINGS[name].decimals)
            lines.append(declared.saved_line(numbers[axis], name, raw))
    return declared.seal("".join(lines))


def _no_axis(name: object, names: Iterable[str]) -> BadValue:
    return BadValue(f"settings are those of {' and of '.join(names)}; there is no {name!r}")


def check_together(before: Mapping[str, Mapping[str, Any]], wanted: Mapping[str, Mapping[str, Any]]) -> None:
    """Raises BadValue where the wanted settings contradict each other, or those that stay."""
    for axis in wanted:
        after = {**before[axis], **wanted[axis]}
        if after["soft_minimum"] > after["soft_maximum"]:
            raise BadValue(f"{axis}.soft_minimum {after['soft_minimum']} is above its maximum {after['soft_maximum']}")
        if wanted[axis].get("closed_loop") and after.get("counts_per_step") == 0:  # the board would say n35 only
            raise BadValue(f"{axis}.closed_loop needs {axis}.counts_per_step, which `mirrormount setup` measures")
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
        everything = f": x. or y. and one of {', '.join(SETTINGS)}"
        meant = did_you_mean(rest, SETTINGS)
        raise BadValue(f"there is no setting {name!r}{meant or everything}")
    return SETTINGS[rest]
