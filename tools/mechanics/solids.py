# pyright: reportMissingImports=false
"""The printed parts as solids of build123d, each lying as it is printed, its lowest face at z = 0. Lengths in mm."""

from __future__ import annotations

from collections.abc import Iterable
from math import sqrt
from typing import Any

from build123d import (
    Align,
    Axis,
    Box,
    Circle,
    Cylinder,
    Plane,
    Pos,
    RectangleRounded,
    RegularPolygon,
    Rot,
    extrude,
    fillet,
)
from measures import ARM_WIDTH, FOOT_DIAMETER, FOOT_HEIGHT, M3, M3_APART, RING_HEIGHT, RING_WALL, Measures

LOW = (Align.CENTER, Align.CENTER, Align.MIN)
CORNER = (Align.MIN, Align.CENTER, Align.MIN)
ALONG_X, ALONG_Y = Rot(0, 90, 0), Rot(90, 0, 0)


def hole(diameter: float, depth: float, at: tuple[float, float, float] = (0, 0, 0), turned: Any = None) -> Any:
    """A cylinder to subtract, upwards from a place, or turned about it and then in its middle."""
    if turned is None:
        return Pos(*at) * Cylinder(diameter / 2, depth, align=LOW)
    return Pos(*at) * turned * Cylinder(diameter / 2, depth)


def hexagon(flats: float, depth: float, at: tuple[float, float, float]) -> Any:
    """A hexagonal prism, upwards from a place, by its width across the flats; one flat is towards x."""
    return Pos(*at) * extrude(RegularPolygon(flats / sqrt(3), 6, rotation=30), depth)


def plate_face(m: Measures) -> Any:
    """The motor plate's outline with its holes: what a laser or a mill cuts."""
    face: Any = RectangleRounded(*m.plate_size, m.plate_corner) if m.plate_corner else Plane.XY * Box(*m.plate_size, 0)
    for x, y, diameter in (circle for group in m.plate_holes().values() for circle in group):
        face -= Pos(x, y) * Circle(diameter / 2)
    return face


def plate(m: Measures) -> Any:
    """The motor plate, the paper's Fig. 2a."""
    return extrude(plate_face(m), m.plate_thickness)


def spring_ring(m: Measures) -> Any:
    """The spring ring, the paper's Fig. 2b, here at the end of an arm from the frame's side to the plate's middle.

    The face towards the plate is below, so that ring and arm lie flat and the foot with the screw's hole stands up.
    """
    width, thick, outer = ARM_WIDTH, 5.0, m.spring_hole + 2 * RING_WALL
    side, up = -m.half_width, m.ring_rise + RING_HEIGHT  # where the frame's side and its back face are
    low = (Align.MAX, Align.CENTER, Align.MIN)
    solid = Pos(side) * Box(thick, width, up + m.side_hole + 7, align=low)
    solid += Pos(side - thick) * Box(thick - side, width, RING_HEIGHT, align=CORNER)
    inner = solid.edges().filter_by(Axis.Y).sort_by_distance((side, 0, RING_HEIGHT))[0]
    solid = fillet([inner], min(3, m.ring_rise - 1))
    solid += Cylinder(outer / 2, RING_HEIGHT, align=LOW)
    solid -= hole(m.spring_hole, 40, (0, 0, -9))
    solid -= hole(m.spring_pin + m.fit, 40, (0, 0, RING_HEIGHT / 2), ALONG_Y)
    return solid - hole(m.side_screw + 0.3, 20, (side, 0, up + m.side_hole), ALONG_X)


def sleeve(m: Measures) -> Any:
    """The sleeve: the D shaft below, the hex key above, a set screw on either. The neck is below."""
    neck, low = m.neck
    d = m.shaft_diameter + m.fit
    flat = m.shaft_flat - m.shaft_diameter / 2 + m.fit / 2  # from the axis
    solid = Cylinder(neck / 2, low, align=LOW) + Pos(0, 0, low) * Cylinder(
        m.sleeve_diameter / 2, m.sleeve_length - low, align=LOW
    )
    bore = hole(d, m.bore_depth) - Pos(flat, 0, -1) * Box(9, 9, m.bore_depth + 2, align=CORNER)
    solid -= bore
    solid -= hexagon(m.key_flats + m.fit / 2, m.key_depth, (0, 0, m.sleeve_length - m.key_depth))
    for z in (low + 2.5, m.sleeve_length - m.key_depth / 2):
        solid -= Pos(0, 0, z) * ALONG_X * Cylinder(m.set_screw_pilot / 2, 20, align=LOW)
    return solid


