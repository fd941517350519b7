"""The names of the axes: x, y, and for a board's further axes axis3, axis4 … Imports nothing."""

import re

_NAME = re.compile(r"x|y|axis[3-9]")


def axis_name(number: int, x_axis: int) -> str:
    """The name of a board's axis; x_axis: the number (1 or 2) of x."""
    if number > 2:
        return f"axis{number}"
    return "x" if number == x_axis else "y"


def is_axis(name: object) -> bool:
    """True for a name that an axis can have. Its board shows whether there is one."""
    return isinstance(name, str) and bool(_NAME.fullmatch(name))
