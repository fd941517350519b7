"""Values that a person or a program gives. Nothing is rounded or clamped in silence."""

from mirrormount.errors import BadValue


def whole_number(value: object, most: int, what: str) -> int:
    """value as an int within -most ... most. Raises BadValue; nothing is rounded or clamped."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise BadValue(f"{what} is a whole number, not {value!r}")
    if abs(value) > most:
        raise BadValue(f"{what} is within -{most} … {most}, not {value}")
    return value
