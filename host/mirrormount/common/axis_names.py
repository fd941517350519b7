"""The names of the axes: x, y, and for a board's further axes their numbers: axis3, axis4 … Imports nothing.

Axes come in pairs, a mount each: 1 and 2, 3 and 4 …
"""

import re

_NAME = re.compile(r"x|y|axis[1-9]")


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
    return isinstance(name, str) and bool(_NAME.fullmatch(name))
