"""Numbers that a person, a program or a board gives. Nothing is rounded or clamped in silence."""

import operator
from typing import SupportsFloat, SupportsIndex

from mirrormount.common.errors import BadValue, NotAMount

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
    if type(value).__name__ in ("bool", "bool_") or hasattr(value, "__len__"):  # the truth values, NumPy's too; texts
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
