"""The measures of the printed parts, where each comes from, and what follows from them by arithmetic. Lengths in mm.

The plate is seen from the motors, its middle is the origin. The adjusters are in the upper left (motor 1) and in the
lower right corner (motor 2), as in the paper's Fig. 2a; what belongs to motor 2 is that of motor 1 with x and y
exchanged. Standard library only: what needs no solids is tested without them.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

HERE = Path(__file__).resolve().parent
MOUNTS = {path.stem: path for path in sorted((HERE / "mounts").glob("*.toml"))}
M3 = 3.2  # clearance hole, ISO 273 fine
M3_APART = 7.0  # between the two screws of a switch bracket: their heads are 5.5 wide
ROD_OUT, ROD_ALONG = 1.6, 11.2  # from a motor's axis to its rod: clear of motor, sleeve, cap and spring ring
RING_WALL, RING_HEIGHT = 4.0, 6.0
FOOT_DIAMETER, FOOT_HEIGHT = 10.0, 5.0  # of a rod
ROD_GAP = 0.3  # between rod and switch
ARM_WIDTH = 8.0  # of the spring ring
PITCH = 25.4 / 80  # of an adjuster, 80 threads an inch: an estimate, as in docs/mechanics.md

Place = tuple[float, float]
Circle = tuple[float, float, float]  # x, y, diameter


def turn_deg(radius: float, flat: float, gap: float) -> float:
    """By how much a shaft turns until the edge of its flat meets a wall that is a gap away; 90 if it never does.

    The edge is at acos(flat / radius) from the flat's middle, and meets the wall at acos((flat + gap) / radius).
    """
    if flat + gap >= radius:
        return 90.0
    return math.degrees(math.acos(flat / radius) - math.acos((flat + gap) / radius))


class MeasureError(ValueError):
    """A file of measures is wrong, or its parts would not fit together. The message says which measure to change."""


def _measure(least: float, most: float) -> float:
    return field(metadata={"range": (least, most)})


@dataclass(frozen=True)
class Measures:
    """All measures of one mount and its parts. sources: where each comes from, by its name."""

    name: str
    sources: dict[str, str]
    adjusters_x: float = _measure(15, 120)
    adjusters_y: float = _measure(15, 120)
    half_width: float = _measure(8, 80)
    side_hole: float = _measure(2, 30)
    side_screw: float = _measure(2, 7)
    socket_height: float = _measure(0, 60)
    key_flats: float = _measure(1, 6)
    gearbox_width: float = _measure(5, 40)
    gearbox_height: float = _measure(5, 40)
    motor_length: float = _measure(10, 100)
    shaft_diameter: float = _measure(1, 8)
    shaft_flat: float = _measure(0.5, 8)
    shaft_length: float = _measure(4, 40)
    shaft_hole: float = _measure(1, 20)
    motor_screw: float = _measure(1, 4)
    motor_screws_apart: float = _measure(4, 40)
    motor_screw_length: float = _measure(1, 20)
    motor_screw_depth: float = _measure(0.5, 10)
    motor_screw_head: float = _measure(1, 8)
    rear_shaft_length: float = _measure(0, 20)
    plate_thickness: float = _measure(1, 8)
    plate_edge: float = _measure(6, 40)
    plate_corner: float = _measure(0, 6)
    spring_diameter: float = _measure(2, 12)
    spring_length: float = _measure(5, 80)
    spring_stretch: float = _measure(0, 60)
    spring_pin: float = _measure(0.5, 4)
    sleeve_diameter: float = _measure(6, 20)
    axial_play: float = _measure(0, 10)
    key_depth: float = _measure(3, 30)
    key_free: float = _measure(0, 60)
    set_screw_pilot: float = _measure(1, 5)
    switch_length: float = _measure(5, 40)
    switch_thickness: float = _measure(2, 15)
    switch_holes_apart: float = _measure(3, 30)
    switch_screw: float = _measure(1, 4)
    switch_operates: float = _measure(2, 30)
    switch_terminals: float = _measure(3, 30)
    rod_diameter: float = _measure(2, 6)
    nut_width: float = _measure(3, 10)
    nut_height: float = _measure(1, 6)
    fit: float = _measure(0, 1)
    least_wall: float = _measure(0.4, 5)

    # The motor plate

    @property
    def plate_size(self) -> Place:
        """Its width and height."""
        return self.adjusters_x + 2 * self.plate_edge, self.adjusters_y + 2 * self.plate_edge

    @property
    def motors(self) -> tuple[Place, Place]:
        """The axes of both motors: those of the adjusters."""
        x, y = self.adjusters_x / 2, self.adjusters_y / 2
        return (-x, y), (x, -y)

    @property
    def rods(self) -> tuple[Place, Place]:
        """The threaded rods that stand on the frame and carry the nuts for the switches: outwards of the motors."""
        (x, y), (u, v) = self.motors
        return (x - ROD_OUT, y - ROD_ALONG), (u - ROD_ALONG, v - ROD_OUT)

    @property
    def brackets(self) -> tuple[Place, Place]:
        """The middle between both screws of a switch bracket, so placed that the switch ends beside the rod."""
        away = self.rod_diameter / 2 + ROD_GAP + self.switch_length / 2
        (x, y), (u, v) = self.rods
        return (x, y - away), (u - away, v)

    def plate_holes(self) -> dict[str, list[Circle]]:
        """Every hole of the plate, by what it is for."""
        half = self.motor_screws_apart / 2
        (x1, y1), (x2, y2) = self.brackets
        screw, side = self.motor_screw + self.fit, M3_APART / 2
        return {
            "shaft": [(x, y, self.shaft_hole) for x, y in self.motors],
            "motor screw": [(x + d, y, screw) for x, y in self.motors for d in (-half, half)],
            "spring": [(0.0, 0.0, self.spring_hole)],
            "rod": [(x, y, 2 * self.rod_diameter) for x, y in self.rods],
            "bracket screw": [(x1, y1 + d, M3) for d in (-side, side)] + [(x2 + d, y2, M3) for d in (-side, side)],
        }

    # The spring and its ring

    @property
    def spring_hole(self) -> float:
        """Diameter of the hole for the spring, in the plate and in the ring."""
        return self.spring_diameter + 3 * self.fit

    @property
    def stand(self) -> float:
        """From the frame's back to the plate, adjusters in mid travel: what is between them, in its order."""
        return self.socket_height + self.key_free + self.sleeve_length + self.axial_play

    @property
    def ring_rise(self) -> float:
        """From the frame's back to the lower face of the spring ring.

        The spring reaches from a pin in the middle of the ring's height to one that lies on the plate.
        """
        upper_pin = self.stand + self.plate_thickness + self.spring_pin / 2
        return upper_pin - self.spring_length - self.spring_stretch - RING_HEIGHT / 2

    @property
    def nut_reach(self) -> float:
        """From the plate to the face of a nut that is 2 mm from pressing its switch."""
        return 3 + self.switch_terminals + self.switch_operates + 2

    # The sleeve

    @property
    def neck(self) -> Place:
        """Diameter and length of the sleeve's thinner end, which passes between the heads of the motor's screws."""
        return self.motor_screws_apart - self.motor_screw_head - self.fit, self.motor_screw + 0.4

    @property
    def bore_depth(self) -> float:
        """Of the hole for the shaft, which reaches through the plate."""
        return self.shaft_length - self.plate_thickness + 0.5

    @property
    def sleeve_length(self) -> float:
        """Both holes, and a wall between them."""
        return self.bore_depth + 1.6 + self.key_depth

    @property
    def least_engagement(self) -> float:
        """Of the shaft in the sleeve, when the sleeve is as far out as it may slide."""
        return self.shaft_length - self.plate_thickness - 2 * self.axial_play

    @property
    def loose_deg(self) -> Place:
        """By how much shaft and key turn in the sleeve, both ways together, while their set screws are loose."""
        shaft = self.shaft_flat - self.shaft_diameter / 2
        return (
            2 * turn_deg(self.shaft_diameter / 2, shaft, self.fit / 2),
            2 * turn_deg(self.key_flats / math.sqrt(3), self.key_flats / 2, self.fit / 4),
        )

    @property
    def beam_urad_per_deg(self) -> float:
        """Of the beam, for a degree of the horizontal adjuster: twice what the mirror turns."""
        return 2 * PITCH / 360 / self.adjusters_x * 1e6

    # What must hold

    def walls(self) -> dict[str, float]:
        """The thinnest walls, by the parts' names."""
        width, height = self.plate_size
        holes = [hole for group in self.plate_holes().values() for hole in group]
        between = [math.dist(a[:2], b[:2]) - (a[2] + b[2]) / 2 for i, a in enumerate(holes) for b in holes[i + 1 :]]
        to_edge = [min(width / 2 - abs(x), height / 2 - abs(y)) - d / 2 for x, y, d in holes]
        corners = self.key_flats * 2 / math.sqrt(3) + self.fit
        return {
            "plate": min(between + to_edge),
            "spring_ring": min(RING_HEIGHT - self.spring_pin - self.fit, ARM_WIDTH - self.side_screw - 0.3) / 2,
            "sleeve": min((self.neck[0] - self.shaft_diameter - self.fit) / 2, (self.sleeve_diameter - corners) / 2),
            "encoder_cap": 1.6,
            "switch_bracket": 1.6,
            "rod_foot": (FOOT_DIAMETER - (self.nut_width + self.fit) * 2 / math.sqrt(3)) / 2,
        }

    def faults(self) -> list[str]:
        """What would not fit, one sentence each, with the measures to change."""
        depth = self.motor_screw_length - self.plate_thickness
        beside = ROD_ALONG - ROD_OUT + self.rod_diameter / 2 + ROD_GAP + self.switch_length + self.switch_thickness / 2
        found = [
            (wall < self.least_wall, f"{part}: a wall of {wall:.2f} mm is less than least_wall, {self.least_wall}")
            for part, wall in self.walls().items()
        ]
        found += [
            (depth > self.motor_screw_depth, f"the motor's screws enter by {depth:g} mm: shorten motor_screw_length"),
            (depth < 0.5, f"the motor's screws enter by {depth:g} mm: lengthen motor_screw_length"),
            (
                self.least_engagement < self.shaft_diameter,
                f"{self.least_engagement:g} mm of the shaft stay in the sleeve: reduce axial_play or plate_thickness",
            ),
            (
                self.ring_rise < FOOT_HEIGHT + 2,
                f"the spring ring is {self.ring_rise:.1f} mm above the frame, and {FOOT_HEIGHT + 2:g} are needed for"
                " the feet of the rods: take a longer key_free, or a shorter spring_length",
            ),
            (
                self.stand - self.nut_reach - self.nut_height < self.ring_rise + RING_HEIGHT
                and self.rods[0][1] - self.nut_width / math.sqrt(3) < ARM_WIDTH / 2,
                "the nuts below the plate meet the arm of the spring ring: take a longer spring or spring_stretch",
            ),
            (
                max(self.adjusters_x, self.adjusters_y) <= beside,
                f"the switches of both axes meet: adjusters_x or adjusters_y must be more than {beside:.1f} mm",
            ),
            (
                self.motors[0][1] - ROD_ALONG - FOOT_DIAMETER / 2 < ARM_WIDTH / 2
                and ROD_OUT + FOOT_DIAMETER / 2 - self.motors[0][0] > self.half_width,
                "the foot of a rod meets the spring ring at the frame's side: check half_width and adjusters_x",
            ),
            (max(self.loose_deg) > 60, "shaft or key would slip in the sleeve: reduce fit, or check shaft_flat"),
        ]
        return [words for is_wrong, words in found if is_wrong]