def encoder_cap(m: Measures) -> Any:
    """A cap over the rear of a motor: an encoder's board lies on its floor; a tie round it takes the cable's pull."""
    wall, grip, back = 1.6, 10.0, 2.4
    inside = m.rear_shaft_length + 2.5  # behind the motor
    w, h = m.gearbox_width + m.fit, m.gearbox_height + m.fit
    height = back + inside + grip
    solid = Box(w + 2 * wall, h + 2 * wall, height, align=LOW)
    solid -= Pos(0, 0, back) * Box(w, h, height, align=LOW)
    solid -= Pos(0, 0, back) * Box(90, 7, inside + grip - wall, align=LOW)  # terminals, wires, and fingers that give
    return solid - hole(5, 20, (0, 0, -5))


def switch_bracket(m: Measures) -> Any:
    """An angle that holds a micro switch beside a rod; all four are the same."""
    length = m.switch_holes_apart + m.switch_screw + 0.2 + 2 * 1.6
    x = 3 + m.switch_thickness / 2
    z = 3 + m.switch_terminals
    solid = Box(x + 4.8, length, 3, align=CORNER) + Box(3, length, z + m.switch_screw / 2 + 1.7, align=CORNER)
    inner = solid.edges().filter_by(Axis.Y).sort_by_distance((3, 0, 3))[0]
    solid = fillet([inner], 1.0)
    for side in (-0.5, 0.5):
        solid -= hole(M3, 9, (x, side * M3_APART, -3))
        solid -= hole(m.switch_screw + 0.2, 20, (0, side * m.switch_holes_apart, z), ALONG_X)
    return solid


def rod_foot(m: Measures) -> Any:
    """A foot for a threaded rod, with a nut in it; it is glued to the frame's back, the nut below."""
    nut = m.nut_height + 0.6
    solid = Cylinder(FOOT_DIAMETER / 2, FOOT_HEIGHT, align=LOW) - hexagon(m.nut_width + m.fit, nut, (0, 0, 0))
    return solid - hole(m.rod_diameter + m.fit, 9, (0, 0, -1))


PARTS = {f.__name__: f for f in (plate, spring_ring, sleeve, encoder_cap, switch_bracket, rod_foot)}
COUNT = {"plate": 1, "spring_ring": 1, "sleeve": 2, "encoder_cap": 2, "switch_bracket": 4, "rod_foot": 2}


def motor(m: Measures) -> Any:
    """A motor's body with its shafts, output shaft upwards from z = 0: for pictures, and to see that it fits."""
    gearbox = 12.0 if m.motor_length > 20 else m.motor_length / 2
    solid = Pos(0, 0, -gearbox) * Box(m.gearbox_width, m.gearbox_height, gearbox, align=LOW)
    can = Cylinder(m.gearbox_width / 2, m.motor_length - gearbox, align=LOW)
    solid += Pos(0, 0, -m.motor_length) * (can & Box(90, m.gearbox_height, 90))
    flat = m.shaft_flat - m.shaft_diameter / 2
    shaft = Cylinder(m.shaft_diameter / 2, m.shaft_length, align=LOW)
    solid += shaft - Pos(flat, 0, 0) * Box(9, 9, m.shaft_length + 1, align=CORNER)
    return solid + Pos(0, 0, -m.motor_length - m.rear_shaft_length) * Cylinder(0.5, m.rear_shaft_length, align=LOW)


