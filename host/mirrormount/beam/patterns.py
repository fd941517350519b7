"""Patterns of a scan: places in whole steps of two axes, relative to the start, in the order in which they are visited.

A gap of the drivetrain shifts places that are approached from different sides. A raster approaches all its places from
one side, unless it is a serpentine; a spiral and a line approach them as they come. Imports validation.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from mirrormount.common.errors import BadValue
from mirrormount.common.validation import whole_number

FARTHEST = 2000  # steps of an axis from the start: more than ten turns of a screw
_MOST_PLACES = 100_000
APPROACH = 4  # steps: more than the gap of any mount so far (1.6 steps of the paper's)


class Place(NamedTuple):
    """A place in steps from the start. measured: False on the way to the next one."""

    x: int
    y: int
    measured: bool = True


@dataclass(frozen=True, slots=True)
class Pattern:
    """Places in their order. parameters: what it was made of, for the files of a scan."""

    name: str
    parameters: Mapping[str, int | bool]
    places: tuple[Place, ...]

    def __post_init__(self) -> None:
        """Raises BadValue for a place that is too far."""
        far = max(max(abs(place.x), abs(place.y)) for place in self.places)
        if far > FARTHEST:
            raise BadValue(f"a {self.name} stays within {FARTHEST} steps of the start on each axis, not {far}")

    @property
    def measured(self) -> int:
        """How many places are measured."""
        return sum(place.measured for place in self.places)


def raster(columns: int, rows: int, pitch: int = 1, *, serpentine: bool = False, approach: int = APPROACH) -> Pattern:
    """Rows of places, pitch steps apart, about the start, from the lowest row up.

    Each row is run to the right, after a way back that goes `approach` steps beyond its first place: so the gap is
    taken up on the same side for all of them. serpentine: every second row is run to the left, which is faster, and the
    gap shears the rows unless the board takes it up. Raises BadValue.
    """
    columns, rows, pitch = _count(columns, "columns"), _count(rows, "rows"), _count(pitch, "the pitch")
    approach = 0 if serpentine else _count(approach, "the approach", 0)
    if columns * rows > _MOST_PLACES:
        raise BadValue(f"a raster has at most {_MOST_PLACES} places, not {columns} x {rows}")
    left, low = -((columns - 1) * pitch // 2), -((rows - 1) * pitch // 2)
    places: list[Place] = [Place(left - approach, low - approach, False)] if approach else []
    for row in range(rows):
        y = low + row * pitch
        places += [Place(left - approach, y, False)] if approach else []
        line = [Place(left + column * pitch, y) for column in range(columns)]
        places += reversed(line) if serpentine and row % 2 else line
    made_of = {"columns": columns, "rows": rows, "pitch": pitch, "serpentine": serpentine, "approach": approach}
    return Pattern("raster", made_of, tuple(places))


def spiral(rings: int, pitch: int = 1) -> Pattern:
    """A square spiral from the start outwards, of so many rings that are pitch steps apart. Raises BadValue."""
    rings, pitch = _count(rings, "rings", 0), _count(pitch, "the pitch")
    if (2 * rings + 1) ** 2 > _MOST_PLACES:
        raise BadValue(f"a spiral has at most {_MOST_PLACES} places, not {(2 * rings + 1) ** 2}")
    return Pattern("spiral", {"rings": rings, "pitch": pitch}, tuple(_outwards(rings, pitch)))


def line(by_x: int, by_y: int, count: int) -> Pattern:
    """So many places from the start on, each (by_x, by_y) steps from the one before. Raises BadValue."""
    by_x, by_y = whole_number(by_x, FARTHEST, "x of a step of the line"), whole_number(by_y, FARTHEST, "its y")
    count = _count(count, "the number of places")
    if not (by_x or by_y):
        raise BadValue("a line leads somewhere: x, y or both are not 0")
    return Pattern(
        "line",
        {"by_x": by_x, "by_y": by_y, "count": count},
        tuple(Place(number * by_x, number * by_y) for number in range(count)),
    )


def _outwards(rings: int, pitch: int) -> Iterator[Place]:
    """Each place of the square once, neighbours one after the other."""
    x = y = 0
    yield Place(0, 0)
    for ring in range(1, rings + 1):
        side = 2 * ring
        for by_x, by_y, count in ((1, 0, 1), (0, 1, side - 1), (-1, 0, side), (0, -1, side), (1, 0, side)):
            for _ in range(count):
                x, y = x + by_x * pitch, y + by_y * pitch
                yield Place(x, y)


def _count(value: int, what: str, least: int = 1) -> int:
    number = whole_number(value, _MOST_PLACES, what)
    if number < least:
        raise BadValue(f"{what}: {least} or more, not {number}")
    return number