def _number(name: str, value: object, where: str) -> tuple[float, str]:
    source = "yours"
    if isinstance(value, dict):
        source, value = value.get("source", ""), value.get("mm")
        if not isinstance(source, str) or not source:
            raise MeasureError(f"{where}: {name} has no source: write where the number comes from")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MeasureError(f"{where}: {name} is no number of mm: write {name} = 12.3")
    return float(value), source


def load(path: Path, hardware: Path = HERE / "hardware.toml") -> Measures:
    """The measures of a mount's file, and those of hardware.toml that it does not give. Raises MeasureError."""
    read: dict[str, object] = {}
    for file in (hardware, path):
        try:
            read |= tomllib.loads(file.read_text(encoding="utf-8"))
        except OSError as error:
            raise MeasureError(f"{file}: {error.strerror}: name a file, or one of {', '.join(MOUNTS)}") from None
        except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise MeasureError(f"{file} is no TOML file: {error}: compare it with mounts/u100.toml") from None
    name = read.pop("name", path.stem)
    ranges = {f.name: f.metadata["range"] for f in fields(Measures) if "range" in f.metadata}
    if unknown := sorted(set(read) - set(ranges)):
        raise MeasureError(f"{path}: {unknown[0]} is no measure: the names are in mounts/u100.toml and hardware.toml")
    if missing := [known for known in ranges if known not in read]:
        raise MeasureError(f"{path}: {missing[0]} is missing: measure it, and write {missing[0]} = 12.3")
    numbers, sources = {}, {}
    for known, (least, most) in ranges.items():
        numbers[known], sources[known] = _number(known, read[known], str(path))
        if not least <= numbers[known] <= most:
            raise MeasureError(f"{path}: {known} = {numbers[known]:g} is not from {least:g} to {most:g} mm")
    measures = Measures(name=str(name), sources=sources, **numbers)
    if faults := measures.faults():
        raise MeasureError(f"{path}: " + "; ".join(faults))
    return measures


def find(words: Sequence[str]) -> list[tuple[str, Path]]:
    """From names and paths to the names of folders and the files of measures; without words all that are known."""
    return [(Path(word).stem, MOUNTS.get(word, Path(word))) for word in words or MOUNTS]
