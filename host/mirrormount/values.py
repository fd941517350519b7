"""Numbers, units and names that people type, and what is refused.

Nothing is rounded or clamped in silence: a value that cannot be taken as it is given raises BadValue.

Axes come in pairs, a mount each: 1 and 2, 3 and 4 … One axis of a mount's pair is called x and the other one y; a
board's further axes have their numbers: axis3, axis4 …

An amount to move is given in steps, in an angle of the mirror or of the beam, or in mm on the screen. The mirror's
angle is measured (device/calibration.py). The beam's is that times beam_per_mirror; a spot on a screen across the beam,
at the distance L of the mirror, moves by L times the beam's angle, as long as that is small (tan a = a within 0.3 % up
to 100 mrad).
"""

import operator
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Protocol, SupportsFloat, SupportsIndex

from mirrormount.errors import BadValue, NotAMount, NotCalibrated

# ---- axes

_AXIS_NAME = re.compile(r"x|y|axis[1-9]")


def axis_name(number: int, x_axis: int) -> str:
    """The name of a board's axis; x_axis: the number of x. The other one of its pair is y."""
    if number == x_axis:
        return "x"
    return "y" if number == paired(x_axis) else f"axis{number}"


def paired(number: int) -> int:
    """The number of the axis with which this one makes a mount."""
    return number - 1 if number % 2 == 0 else number + 1


def is_axis(name: object) -> bool:
    """True for a name that an axis can have. Its board shows whether there is one."""
    return isinstance(name, str) and bool(_AXIS_NAME.fullmatch(name))


# ---- names of mounts and cameras

TABLE_VARIABLE = "MIRRORMOUNT_TABLE"  # of the environment: the file of names, instead of table.toml
NAME_RULE = "a letter, then letters, digits, - and _, at most 31 in all, and no COM port"
_NAME = re.compile(r"(?!com[0-9]+$)[a-z][a-z0-9_-]{0,30}", re.IGNORECASE)


def is_name(text: str) -> bool:
    """True for a text that may be a name, and so is no port and no address."""
    return bool(_NAME.fullmatch(text))


# ---- how long silence may last

KEEP_ALIVE_MS = 500  # The board ends its motions by itself after so long without a byte of its host.
PATIENCE_S = 0.35  # The motion of a supervised mount's client is stopped after so much silence of the client.
LEAST_PATIENCE_S, MOST_PATIENCE_S = 0.1, 2.0  # the limits of --patience


# ---- units


class Geometry(Protocol):
    """Between mirror and screen; None: not known. device/calibration.py:Scale is one."""

    @property
    def beam_per_mirror(self) -> float | None:
        """By how much the beam turns when the mirror turns by 1."""
        ...

    @property
    def screen_mm(self) -> float | None:
        """From the mirror to the screen."""
        ...


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """The end of an error for a word that is no name: "; did you mean step or stop?"; "" if none is near."""
    import difflib

    near = difflib.get_close_matches(word, list(names), 2, 0.7)
    return f"; did you mean {' or '.join(near)}?" if near else ""


STEPS = "steps"
MOST_AMOUNT = 1_000_000_000  # the largest amount of any unit


def _mirror(_geometry: Geometry, mirror_mrad: float) -> float:
    return mirror_mrad


def _beam(geometry: Geometry, mirror_mrad: float) -> float | None:
    return mirror_mrad * geometry.beam_per_mirror if geometry.beam_per_mirror else None


def _screen(geometry: Geometry, mirror_mrad: float) -> float | None:
    beam_mrad = _beam(geometry, mirror_mrad)
    return beam_mrad * 1e-3 * geometry.screen_mm if beam_mrad and geometry.screen_mm else None


# For each unit: what converts an angle of the mirror in mrad (to None if the geometry is not known), and a factor.
_OF: Mapping[str, tuple[Callable[[Geometry, float], float | None], float]] = {
    "mrad": (_mirror, 1.0),
    "urad": (_mirror, 1e3),
    "beam-mrad": (_beam, 1.0),
    "beam-urad": (_beam, 1e3),
    "mm": (_screen, 1.0),
    "um": (_screen, 1e3),
}
UNITS = (STEPS, *_OF)
HELP = "steps (default); mrad, urad: of the mirror; beam-mrad, beam-urad; mm, um: on the screen"
_MICRO = str.maketrans("\u00b5\u03bc", "uu")  # the micro sign, and the Greek letter that looks like it
_WITH_UNIT = re.compile(r"(.*?[0-9.]) ?([a-z\u00b5\u03bc-]+)", re.IGNORECASE)


def spelled(unit: str) -> str:
    """A unit as UNITS has it: urad for µrad, with either of the two signs that keyboards have for micro."""
    return unit.translate(_MICRO)


def check(unit: str) -> str:
    """The unit as UNITS has it, if it is one. Raises BadValue."""
    found = spelled(unit)
    if found not in UNITS:
        raise BadValue(f"a unit is {', '.join(UNITS[:-1])} or {UNITS[-1]}, not {unit!r}{did_you_mean(found, UNITS)}")
    return found