def frame(m: Measures) -> Any:
    """The mount's frame as a stand-in for pictures: an L with the adjusters, back face at z = 0, mirror below."""
    size, thick = 2 * m.half_width, 2 * m.side_hole
    w = size / 2 - m.adjusters_x / 2 + 8
    solid = Pos(0, 0, -thick) * Box(size, size, thick, align=LOW)
    solid -= Pos(w, w, -thick - 1) * Box(size, size, thick + 2, align=LOW)
    for x, y in m.motors:
        solid += Pos(x, y) * Cylinder(3.2, m.socket_height, align=LOW) - hexagon(
            m.key_flats + 0.1, 3, (x, y, m.socket_height - 3)
        )
    solid -= hole(m.side_screw, 12, (-m.half_width, 0, -m.side_hole), ALONG_X)
    return solid


def assembly(m: Measures, names: Iterable[str]) -> list[tuple[str, Any]]:
    """Named solids where they belong when the mount is built; the plate's middle is on the z axis, motors above."""
    top = m.stand + m.plate_thickness
    shapes = {name: make(m) for name, make in PARTS.items()} | {"frame": frame(m), "motor": motor(m)}
    (x1, y1), (x2, y2) = m.motors
    ends = [Pos(x1, y1), Pos(x2, y2) * Rot(0, 0, 180)]
    bracket = shapes["switch_bracket"]
    offset = Pos(-3 - m.switch_thickness / 2, 0)
    upper = [Pos(*m.brackets[0]) * offset, Pos(*m.brackets[1]) * Rot(0, 0, 90) * offset]
    nut = hexagon(m.nut_width, m.nut_height, (0, 0, 0))
    reach = m.nut_reach
    length = top + reach + 8
    rod = Cylinder(m.rod_diameter / 2, length, align=LOW)
    rod += Pos(0, 0, m.stand - reach - m.nut_height) * nut + Pos(0, 0, top + reach) * nut
    body = Box(m.switch_thickness, m.switch_length, 10.2) + Pos(0, 0.4) * Rot(8, 0, 0) * Pos(0, 0, 7) * Box(3, 17, 0.4)
    switch = Pos(3 + m.switch_thickness / 2, 0, 3 + m.switch_terminals + 1) * body
    coil = m.spring_length + m.spring_stretch
    spring = Pos(0, 0, m.ring_rise + RING_HEIGHT / 2) * (
        Cylinder(m.spring_diameter / 2, coil, align=LOW) - Cylinder(m.spring_diameter / 2 - 0.8, coil, align=LOW)
    )
    turn = Rot(180, 0, 0)
    places: dict[str, list[Any]] = {
        "frame": [shapes["frame"]],
        "spring_ring": [Pos(0, 0, m.ring_rise + RING_HEIGHT) * turn * shapes["spring_ring"]],
        "plate": [Pos(0, 0, m.stand) * shapes["plate"]],
        "motor": [Pos(0, 0, top) * at * turn * shapes["motor"] for at in ends],
        "sleeve": [Pos(0, 0, m.stand - m.axial_play) * at * turn * shapes["sleeve"] for at in ends],
        "key": [
            Pos(x, y) * hexagon(m.key_flats, m.key_free + m.key_depth + 2, (0, 0, m.socket_height - 2))
            for x, y in m.motors
        ],
        "spring": [spring],
        "spring_pin": [
            Pos(0, 0, z) * turned * Cylinder(m.spring_pin / 2, 18)
            for z, turned in ((m.ring_rise + RING_HEIGHT / 2, ALONG_Y), (top + m.spring_pin / 2, ALONG_Y))
        ],
        "rod_foot": [Pos(x, y) * shapes["rod_foot"] for x, y in m.rods],
        "rod": [Pos(x, y, 1) * rod for x, y in m.rods],
        "switch_bracket": [Pos(0, 0, top) * at * bracket for at in upper]
        + [Pos(0, 0, m.stand) * at * Rot(180, 0, 0) * bracket for at in upper],
        "switch": [Pos(0, 0, top) * at * switch for at in upper]
        + [Pos(0, 0, m.stand) * at * Rot(180, 0, 0) * switch for at in upper],
        "encoder_cap": [
            Pos(0, 0, top + m.motor_length - 10)
            * at
            * Pos(0, 0, 12.4 + m.rear_shaft_length + 2.5)
            * turn
            * shapes["encoder_cap"]
            for at in ends
        ],
    }
    return [(name, shape) for name in names for shape in places[name]]
