"""Numbers that a person, a program or a board gives. Nothing is rounded or clamped in silence."""

from mirrormount.errors import BadValue, NotAMount


def whole_number(value: object, most: int, what: str) -> int:
    """value as an int within -most ... most. Raises BadValue; nothing is rounded or clamped."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise BadValue(f"{what} is a whole number, not {value!r}")
    if abs(value) > most:
        raise BadValue(f"{what} is within -{most} … {most}, not {value}")
    return value


def whole_numbers(answer: str, count: int) -> list[int]:
    """A board's answer as so many whole numbers, between commas. Raises NotAMount."""
    try:
        numbers = [int(n) for n in answer.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise NotAMount(f"not {count} whole numbers: {answer[:80]!r}")
    return numbers