def amount_and_unit(text: str, unit: str | None) -> tuple[str, str]:
    """The number and the unit of an amount that a person has typed as "100urad", or as "100" and "urad", or as "5".

    unit: the second word, None without one. Raises BadValue for what is no unit, and for two of them.
    """
    joined = _WITH_UNIT.fullmatch(text)
    if joined is None:
        return text, check(unit or STEPS)
    if unit is not None:
        raise BadValue(f"{text} has a unit already: leave {unit} out")
    return joined[1], check(joined[2])


def per_step(geometry: Geometry, mirror_mrad: float, unit: str, name: str) -> float:
    """How much of a unit one step is, if one step is mirror_mrad of the mirror. Raises NotCalibrated."""
    convert, of_unit = _OF[unit]
    amount = convert(geometry, mirror_mrad)
    if amount is None:
        missing = "beam_per_mirror" if not geometry.beam_per_mirror else "screen_mm"
        raise NotCalibrated(
            f"{name}: {unit} needs {missing} beside the scale: run `mirrormount setup` (docs/calibration.md)"
        )
    return amount * of_unit


# ---- numbers

_LARGEST = 1 << 53  # a float holds every whole number up to it


def whole_number(value: object, most: int, what: str) -> int:
    """value as an int within -most ... most. Raises BadValue; nothing is rounded or clamped.

    What counts is the value: 5, 5.0 and NumPy's whole numbers are whole; a truth value and a text are no numbers.
    """
    number = _number(value)
    if number is None or number % 1:
        raise BadValue(f"{what} is a whole number, not {value!r}")
    return int(_within(number, most, what))


def real_number(value: object, most: int, what: str) -> int | float:
    """value as a number within -most ... most, an int if it is whole. Raises BadValue."""
    number = _number(value)
    if number is None:
        raise BadValue(f"{what} is a number, not {value!r}")
    return _within(number, most, what)


def jog_duty(speed: object) -> int:
    """The duty, -255 … 255, that is nearest to a jog's speed, -1 … 1 of full duty and not 0. Raises BadValue."""
    if isinstance(speed, bool) or not isinstance(speed, int | float) or not 0 < abs(speed) <= 1:
        raise BadValue(f"a jog's speed is a number within -1 … 1 other than 0, not {speed!r}")
    duty = round(speed * 255)
    if duty == 0:
        raise BadValue(f"a jog's speed comes in steps of 1/255: {speed!r} is none")
    return duty


def _within(number: int | float, most: int, what: str) -> int | float:
    if abs(number) > most:
        raise BadValue(f"{what} is within -{most} … {most}, not {number}")
    return number


def _number(value: object) -> int | float | None:
    """The number that value is, an int if it is whole; None if it is none."""
    if type(value).__name__ in ("bool", "bool_") or hasattr(value, "__len__"):  # truth values (NumPy's, too) and texts
        return None
    if isinstance(value, SupportsIndex):
        return operator.index(value)
    if not isinstance(value, SupportsFloat):
        return None
    number = float(value)
    if number.is_integer():
        return int(number)
    return number if abs(number) < float("inf") else None  # no NaN either


def typed_number(text: str, what: str) -> float:
    """The number that a person has typed. Raises BadValue, also for 1_000, which only Python takes for one."""
    try:
        if not text.isascii() or "_" in text:
            raise ValueError
        value = float(text)
    except ValueError:
        raise BadValue(f"{what} is a number, not {text!r}") from None
    if not value and any(digit in text.lower().partition("e")[0] for digit in "123456789"):
        raise BadValue(f"{what} is nearer to 0 than numbers here can be: {text}")
    return value


def digits(text: str, most: int) -> int:
    """The number 0 … most that ASCII digits stand for. Raises BadValue."""
    if not (text.isascii() and text.isdecimal()) or len(text) > 18 or int(text) > most:
        raise BadValue(f"a number within 0 … {most} is needed, not {text[:80]!r}")
    return int(text)


def host_and_port(text: str, host: str = "") -> tuple[str, int]:
    """HOST:PORT, of which HOST may stand in brackets; host is the one where text is PORT only. Raises BadValue."""
    named, colon, port = text.rpartition(":")
    number = digits(port, 65535)
    host = named if colon else host
    if not host:
        raise BadValue(f"HOST:PORT is needed, not {text[:80]!r}")
    return host.strip("[]"), number


def whole_numbers(answer: str, count: int, between: str = ",") -> list[int]:
    """A board's answer as so many whole numbers, none of more than 53 bits. Raises NotAMount."""
    try:
        numbers = [int(n) for n in answer.split(between)]
    except ValueError:
        numbers = []
    if len(numbers) != count or any(abs(n) > _LARGEST for n in numbers):
        raise NotAMount(f"not {count} whole numbers: {answer[:80]!r}")
    return numbers


def positive_numbers(answer: str, count: int, between: str = "; ") -> list[float]:
    """A board's answer as so many numbers above 0. Raises NotAMount."""
    try:
        numbers = [float(n) for n in answer.split(between)]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(1 / _LARGEST < n < _LARGEST for n in numbers):
        raise NotAMount(f"not {count} numbers above 0: {answer[:80]!r}")
    return numbers
